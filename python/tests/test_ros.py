"""The standard messages of ROS 2.

Their bytes equal those of Rust and `rosbags`, their fields have ROS values, and errors name wrong fields.
"""

import array
import copy
import json
import math
import os
import pickle
import random
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import dca
import dca.testing
import pytest
from dca import _dca, ros

from conftest import ROOT, target

GOLDEN = ROOT / "ros" / "tests" / "golden" / "rosbags.txt"
WIDTHS = {"byte": (0, 8), "uint8": (0, 8), "int8": (-7, 7), "uint16": (0, 16), "int16": (-15, 15)}
WIDTHS |= {"uint32": (0, 32), "int32": (-31, 31), "uint64": (0, 64), "int64": (-63, 63)}
LETTERS = {"byte": "B", "uint8": "B", "int8": "b", "uint16": "H", "int16": "h", "uint32": "I", "int32": "i"}
LETTERS |= {"uint64": "Q", "int64": "q", "float32": "f", "float64": "d"}
PACKAGES = sorted(path.stem for path in Path(ros.__file__).parent.glob("[a-z]*.py"))


def standard(spec: str) -> Any:
    _, package, name = spec.split(".")
    return getattr(getattr(ros, package), name)


def types() -> list[str]:
    return [f"ros.{package}.{name}" for package in PACKAGES for name in _dca.ros_names(package)]


def number(dice: random.Random, of: str) -> Any:
    if of == "bool":
        return dice.random() < 0.5
    if of == "string":
        return "".join(dice.choice("aä€😀 \n") for _ in range(dice.randrange(12)))
    if of in WIDTHS:
        low, high = WIDTHS[of]
        ends = (-(2**-low) if low else 0, 2**high - 1)
        return dice.choice((*ends, 0, 1, dice.randint(*ends)))
    value = dice.choice((0.0, -0.0, 1.5, dice.uniform(-1e9, 1e9), dice.uniform(-1, 1)))
    return struct.unpack("f", struct.pack("f", value))[0] if of == "float32" else value


def message(dice: random.Random, spec: str, depth: int = 0) -> Any:
    """Returns a message with random fields."""
    values = {}
    for field in _dca.ros_definition(spec).fields:
        one = lambda of=field.of: message(dice, of, depth + 1) if "." in of else number(dice, of)  # noqa: E731
        if field.count is None:
            values[field.name] = one()
            continue
        most = 1 if "range" in field.name else max(0, 3 - depth)
        many = [one() for _ in range(field.count or dice.randint(0, most))]
        # Half of the lists of numbers are arrays.
        values[field.name] = array.array(LETTERS[field.of], many) if field.of in LETTERS and dice.random() < 0.5 else many
    return standard(spec)(**values)


def plain(value: Any) -> Any:
    """Returns a value in the form of JSON. Floats become the bits of a `float32`, which are equal for different texts of one number."""
    if isinstance(value, ros.Message):
        return {field.name: plain(getattr(value, field.name)) for field in _dca.ros_definition(spec_of(value)).fields}
    if isinstance(value, dict):
        return {name: plain(one) for name, one in value.items()}
    if isinstance(value, float):
        return struct.pack("f", value).hex()
    return value if isinstance(value, (bool, int, str)) else [plain(one) for one in value]


def spec_of(value: Any) -> str:
    return dca._message.message_type(type(value)).name




@pytest.fixture(scope="module")
def reference() -> Path:
    program = target() / "debug" / "examples" / "golden"
    if not program.exists():
        pytest.skip("there is no reference: `cargo build -p dca-python --example golden` makes it")
    return program


def check_random(reference: Path, values: int, seed: int) -> None:
    dice = random.Random(seed)
    cases = [message(dice, spec) for spec in types() for _ in range(values)]
    ours = [ros.to_cdr(one) for one in cases]
    questions = [{"ros": spec_of(one), "bytes": data.hex()} for one, data in zip(cases, ours, strict=True)]
    text = "".join(json.dumps(question) + "\n" for question in questions)
    told = subprocess.run([reference], input=text, capture_output=True, text=True, timeout=300, check=True)
    answers = [json.loads(line) for line in told.stdout.splitlines()]
    assert len(answers) == len(cases) >= 190 * values
    for case, data, answer in zip(cases, ours, answers, strict=True):
        assert answer is not None, case
        assert answer["bytes"] == data.hex(), case
        assert plain(answer["value"]) == plain(case), case
        wire = dca.encode(case)
        assert wire == bytes.fromhex(answer["wire"])
        back = dca.decode(type(case), wire)
        assert back == case == ros.from_cdr(type(case), data), (back, case)
        assert ros.to_cdr(back) == data


def test_random_values_of_every_type_have_the_bytes_of_rust(reference):
    check_random(reference, 3, int(os.environ.get("SEED", "1")))


@pytest.mark.skipif("DCA_LONG" not in os.environ, reason="long: 40,000 values; DCA_LONG=1 runs it")
def test_many_random_values_of_every_type_have_the_bytes_of_rust(reference):
    check_random(reference, 200, int(os.environ.get("SEED", "2")))


def shown(value: Any, of: Any = None) -> str:
    """Returns a value in the form of `ros/generate/values.py`."""
    if isinstance(value, ros.Message):
        fields = _dca.ros_definition(spec_of(value)).fields
        return "{" + ",".join(shown(getattr(value, field.name), field.of) for field in fields) + "}"
    if isinstance(value, str):
        return f'"{value.encode().hex()}"'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return struct.pack(">f" if of == "float32" else ">d", value).hex()
    return "[" + ",".join(shown(one, of) for one in value) + "]"


def test_values_of_rosbags_are_read_and_written():
    count, cls = 0, ros.std.Empty
    for line in GOLDEN.read_text().splitlines():
        kind, name, rest = line.split(" ", 2)
        if kind == "T":
            package, folder, short = name.split("/")
            cls = standard(f"ros.{package.removesuffix('_msgs').removesuffix('_interfaces')}.{short}")
            assert folder == "msg"
            continue
        value = ros.from_cdr(cls, bytes.fromhex(name))
        assert shown(value) == rest
        assert ros.to_cdr(value).hex() == name
        count += 1
    assert count == 21


def test_fields_have_the_defaults_and_constants_of_ros():
    assert ros.geometry.Quaternion() == ros.geometry.Quaternion(0.0, 0.0, 0.0, 1.0)
    assert ros.geometry.PoseWithCovariance().covariance == [0.0] * 36
    assert ros.visualization.Marker.CUBE == 1 and ros.sensor.NavSatStatus.STATUS_NO_FIX == -1
    assert ros.unique_identifier.UUID().uuid == bytes(16)
    assert not hasattr(ros.sensor, "LaserScam") and not hasattr(ros, "sensors")
    assert "LaserScan" in dir(ros.sensor) and ros.sensor.LaserScan.__module__ == "dca.ros.sensor"
    one, other = ros.nav.Path(), ros.nav.Path()
    one.poses.append(ros.geometry.PoseStamped())
    assert other.poses == [] and one != other


def test_arrays_arrive_as_views_that_cannot_be_written():
    scan = ros.sensor.LaserScan(ranges=[0.5, 1.5], intensities=array.array("f", [2.0]))
    back = dca.decode(ros.sensor.LaserScan, dca.encode(scan))
    assert isinstance(back.ranges, memoryview) and back.ranges.readonly and back.ranges.format == "f"
    assert list(back.ranges) == [0.5, 1.5] and min(back.ranges) == 0.5 and back == scan
    empty = dca.decode(ros.sensor.LaserScan, dca.encode(ros.sensor.LaserScan())).ranges
    assert isinstance(empty, memoryview) and empty.readonly and empty.format == "f" and len(empty) == 0
    image = ros.sensor.Image(data=bytes(range(256)) * 40)
    data = dca.decode(ros.sensor.Image, dca.encode(image)).data
    assert type(data.obj).__name__ == "Piece" and data == image.data, "bytes are not copied"
    grid = dca.decode(ros.nav.OccupancyGrid, dca.encode(ros.nav.OccupancyGrid(data=[-1, 100])))
    assert list(grid.data) == [-1, 100]


def test_numpy_sees_numbers_without_a_copy():
    numpy = pytest.importorskip("numpy")
    scan = ros.sensor.LaserScan(ranges=numpy.linspace(0, 1, 5, dtype=numpy.float32))
    back = dca.decode(ros.sensor.LaserScan, dca.encode(scan))
    ranges = numpy.asarray(back.ranges)
    assert ranges.dtype == numpy.float32 and ranges.flags.aligned and not ranges.flags.owndata and not ranges.flags.writeable
    assert (ranges == scan.ranges).all() and back == scan
    for wrong in (numpy.zeros((2, 2), dtype=numpy.float32), numpy.float32(1.0), numpy.zeros((2, 2))):
        with pytest.raises(TypeError, match="^ranges: expected a"):
            dca.encode(ros.sensor.LaserScan(ranges=wrong))
    # An image and an array with a fixed number of elements are written row by row.
    image = ros.sensor.Image(data=numpy.arange(6, dtype=numpy.uint8).reshape(2, 3))
    assert bytes(dca.decode(ros.sensor.Image, dca.encode(image)).data) == bytes(range(6))
    # Numbers of another size are written one by one.
    scan.ranges = numpy.linspace(0, 1, 5)
    assert dca.decode(ros.sensor.LaserScan, dca.encode(scan)) == back
    pose = ros.geometry.PoseWithCovariance(covariance=numpy.arange(36.0).reshape(6, 6).T)
    assert list(ros.from_cdr(type(pose), ros.to_cdr(pose)).covariance)[:3] == [0.0, 6.0, 12.0]


@pytest.mark.parametrize(
    ("spec", "values", "error", "text"),
    [
        ("ros.geometry.Twist", dict(linear=None), TypeError, "linear: expected a `ros.geometry.Vector3`, got None"),
        ("ros.geometry.Twist", dict(linear=ros.geometry.Vector3("x")), TypeError, "linear.x: expected a number, got 'x'"),
        ("ros.geometry.Twist", dict(linear=ros.geometry.Vector3(math.nan)), ValueError, "linear.x: nan is not a finite number"),
        ("ros.geometry.PoseWithCovariance", dict(covariance=[1.0]), ValueError, "covariance: expected 36 elements, got 1"),
        (
            "ros.geometry.PoseWithCovariance",
            dict(covariance=array.array("d", [math.inf] * 36)),
            ValueError,
            "covariance: a number in it is not finite",
        ),
        ("ros.std.UInt8", dict(data=256), ValueError, "data: 256 does not fit into uint8"),
        ("ros.std.UInt8", dict(data=-1), ValueError, "data: -1 does not fit into uint8"),
        ("ros.std.Int64", dict(data=2**63), ValueError, "data: 9223372036854775808 does not fit into int64"),
        ("ros.std.Int8", dict(data=1.0), TypeError, "data: expected a whole number, got 1.0"),
        ("ros.std.Float32", dict(data=1e39), ValueError, "data: 1e+39 does not fit into float32"),
        ("ros.std.Bool", dict(data=1), TypeError, "data: expected a bool, got 1"),
        ("ros.std.String", dict(data=b"a"), TypeError, "data: expected a str, got b'a'"),
        ("ros.std.String", dict(data="a\0b"), ValueError, r"data: 'a\x00b' has a zero byte in it, where ROS 2 ends a text"),
        ("ros.std.Float64MultiArray", dict(data=b"12"), TypeError, "data: expected a list, got b'12'"),
        ("ros.std.Int8MultiArray", dict(data=bytearray(b"12")), TypeError, "data: expected a list, got bytearray"),
        ("ros.std.Float64MultiArray", dict(data="12"), TypeError, "data: expected a list, got '12'"),
        ("ros.std.Float64MultiArray", dict(data=3), TypeError, "data: expected a list, got 3"),
        (
            "ros.rcl.ParameterDescriptor",
            dict(integer_range=[ros.rcl.IntegerRange()] * 2),
            ValueError,
            "integer_range: expected at most 1 elements, got 2",
        ),
    ],
)
def test_a_wrong_field_is_named(spec, values, error, text):
    with pytest.raises(error) as raised:
        dca.encode(standard(spec)(**values))
    assert str(raised.value).startswith(text)


def test_sensors_may_send_numbers_that_are_not_finite():
    scan = ros.sensor.LaserScan(ranges=[math.inf, 1.0], angle_min=math.nan)
    assert math.isinf(dca.decode(ros.sensor.LaserScan, dca.encode(scan)).ranges[0])


def test_damaged_bytes_are_read_or_refused():
    dice = random.Random(3)
    read = refused = 0
    for spec in types():
        whole = dca.encode(message(dice, spec))
        for _ in range(20):
            damaged = bytearray(whole)
            damaged[dice.randrange(len(damaged))] ^= 1 << dice.randrange(8)
            del damaged[dice.randint(len(damaged) // 2, 2 * len(damaged)) :]
            try:
                dca.decode(standard(spec), bytes(damaged))
                read += 1
            except ValueError:
                refused += 1
    assert read > 100 and refused > 100


def test_a_message_is_copied_and_pickled():
    scan = dca.decode(ros.sensor.LaserScan, dca.encode(ros.sensor.LaserScan(ranges=[1.0])))
    assert copy.deepcopy(scan) == scan == pickle.loads(pickle.dumps(scan))


@dca.message
@dataclass
class Plan:
    goal: ros.geometry.Pose
    way: list[ros.geometry.Point]
    scan: ros.sensor.Image


def test_a_message_of_a_program_has_messages_of_ros():
    assert dca._message.message_type(Plan).fields == (
        "goal: ros.geometry.Pose, way: ros.geometry.Point[], scan: ros.sensor.Image"
    )
    plan = Plan(ros.geometry.Pose(), [ros.geometry.Point(1.0)], ros.sensor.Image(data=b"abc"))
    data = dca.encode(plan)
    pose = ros.to_cdr(plan.goal)
    assert data[: len(pose) + 1] == bytes([len(pose)]) + pose
    assert dca.decode(Plan, data) == plan


def test_controllers_have_ports_calls_and_procedures_of_ros():
    @dca.service("Turns away.", triggered_by="Scan")
    class Avoid:
        Scan = dca.In(ros.sensor.LaserScan)
        Cmd = dca.Out(ros.geometry.Twist)

        def main_calc(self, tick):
            if scan := self.Scan.fresh():
                command = ros.geometry.Twist()
                command.angular.z = 1.0 if min(scan.ranges) < 0.5 else 0.0
                self.Cmd.send(command)

        @dca.procedure
        def Set(self, request: ros.std_srvs.SetBool_Request) -> ros.std_srvs.SetBool_Response:
            return ros.std_srvs.SetBool_Response(success=request.data)

    @dca.task("Asks.", triggered_by="Set")
    class Ask:
        Set = dca.Calls(ros.std_srvs.SetBool_Request, ros.std_srvs.SetBool_Response)

        def init(self, value):
            self.call = self.Set.call(ros.std_srvs.SetBool_Request(data=True), within="1 s")

        def main_calc(self, tick):
            if self.call.done:
                return dca.done(self.call.result())

    harness = dca.testing.Harness()
    avoid = harness.add(Avoid).start()
    avoid.send("Scan", ros.sensor.LaserScan(ranges=[0.4, 3.0]))
    harness.run("10 ms")
    assert avoid.last("Cmd").angular.z == 1.0
    assert Ask.Set.argument.name == "ros.std_srvs.SetBool_Request"


def test_the_package_is_not_imported_before_it_is_named():
    script = "import sys, dca; assert 'dca.ros' not in sys.modules; dca.ros.sensor.LaserScan; assert 'dca.ros.nav' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=30)


def test_a_type_checker_knows_the_messages(tmp_path):
    checker = Path(sys.executable).parent / "basedpyright"
    if not checker.exists():
        pytest.skip("there is no `basedpyright` in this environment")
    good = (Path(__file__).parent / "typed_ros.py").read_text()
    (tmp_path / "good.py").write_text(good)
    (tmp_path / "bad.py").write_text("from dca import ros\nros.geometry.Vector3(x='a')\nros.sensor.LaserScan().range\n")
    settings = {"extraPaths": [str(ROOT / "python")], "typeCheckingMode": "standard", "pythonVersion": "3.11"}
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings))
    told = subprocess.run([checker, "--outputjson", "-p", tmp_path], capture_output=True, text=True, timeout=120)
    wrong = [one for one in json.loads(told.stdout)["generalDiagnostics"] if one["severity"] == "error"]
    assert [(Path(one["file"]).name, one["range"]["start"]["line"]) for one in wrong] == [("bad.py", 1), ("bad.py", 2)], wrong
