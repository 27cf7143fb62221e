"""A value that goes to and fro between two nodes of dora, timed."""

import sys
import time

import pyarrow
from dora import Node

node = Node()
size, rounds, result = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3]
image = pyarrow.array(memoryview(bytes([7]) * size), type=pyarrow.uint8())
times, sent = [], None
for event in node:
    if event["type"] != "INPUT":
        continue
    if event["id"] == "tick" and sent is not None and time.perf_counter() - sent < 0.5:
        continue
    if event["id"] == "back" and sent is not None:
        times.append(time.perf_counter() - sent)
    if len(times) >= rounds:
        with open(result, "w") as file:
            file.write(f"{sorted(times)[len(times) // 2] * 0.5e6:.1f}")
        break
    sent = time.perf_counter()
    node.send_output("out", image)
