#!/usr/bin/env python3
"""A base in front of a wall, and a task that waits until the base stands at a distance. Two controllers in one program."""

import logging

import dca
from keep import Range, Velocity


@dca.service("Simulates a base that drives towards a wall, and its laser.", every="20 ms", signals_every="100 ms")
class Base:
    In = dca.In(Velocity, optional=True)
    Out = dca.Out(Range)
    start = dca.parameter(dca.Length, ("0 m", "10 m"), default="1 m")

    def init(self, value):
        self.distance = self.start

    def main_calc(self, tick):
        wanted = self.In.fresh_within(tick.now, "100 ms")
        if wanted is not None:
            self.distance -= wanted.forward * tick.elapsed
        self.Out.send(Range(self.distance, stamp=tick.now))

    def signals(self):
        return [dca.Signal("distance", self.distance, "m", headline=True)]


@dca.task("Waits until the wall is at a distance.", every="100 ms", triggered_by="In")
class Reached:
    In = dca.In(Range)
    distance = dca.parameter(dca.Length, ("0 m", "10 m"))
    tolerance = dca.parameter(dca.Length, ("1 mm", None), default="2 cm")

    def main_calc(self, tick):
        range_ = self.In.fresh()
        if range_ is not None and abs(range_.distance - self.distance) < self.tolerance:
            logging.info("the wall is %.2f m away", range_.distance)
            return dca.done(range_)


if __name__ == "__main__":
    dca.run(Base, Reached)
