"""A value that goes to and fro between two programs, and a controller at 100 Hz: what `ratios.py` measures."""

import time
from dataclasses import dataclass

import dca


@dca.message
@dataclass(slots=True)
class Frame:
    number: float
    image: dca.Bytes


@dca.task("Times a value that goes to and fro.", every="100 ms", triggered_by="In")
class Ping:
    In = dca.In(Frame)
    Out = dca.Out(Frame)
    size = dca.parameter(int, (0, 10_000_000), default=64)
    rounds = dca.parameter(int, (1, 10_000_000), default=3000)

    def init(self, value):
        self.image, self.times, self.sent = bytes([7]) * self.size, [], None

    def main_calc(self, tick):
        if self.sent is not None and self.In.fresh() is not None:
            self.times.append(time.perf_counter() - self.sent)
        if len(self.times) >= self.rounds:
            print(f"hop {sorted(self.times)[len(self.times) // 2] * 0.5e6:.1f}")
            return dca.done()
        self.sent = time.perf_counter()
        self.Out.send(Frame(float(len(self.times)), self.image))


@dca.service("Sends each value back.", every="100 ms", triggered_by="In")
class Pong:
    In = dca.In(Frame)
    Out = dca.Out(Frame)

    def main_calc(self, tick):
        frame = self.In.fresh()
        if frame is not None:
            self.Out.send(frame)


@dca.task("Sends 100 values a second, and tells what that costs.", every="10 ms")
class Steady:
    Out = dca.Out(Frame)
    seconds = dca.parameter(dca.Time, ("1 s", "1 h"), default="5 s")

    def init(self, value):
        self.count, self.began, self.spent = 0, None, 0.0

    def main_calc(self, tick):
        if self.began is None:
            self.began, self.spent = tick.now, time.process_time()
        self.count += 1
        self.Out.send(Frame(float(self.count), b""))
        if tick.now - self.began >= self.seconds:
            print(f"core {(time.process_time() - self.spent) / (tick.now - self.began) * 100:.2f}")
            return dca.done()


@dca.service("Reads 100 values a second.", every="10 ms")
class Reads:
    In = dca.In(Frame)

    def main_calc(self, tick):
        self.In.fresh_within(tick.now, "100 ms")


if __name__ == "__main__":
    dca.run(Ping, Pong, Steady, Reads)
