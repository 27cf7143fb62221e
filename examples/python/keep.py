#!/usr/bin/env python3
"""Keeps a distance to the wall."""

from dataclasses import dataclass

import dca


@dca.message
@dataclass(slots=True)
class Range:
    distance: dca.Length
    stamp: dca.Time | None = None


@dca.message
@dataclass(slots=True)
class Velocity:
    forward: dca.Speed = 0.0


@dca.service("Keeps a distance to the wall.", every="20 ms", triggered_by="In", stop_within="300 ms")
class KeepDistance:
    In = dca.In(Range)
    Out = dca.Out(Velocity)
    reach = dca.parameter(dca.Length, ("0.1 m", "2 m"), default="0.5 m")

    def main_calc(self, tick):
        range_ = self.In.fresh_within(tick.now, "100 ms")
        if range_ is None:
            return self.Out.send(Velocity())
        self.Out.send(Velocity(forward=2.0 * (range_.distance - self.reach)))

    def stop(self, tick):
        self.Out.send(Velocity())
        return True


if __name__ == "__main__":
    dca.run(KeepDistance)
