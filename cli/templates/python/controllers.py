"""Two controllers: one counts up, the other follows it. The spec says which of them runs where."""

from dataclasses import dataclass

import dca


@dca.message
@dataclass(slots=True)
class Level:
    value: float


@dca.task("Counts up, and ends.", every="50 ms")
class Ramp:
    Out = dca.Out(Level)
    until = dca.parameter(float, (1, 1000), default=20)

    def init(self, value):
        self.level = 0.0

    def main_calc(self, tick):
        self.level += 1.0
        self.Out.send(Level(self.level))
        if self.level >= self.until:
            return dca.done()


@dca.service("Follows a level slowly.", every="50 ms", triggered_by="In", signals_every="100 ms")
class Smooth:
    In = dca.In(Level)
    gain = dca.parameter(float, (0, 1), default=0.5)

    def init(self, value):
        self.level = 0.0

    def main_calc(self, tick):
        level = self.In.fresh()
        if level is not None:
            self.level += self.gain * (level.value - self.level)

    def signals(self):
        return [dca.Signal("level", self.level, headline=True)]


if __name__ == "__main__":
    dca.run(Ramp, Smooth)
