#!/usr/bin/env python3
"""Prints types and random values of them, as `rosbags` encodes them: for the test `ros/tests/all/rosbags.rs`.

A line `T` has the name of a type, its hash and its definition. A line `V` has the bytes of a value of that type, and the value as text.
Arguments: the names of typestores, and how many values of each type.
"""

import json
import random
import struct
import sys

import numpy
import rosbags.typesys.store
from rosbags.typesys import Stores, get_typestore

# ROS 2 describes `char` as `uint8`, but rosbags has a separate number for `char`.
rosbags.typesys.store.TIDMAP["char"] = 3

ARRAY, SEQUENCE = 3, 4
WHOLE = {"byte": (0, 8), "char": (0, 8), "bool": (0, 1)}
WHOLE |= {f"uint{bits}": (0, bits) for bits in (8, 16, 32, 64)}
WHOLE |= {f"int{bits}": (bits - 1, bits - 1) for bits in (8, 16, 32, 64)}
FLOATS = {"float32": ("<f", "<I", 32), "float64": ("<d", "<Q", 64)}
LETTERS = "abz _/%0ä€𝄞\n"


def number(of):
    """Return a random number, and its text."""
    if of in FLOATS:
        form, whole, bits = FLOATS[of]
        special = [0.0, -0.0, float("inf"), float("-inf"), 1.5, -1e-3]
        value = random.choice(special)
        if random.random() < 0.7:
            value = struct.unpack(form, struct.pack(whole, random.getrandbits(bits)))[0]
            value = 0.25 if value != value else value
        packed = struct.pack(form, value)
        return struct.unpack(form, packed)[0], packed[::-1].hex()
    below, above = WHOLE[of]
    low, high = -(2**below) if below else 0, 2**above - 1
    value = random.choice([low, high, 0, 1, random.randint(low, high)])
    if of == "bool":
        return bool(value), "true" if value else "false"
    # rosbags takes a single `byte` with a sign.
    return (value - 256 if of == "byte" and value > 127 else value), str(value)


def text(limit):
    """Return a random text, and its text."""
    value = "".join(random.choices(LETTERS, k=random.randint(0, 12)))
    while limit and len(value.encode()) > limit:
        value = value[:-1]
    return value, f'"{value.encode().hex()}"'


def element(store, kind, of, depth):
    """Return a random value of a type, and its text."""
    if kind == 2:
        return message(store, of, depth + 1)
    name, limit = of
    return text(limit) if name == "string" else number(name)


def field(store, description, depth):
    """Return a random value of a field, and its text."""
    kind, of = description
    if kind not in (ARRAY, SEQUENCE):
        return element(store, kind, of, depth)
    (inner, of), size = of
    most = max(0, 4 - depth) if not size else min(size, 4)
    count = size if kind == ARRAY else random.randint(0, most)
    values = [element(store, inner, of, depth) for _ in range(count)]
    shown = "[" + ",".join(shown for _, shown in values) + "]"
    values = [value for value, _ in values]
    if inner == 1 and of[0] != "string":
        values = numpy.array(values, dtype={"byte": "int8", "char": "uint8"}.get(of[0], of[0]))
    return values, shown


def message(store, name, depth=0):
    """Return a random message, and its text."""
    arguments, shown = {}, []
    for key, description in store.fielddefs[name][1]:
        value, text = field(store, description, depth)
        arguments[rosbags.typesys.store.normalize_fieldname(key)] = value
        if key == "structure_needs_at_least_one_member":
            arguments[key] = 0
        else:
            shown.append(text)
    return store.types[name](**arguments), "{" + ",".join(shown) + "}"


def main():
    """Print all types of the typestores, and random values of each."""
    *stores, count = sys.argv[1:]
    random.seed(7)
    for store in stores:
        store = get_typestore(Stores(store))
        for name in store.fielddefs:
            definition, _ = store.generate_msgdef(name, ros_version=2)
            print("T", json.dumps([name, store.hash_rihs01(name), definition]))
            for _ in range(int(count)):
                value, shown = message(store, name)
                print("V", bytes(store.serialize_cdr(value, name, little_endian=True)).hex(), shown)


if __name__ == "__main__":
    main()
