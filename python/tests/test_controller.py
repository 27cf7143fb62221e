"""Declarations of controllers in the form of a spec, and errors that are reported at the class definition."""

import re
from dataclasses import dataclass, make_dataclass

import dca
import pytest


@dca.message
@dataclass
class Range:
    distance: dca.Length
    stamp: dca.Time | None = None


@dca.message
@dataclass
class Velocity:
    forward: dca.Speed = 0.0


def keeper(**about):
    @dca.service("Keeps a distance to the wall.", every="20 ms", triggered_by="In", stop_within="300 ms", **about)
    class Keep:
        In = dca.In(Range, doc="What the laser sees.")
        limit = dca.Every(Velocity, "Limit", optional=True)
        Out = dca.Out(Velocity)
        reach = dca.parameter(dca.Length, ("10 cm", 2), default="0.5 m")
        gain = dca.parameter(float, (0, None), default=0.8)
        count = dca.parameter(int, default=3)
        side = dca.parameter(str, ("left", "right"), default="left")
        loud = dca.parameter(bool)

        def main_calc(self, tick):
            pass

        def signals(self):
            return []

    return Keep


def interface(*controllers):
    return dca._dca.interface([dca._controller.declaration(one) for one in controllers])


def test_an_interface_is_that_of_a_controller_in_rust():
    assert interface(keeper(remembers=True, signals_every=0.5)) == (
        "type Range = { distance: Length, stamp: Time[] };\n"
        "type Velocity = { forward: Speed };\n"
        "\n"
        "/// Keeps a distance to the wall.\n"
        "module Keep(host: Host, reach: Length in 0.1 m..2 m = 0.5 m, gain: Number in 0.. = 0.8, count: Number = 3, "
        'side: Text in "left" | "right" = "left", loud: Truth) {\n'
        "  /// What the laser sees.\n"
        "  in In: Range;\n"
        "  in Limit: Velocity optional;\n"
        "  out Out: Velocity;\n"
        "  service;\n"
        "  remembers;\n"
        "  stop within 300 ms;\n"
        "}\n"
    )


def test_a_task_has_its_outcomes():
    @dca.task("Looks for a door.", outcomes={"found": Range, "missing": None})
    class Search:
        def main_calc(self, tick):
            return dca.outcome("found", Range(1.0))

    assert "  done(found: Range | missing);\n" in interface(Search)
    ended = Search().main_calc(dca.Tick(1.0))
    assert (ended.tag, len(ended.value)) == ("found", 9)


def test_a_start_value_has_its_type():
    @dca.task("Drives.", starts_with=Range)
    class Drive:
        def init(self, value):
            self.distance = dca.decode(Range, value).distance

        def main_calc(self, tick):
            return dca.done(b"")

    assert "  init value: Range;\n" in interface(Drive)
    drive = Drive()
    drive.init(dca.encode(Range(2.5)))
    assert drive.distance == 2.5


@pytest.mark.parametrize(
    ("about", "error", "text"),
    [
        (dict(every="20 m"), ValueError, "`20 m` is not a Time"),
        (dict(every=0), ValueError, "`every` is 0 s"),
        (dict(every=-1), ValueError, "-1 s is not a span of time"),
        (dict(triggered_by="Inn"), TypeError, "triggered_by `Inn`, which is not one of its inputs or calls"),
        (dict(signals_every="1 s"), TypeError, "signals_every needs a method"),
    ],
)
def test_what_is_wrong_is_said_at_the_class(about, error, text):
    with pytest.raises(error) as raised:

        @dca.service("Does nothing.", **about)
        class Wrong:
            In = dca.In(Range)

            def main_calc(self, tick):
                pass

    assert text in str(raised.value)


def test_wrong_parameters_are_named():
    with pytest.raises(ValueError, match="parameter `force`: `2 m` is not a Force"):

        @dca.service("Does nothing.")
        class Wrong:
            force = dca.parameter(dca.Force, ("1 N", "2 m"))

            def main_calc(self, tick):
                pass

    with pytest.raises(TypeError, match="is not a type of parameters"):
        dca.parameter(list)
    with pytest.raises(TypeError, match="there are two `In`"):

        @dca.service("Does nothing.")
        class Twice:
            In = dca.In(Range)
            other = dca.In(Range, "In")

            def main_calc(self, tick):
                pass

    with pytest.raises(TypeError, match="a controller has a method"):
        dca.service("Does nothing.")(type("Empty", (), {}))
    with pytest.raises(TypeError, match="is not a controller"):
        dca.run(int)


def test_quantities_are_in_si_units():
    assert dca.si("20 cm", dca.Length) == 0.2
    assert dca.si("2 min", dca.Time) == 120.0
    assert dca.si(3, dca.Length) == 3.0


@pytest.mark.parametrize(
    ("name", "members", "text"),
    [
        ("Keep", dict(In=dca.In(Range, "La ser")), "`in La ser: Range;` cannot be in a spec"),
        ("Keep", dict(In=dca.In(Range, "x; }")), "cannot be in a spec"),
        ("größe;", {}, "cannot be in a spec"),
        ("Keep", dict(host=dca.parameter(float, default=1)), "cannot be in a spec"),
        ("Keep", dict(wait=dca.parameter(float, default=1), name="x y"), None),
    ],
)
def test_a_name_that_cannot_be_in_a_spec_is_refused_at_the_class(name, members, text):
    cls = type(name, (), {"main_calc": lambda self, tick: None} | members)
    if text is None:
        dca.service("Does nothing.")(cls)
        return
    with pytest.raises(ValueError, match=re.escape(text)):
        dca.service("Does nothing.")(cls)


def test_capacities_and_leases_have_limits():
    for wrong in (lambda: dca.Queue(Range, capacity=0), lambda: dca.Router(Range, outbox=10**30), lambda: dca.Lock(lease="0 s")):
        with pytest.raises(ValueError):
            wrong()
    with pytest.raises(TypeError, match="has a lock `arm`, which is not one of its dca.Lock"):
        dca.service("Does nothing.")(type("Odd", (), {"Q": dca.Queue(Range, lock="arm"), "main_calc": lambda self, tick: None}))


def test_two_classes_or_message_types_of_one_name_are_refused():
    def controller(kind, name):
        message = dca.message(name="Value")(make_dataclass("M", [("x", kind)]))

        @dca.service("Does nothing.", name=name)
        class Same:
            In = dca.In(message)

            def main_calc(self, tick):
                pass

        return Same.__dca_controller__

    same = [controller(float, "One"), controller(float, "Two")]
    assert dca._dca.interface(same).count("type Value = { x: Number };") == 1
    with pytest.raises(TypeError, match="there are two controllers `One`: give one of them another `name`"):
        dca._dca.interface([same[0], controller(float, "One")])
    with pytest.raises(TypeError, match="there are two message types `Value`"):
        dca._dca.interface([same[0], controller(str, "Two")])
