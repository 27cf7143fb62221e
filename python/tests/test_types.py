"""Message types that are written once in a spec: `dca types` prints dataclasses and structs that declare the same fields."""

import re

import dca

SPEC = """
/// A way to go.
type Way = { points: Point[], goal: { at: Point, reached: Truth }, sides: Force[2], stamp: Time[] };
type Point = { x: Length, y: Length, label: Text };
type Frame = { image: Bytes, box: Number[4] };
process main(){
}
"""


def test_both_languages_declare_the_same_fields(missions):
    missions.write("robot.dca", SPEC)
    python, rust = missions("types", "--python", "robot.dca"), missions("types", "--rust", "robot.dca")
    assert python.returncode == 0 and rust.returncode == 0, python.stderr + rust.stderr
    names: dict = {"__name__": "robot_types"}
    exec(compile(python.stdout, "robot_types.py", "exec"), names)  # noqa: S102
    fields = dict(re.findall(r'TYPE: &\'static str = "(\w+)";\s+const FIELDS: &\'static str = "([^"]*)"', rust.stdout))
    assert set(fields) == {"Way", "Point", "Frame"}
    for name, declared in fields.items():
        assert dca._message.message_type(names[name]).fields == declared
    way = names["Way"]([names["Point"](1.0, 2.0, "a")], names["WayGoal"](names["Point"](0.0, 0.0, ""), True), [1.0, 2.0], 3.0)
    assert dca.decode(names["Way"], dca.encode(way)) == way


def test_a_spec_without_types_is_told(missions):
    missions.write("robot.dca", "process main(){\n}\n")
    told = missions("types", "--python", "robot.dca")
    assert told.returncode == 1 and "declares no record type" in told.stderr
    assert missions("types", "robot.dca").returncode == 2
