"""Controllers in virtual time."""

from dataclasses import dataclass

import dca
import dca.testing
import pytest


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
        self.Out.send(Velocity(forward=0.8 * (range_.distance - self.reach)))

    def stop(self, tick):
        self.Out.send(Velocity())
        return True


@dca.task("Adds up what comes.", every="10 ms")
class Sum:
    In = dca.Every(Range)
    Out = dca.Out(Range)
    until = dca.parameter(int, default=3)

    def __init__(self):
        self.total, self.count = 0.0, 0

    def main_calc(self, tick):
        for value in self.In:
            self.total, self.count = self.total + value.distance, self.count + 1
        if self.count >= self.until:
            return dca.done(Range(self.total))


def test_a_trigger_and_the_age_of_a_value():
    harness = dca.testing.Harness()
    keep = harness.add(KeepDistance, reach="60 cm").start()
    harness.run("1 ms")
    assert keep.last("Out").forward == 0.0
    keep.send("In", Range(1.0))
    harness.run("1 ms")
    assert keep.last("Out").forward == pytest.approx(0.8 * 0.4)
    assert keep.sent("Out")[-1].at == pytest.approx(0.0011)
    # No further value comes, so the robot stands still after 100 ms.
    harness.run("200 ms")
    assert keep.last("Out").forward == 0.0
    keep.stop()
    ended = harness.run("1 s")
    assert (ended.module, ended.how) == (keep, "stopped") and not keep.is_active


def test_a_stamp_tells_the_age():
    harness = dca.testing.Harness()
    keep = harness.add(KeepDistance).start()
    harness.run("500 ms")
    keep.send("In", Range(1.0, stamp=harness.now - 0.2))
    harness.run("1 ms")
    assert keep.last("Out").forward == 0.0
    keep.send("In", Range(1.0, stamp=harness.now - 0.05))
    harness.run("1 ms")
    assert keep.last("Out").forward > 0.0


def test_every_value_counts_and_each_activation_begins_anew():
    harness = dca.testing.Harness()
    total = harness.add(Sum)
    for _ in range(2):
        total.start()
        harness.run("1 ms")
        for number in (1.0, 2.0, 4.0):
            total.send("In", Range(number))
        ended = harness.run("1 s")
        assert ended.how == "done" and dca.decode(Range, ended.value) == Range(7.0)


def test_an_input_of_every_value_counts_its_values():
    @dca.service("Counts.", every="10 ms")
    class Count:
        In = dca.Every(Range)
        Out = dca.Out(Range)

        def main_calc(self, tick):
            assert (self.In.lost, self.In.refused) == (0, 0)
            self.Out.send(Range(float(self.In.received)))

    harness = dca.testing.Harness()
    count = harness.add(Count).start()
    harness.run("5 ms")
    for number in (1.0, 2.0, 4.0):
        count.send("In", Range(number))
    assert harness.run("100 ms") is None
    assert count.last("Out") == Range(3.0)


def test_a_wire_can_be_closed_and_a_crash_is_told():
    harness = dca.testing.Harness()

    @dca.service("Sends.", every="10 ms")
    class Source:
        Out = dca.Out(Range)

        def main_calc(self, tick):
            self.Out.send(Range(1.0))

    source, keep = harness.add(Source).start(), harness.add(KeepDistance).start()
    wire = harness.connect(source, "Out", keep, "In")
    harness.run("100 ms")
    assert keep.last("Out").forward > 0.0
    wire.close()
    harness.run("300 ms")
    assert keep.last("Out").forward == 0.0
    source.crash()
    ended = harness.run("1 s")
    assert (ended.module, ended.how, ended.reason) == (source, "aborted", "SIGKILL")


def test_a_busy_machine_is_the_same_for_the_same_seed():
    def run(seed):
        harness = dca.testing.Harness(seed=seed, busy=True)
        keep = harness.add(KeepDistance).start()
        for number in range(200):
            keep.send("In", Range(float(number)))
            harness.run("10 ms")
        return keep.sent("Out")

    assert run(1) == run(1) != run(2)


def test_an_exception_is_an_abort_with_its_last_line(capsys):
    @dca.task("Fails.")
    class Bad:
        In = dca.In(Range)

        def main_calc(self, tick):
            raise ValueError("no door")

    harness = dca.testing.Harness()
    bad = harness.add(Bad).start()
    ended = harness.run("1 s")
    assert (ended.module, ended.how, ended.reason) == (bad, "aborted", "ValueError: no door")
    assert "Traceback" in capsys.readouterr().err
    for name in ("init", "stop", "__init__"):

        @dca.task("Fails.")
        class Worse(Bad):
            pass

        setattr(Worse, name, lambda self, *_: 1 / 0)
        harness = dca.testing.Harness()
        if name == "__init__":
            with pytest.raises(ValueError, match="ZeroDivisionError: division by zero"):
                harness.add(Worse)
        else:
            harness.add(Worse).start()
            ended = harness.run("1 s")
            both = "ValueError: no door; its stop failed: ZeroDivisionError: division by zero"
            assert (ended.how, ended.reason) == ("aborted", "ZeroDivisionError: division by zero" if name == "init" else both)


@pytest.mark.parametrize(
    ("stop", "is_asked", "reason"),
    [
        (lambda self, tick: 1 / 0, False, "its stop failed: ZeroDivisionError: division by zero"),
        (lambda self, tick: 1 / 0, True, "its stop failed: ZeroDivisionError: division by zero"),
        (lambda self, tick: False, False, "did not stop within 300 ms"),
        (lambda self, tick: False, True, "did not stop within 300 ms"),
    ],
)
def test_a_stop_that_fails_is_never_a_normal_end(stop, is_asked, reason):
    @dca.task("Is done at once.", every="20 ms", stop_within="300 ms")
    class Hand:
        def main_calc(self, tick):
            return None if is_asked else dca.done()

    Hand.stop = stop
    harness = dca.testing.Harness()
    hand = harness.add(Hand).start()
    if is_asked:
        assert harness.run("50 ms") is None
        hand.stop()
    ended = harness.run("1 s")
    assert (ended.how, ended.reason) == ("aborted", reason)


def test_an_outcome_that_is_not_declared_is_an_abort():
    @dca.task("Has no outcomes.")
    class Plain:
        def main_calc(self, tick):
            return dca.outcome("nope")

    harness = dca.testing.Harness()
    harness.add(Plain).start()
    ended = harness.run("1 s")
    assert (ended.how, ended.reason) == ("aborted", "it is done with an outcome that its interface does not declare")


def test_numbers_that_are_not_finite_are_refused_and_told():
    from math import nan

    @dca.message(allow_nan=True, name="Range")
    @dataclass
    class Anything:
        distance: dca.Length
        stamp: dca.Time | None = None

    @dca.service("Sends nonsense.", every="10 ms")
    class Source:
        Out = dca.Out(Anything)

        def main_calc(self, tick):
            self.Out.send(Anything(nan))

    @dca.task("Waits.", every="10 ms")
    class Wait:
        In = dca.In(Range)

        def main_calc(self, tick):
            if tick.now > 0.1:
                return dca.abort(f"{self.In.received} came, {self.In.refused} were refused")

    harness = dca.testing.Harness()
    source, wait = harness.add(Source).start(), harness.add(Wait).start()
    harness.connect(source, "Out", wait, "In")
    ended = harness.run("1 s")
    assert ended.reason.startswith("0 came, 1")
    assert ended.reason.endswith("`In` has refused its last 11 values: a number in them was not finite")


def test_what_is_wrong_is_named():
    harness = dca.testing.Harness()
    with pytest.raises(ValueError, match="no parameter `reech`"):
        harness.add(KeepDistance, reech=1)
    with pytest.raises(ValueError, match="which is not a number from 0.1 to 2"):
        harness.add(KeepDistance, reach="3 m")
    keep = harness.add(KeepDistance)
    with pytest.raises(ValueError, match="has no output `In`"):
        keep.sent("In")
    with pytest.raises(TypeError, match="expected a `Range`"):
        keep.send("In", Velocity())
    with pytest.raises(ValueError, match="has no output `Out2`|has no input"):
        harness.connect(keep, "Out2", keep, "In")


@pytest.mark.parametrize(
    ("tag", "how", "value"),
    [("found", "done", b"\x05found\x00\x00\x00\x00\x00\x00\xf0?\x00"), ("lost", "aborted", b""), ("", "aborted", b"")],
)
def test_an_outcome_has_its_tag_before_its_value(tag, how, value):
    @dca.task("Looks.", outcomes={"found": Range, "missing": None})
    class Search:
        def main_calc(self, tick):
            return dca.outcome(tag, Range(1.0))

    harness = dca.testing.Harness()
    harness.add(Search).start()
    ended = harness.run("1 s")
    assert (ended.how, ended.value) == (how, value)


def test_the_reason_of_an_abort_is_the_exception_and_not_its_note():
    @dca.task("Fails.")
    class Fails:
        def main_calc(self, tick):
            error = ValueError("the door is shut")
            error.add_note("seen from\nthe left")
            raise error

    harness = dca.testing.Harness()
    harness.add(Fails).start()
    assert harness.run("1 s").reason == "ValueError: the door is shut"


def test_an_exception_of_the_package_has_its_name():
    assert dca.SendError.__module__ == dca.CallError.__module__ == dca.Refused.__module__ == "dca"


def test_a_parameter_changes_while_it_runs():
    @dca.service("Turns.", every="10 ms")
    class Turn:
        steps = dca.parameter(int, (0, 10), default=1, name="Steps")
        reach = dca.parameter(dca.Length, default="1 m")
        told = 0

        def configure(self):
            self.told += 1

        def main_calc(self, tick):
            if self.told:
                return dca.abort(repr((self.told, self.steps, self.reach)))

    harness = dca.testing.Harness()
    turn = harness.add(Turn).start()
    assert harness.run("50 ms") is None
    with pytest.raises(ValueError, match="parameter `Steps` is `2.5`, which is not a whole number from 0 to 10"):
        turn.configure(Steps=2.5)
    turn.configure(Steps=7, reach="20 cm")
    # The declared attribute has the value, as a whole number. There is no attribute with the parameter's name.
    assert harness.run("50 ms").reason == "(1, 7, 0.2)"
    turn.configure(Steps=8)
    assert harness.run("50 ms") is None
    with pytest.raises(ValueError, match="parameter `Steps` is `0.5`, which is not a whole number from 0 to 10"):
        harness.add(Turn, Steps=0.5)


def test_a_default_fits_its_parameter():
    cases = [(int, (0, 10), 2.5), (float, (0, 1), 2), (str, ("eco", "boost"), "fast"), (dca.Length, ("1 m", None), "1 cm")]
    for kind, limits, default in cases:
        with pytest.raises(ValueError, match="the default does not fit: parameter `odd` is"):

            @dca.service("Declares.")
            class Odd:
                odd = dca.parameter(kind, limits, default=default)

                def main_calc(self, tick):
                    pass


def test_a_reason_that_is_not_text_is_told():
    @dca.task("Fails.")
    class Fails:
        def main_calc(self, tick):
            return dca.abort("cannot read /tmp/\udcff")

    harness = dca.testing.Harness()
    harness.add(Fails).start()
    assert harness.run("1 s").reason == "cannot read /tmp/\\udcff"
