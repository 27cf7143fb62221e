"""Tests on virtual time: nothing waits, and each run has the same numbers."""

import dca.testing
from controllers import Level, Ramp, Smooth


def test_the_ramp_ends_at_its_level():
    harness = dca.testing.Harness()
    ramp = harness.add(Ramp, until=5).start()
    ended = harness.run("1 s")
    assert ended is not None and ended.how == "done"
    assert [sent.value.value for sent in ramp.sent("Out")] == [1.0, 2.0, 3.0, 4.0, 5.0]


def test_both_take_part():
    harness = dca.testing.Harness()
    ramp, smooth = harness.add(Ramp), harness.add(Smooth, gain=0.2).start()
    harness.connect(ramp, "Out", smooth, "In")
    smooth.send("In", Level(10.0))
    ramp.start()
    ended = harness.run("2 s")
    assert ended is not None and ended.module is ramp
    assert smooth.is_active
