"""Messages: the bytes of Rust types, refused values, and permitted types of fields."""

import enum
import math
import struct
from dataclasses import dataclass
from typing import Annotated, Literal

import dca
import pytest


class Mode(enum.Enum):
    SOFT = "soft"
    HARD = "hard"


@dca.message
@dataclass(slots=True)
class Point:
    x: dca.Length
    y: dca.Length = 0.0


@dca.message
@dataclass(slots=True)
class Everything:
    force: tuple[dca.Force, dca.Force]
    at: Point
    count: int
    soft: bool
    who: str
    image: dca.Bytes
    mode: Mode
    side: Literal["left", "right"]
    near: list[float]
    sweep: Annotated[list[dca.Length], dca.Count(3)]
    stamp: dca.Time | None = None


def everything(**changed):
    values = dict(
        force=(1.0, -2.5),
        at=Point(0.5, 0.25),
        count=7,
        soft=True,
        who="ä",
        image=b"\x00\xff",
        mode=Mode.HARD,
        side="left",
        near=[1.0],
        sweep=[1.0, 2.0, 3.0],
    )
    return Everything(**(values | changed))


def test_fields_are_spelt_as_in_a_spec():
    assert dca._message.message_type(Everything).fields == (
        "force: Force[2], at: { x: Length, y: Length }, count: Number, soft: Truth, who: Text, image: Bytes, "
        "mode: Text, side: Text, near: Number[], sweep: Length[3], stamp: Time[]"
    )


def test_bytes_are_those_of_the_same_type_in_rust():
    f64 = lambda *numbers: struct.pack(f"<{len(numbers)}d", *numbers)  # noqa: E731
    expected = b"".join(
        [
            f64(1.0, -2.5),
            f64(0.5, 0.25),
            f64(7.0),
            b"\x01",
            b"\x02\xc3\xa4",
            b"\x02\x00\xff",
            b"\x04hard",
            b"\x04left",
            b"\x01" + f64(1.0),
            f64(1.0, 2.0, 3.0),
        ]
    )
    assert dca.encode(everything()) == expected + b"\x00"
    stamped = dca.encode(everything(stamp=1.5))
    assert stamped == expected + b"\x01" + f64(1.5)
    back = dca.decode(Everything, stamped)
    assert back == everything(stamp=1.5)
    assert isinstance(back.image, memoryview) and back.image.readonly
    assert back.mode is Mode.HARD and type(back.count) is int


def test_a_text_and_a_number_alone_are_messages():
    assert dca.encode("go") == b"\x02go"
    assert dca.decode(str, b"\x02go") == "go"
    assert dca.decode(float, dca.encode(2.5)) == 2.5
    with pytest.raises(ValueError):
        dca.decode(str, b"\x09go")


def test_a_long_text_has_a_long_length():
    assert dca.encode(everything(who="a" * 300)).count(b"\xac\x02" + b"a" * 300) == 1


@pytest.mark.parametrize(
    ("changed", "error", "text"),
    [
        (dict(force=(1.0,)), ValueError, "force: expected 2 elements, got 1"),
        (dict(force=(1.0, "x")), TypeError, "force: expected a number, got 'x'"),
        (dict(at=Point(math.nan)), ValueError, "at.x: nan is not a finite number"),
        (dict(at=None), TypeError, "at: expected a `Point`, got None"),
        (dict(count=1.5), TypeError, "count: expected a whole number, got 1.5"),
        (dict(count=2**60), ValueError, "count: 1152921504606846976 is beyond 2^53"),
        (dict(count=2**53 + 1), ValueError, "count: 9007199254740993 is beyond 2^53"),
        (dict(count=-(2**53) - 1), ValueError, "count: -9007199254740993 is beyond 2^53"),
        (dict(count=-(2**63)), ValueError, "count: -9223372036854775808 is beyond 2^53"),
        (dict(count=2**80), ValueError, "count: 1208925819614629174706176 is beyond 2^53"),
        (dict(soft=1), TypeError, "soft: expected a bool, got 1"),
        (dict(who=b"x"), TypeError, "who: expected a str"),
        (dict(image=3), TypeError, "image: expected bytes"),
        (dict(image="x"), TypeError, "image: expected bytes"),
        (dict(mode="hard"), TypeError, "mode: expected one of `soft`, `hard`"),
        (dict(side="up"), TypeError, "side: expected one of `left`, `right`"),
        (dict(near=3), TypeError, "near: expected a list, got 3"),
        (dict(near=b"12"), TypeError, "near: expected a list, got b'12'"),
        (dict(near=bytearray(b"12")), TypeError, "near: expected a list, got bytearray"),
        (dict(near="12"), TypeError, "near: expected a list, got '12'"),
        (dict(force=b"12"), TypeError, "force: expected a list, got b'12'"),
        (dict(who="\ud800"), ValueError, "who: "),
    ],
)
def test_a_value_of_another_type_is_named(changed, error, text):
    with pytest.raises(error) as raised:
        dca.encode(everything(**changed))
    assert str(raised.value).startswith(text)


def test_the_largest_whole_numbers_are_exact():
    for count in (2**53, -(2**53)):
        assert dca.decode(Everything, dca.encode(everything(count=count))).count == count


def test_any_buffer_goes_out():
    plain = dca.encode(everything(image=b"abcdef"))
    for buffer in (bytearray(b"abcdef"), memoryview(b"abcdef"), memoryview(b"abcdefgh")[:6]):
        assert dca.encode(everything(image=buffer)) == plain
    numpy = pytest.importorskip("numpy")
    image = numpy.frombuffer(b"abcdef", dtype=numpy.uint8).reshape(2, 3)
    assert dca.encode(everything(image=image)) == plain
    # A slice of columns is not contiguous, so it is copied.
    assert dca.decode(Everything, dca.encode(everything(image=image[:, :2]))).image == b"abde"
    assert numpy.asarray(dca.decode(Everything, plain).image).sum() == sum(b"abcdef")


def test_hostile_bytes_are_refused():
    whole = dca.encode(everything(stamp=1.5))
    for end in range(len(whole)):
        with pytest.raises(ValueError):
            dca.decode(Everything, whole[:end])
    with pytest.raises(ValueError):
        dca.decode(Everything, whole + b"\x00")
    with pytest.raises(ValueError):
        dca.decode(Everything, whole.replace(b"\x04hard", b"\x04herd"))
    for place in range(len(whole)):
        for byte in (0, 1, 127, 128, 255):
            changed = whole[:place] + bytes([byte]) + whole[place + 1 :]
            try:
                dca.decode(Everything, changed)
            except ValueError:
                pass


def test_not_finite_numbers_travel_where_the_type_allows_it():
    @dca.message(allow_nan=True, name="Sweep")
    @dataclass
    class Ranges:
        all: list[float]

    assert dca._message.message_type(Ranges).name == "Sweep"
    back = dca.decode(Ranges, dca.encode(Ranges([math.inf, 1.0])))
    assert back.all == [math.inf, 1.0]


def test_what_cannot_be_in_a_message_is_named():
    def refused(annotation, text):
        with pytest.raises(TypeError) as raised:
            cls = dataclass(type("Odd", (), {"__annotations__": {"x": annotation}}))
            dca.message(cls)
        assert text in str(raised.value), raised.value

    refused(dict, "Odd.x: `dict` cannot be in a message")
    refused(tuple[int, float], "Odd.x: the elements of a tuple are of one type")
    refused(list[list[int]], "Odd.x: a list of lists or of optional values")

    @dataclass
    class Bare:
        y: float

    refused(list[Bare], "Odd.x: a record in a list is a message: write @dca.message above `Bare`")
    refused(int | str, "Odd.x: ")
    refused(enum.Enum("Number", {"ONE": 1}), "Odd.x: the values of an Enum in a message are strings")
    with pytest.raises(TypeError, match="write @dataclass between"):
        dca.message(type("Plain", (), {}))
    with pytest.raises(TypeError, match="is not a message"):
        dca.encode(3)

    @dataclass
    class Late:
        stamp: float

    with pytest.raises(TypeError, match="the time of measurement is a dca.Time"):
        dca.message(Late)


def test_a_list_of_records_has_them_by_name():
    @dca.message
    @dataclass
    class Way:
        points: list[Point]
        ends: tuple[Point, Point]
        back: Point | None = None

    way = Way([Point(1.0), Point(2.0, 3.0)], (Point(4.0), Point(5.0)))
    made = dca._message.message_type(Way)
    assert made.fields == "points: Point[], ends: Point[2], back: Point[]"
    assert made.inner == [("Point", "x: Length, y: Length")]
    assert dca.decode(Way, dca.encode(way)) == way
    assert dca.encode(way) == struct.pack("<B8dB", 2, 1.0, 0.0, 2.0, 3.0, 4.0, 0.0, 5.0, 0.0, 0)

    @dca.service("Goes.")
    class Goes:
        In = dca.In(Way)

        def main_calc(self, tick):
            pass

    text = dca._dca.interface([dca._controller.declaration(Goes)])
    assert "type Point = { x: Length, y: Length };\ntype Way = { points: Point[], " in text


def test_a_message_of_a_device_has_its_numbers():
    @dca.message(of_device=True)
    @dataclass
    class FtState:
        stamp: dca.Stamp
        force: tuple[float, float, float]
        zeroed: dca.Natural

    assert dca._message.message_type(FtState).fields == ""
    state = FtState(1.5, (1.0, 2.0, 3.0), 300)
    data = dca.encode(state)
    assert data == bytes([0x80, 0xDE, 0xA0, 0xCB, 0x05]) + struct.pack("<3d", 1.0, 2.0, 3.0) + bytes([0xAC, 0x02])
    assert dca.decode(FtState, data) == state
    with pytest.raises(TypeError, match="zeroed: expected a whole number from 0 on, got -1"):
        dca.encode(FtState(1.5, (1.0, 2.0, 3.0), -1))
    with pytest.raises(TypeError, match="stamp: expected a time in seconds, got -1.0"):
        dca.encode(FtState(-1.0, (1.0, 2.0, 3.0), 0))
    @dca.message(of_device=True)
    @dataclass
    class Command:
        rates: tuple[float, float] | None
        marks: tuple[tuple[float, float] | None, tuple[float, float] | None]
        fence: dca.Natural | None

    command = Command((1.0, 2.0), (None, (3.0, 4.0)), 300)
    assert dca.encode(command) == struct.pack("<B2dBB2dBBB", 1, 1.0, 2.0, 0, 1, 3.0, 4.0, 1, 0xAC, 0x02)
    assert dca.decode(Command, dca.encode(command)) == command
    with pytest.raises(TypeError, match="x: a spec has no word for this field"):

        @dca.message
        @dataclass
        class Wire:
            x: dca.Stamp

    with pytest.raises(TypeError, match="a list has one element at least"):

        @dca.message
        @dataclass
        class Nothing:
            x: Annotated[list[float], dca.Count(0)]


def test_a_post_init_may_look_at_a_value():
    @dca.message
    @dataclass
    class Positive:
        x: float

        def __post_init__(self):
            if self.x < 0:
                raise ValueError("x is negative")

    with pytest.raises(ValueError, match="x is negative"):
        dca.decode(Positive, struct.pack("<d", -1.0))


def test_a_view_keeps_its_bytes_and_is_read_only():
    import gc

    back = dca.decode(Everything, dca.encode(everything(image=bytes(range(256)) * 4096)))
    view = back.image
    part = view[256:512]
    with pytest.raises(TypeError):
        view[0] = 1
    del back, view
    gc.collect()
    assert part == bytes(range(256))
    part.release()
    with pytest.raises(ValueError):
        part[0]


@dca.message
@dataclass(slots=True)
class Image:
    pixels: dca.Bytes


def test_views_keep_a_limited_number_of_bytes():
    data = dca.encode(Image(bytes(64 << 20)))
    kept = []
    with pytest.raises(MemoryError, match=r"views keep 512 MiB of values that have arrived: .* copy what is kept with bytes\(view\)"):
        for _ in range(9):
            kept.append(dca.decode(Image, data))
    assert len(kept) == 7
    # A second view of a value takes no further room, and a released view frees its room.
    memoryview(kept[0].pixels)
    kept.pop().pixels.release()
    kept.append(dca.decode(Image, data))
    # Views in a reference cycle free their room as well: the garbage collector is called when room is needed.
    circle = [kept.pop()]
    circle.append(circle)
    del circle
    kept.append(dca.decode(Image, data))


def test_addresses_of_objects_are_not_bytes():
    numpy = pytest.importorskip("numpy")
    with pytest.raises(TypeError, match="pixels: expected bytes, or another buffer"):
        dca.encode(Image(numpy.array([object()], dtype=object)))
    strided = numpy.arange(20000, dtype=numpy.uint8)[::2]
    strided.flags.writeable = False
    assert dca.decode(Image, dca.encode(Image(strided))).pixels == strided.tobytes()
    assert dca.encode(Image(numpy.zeros((3, 0)))) == b"\x00"


def test_a_list_that_never_ends_is_refused():
    class Endless:
        def __len__(self):
            return 3

        def __iter__(self):
            while True:
                yield 1.0

    with pytest.raises(ValueError, match="sweep: the list has changed"):
        dca.encode(everything(sweep=Endless()))
    with pytest.raises(ValueError, match="near: the list has changed"):
        dca.encode(everything(near=Endless()))


def test_a_message_that_contains_itself_is_refused():
    class Chain:
        next: "list[Chain]"

    with pytest.raises(TypeError, match="Chain: a message cannot contain itself"):
        dca.message(dataclass(Chain))
