"""Random types and values: the bytes are those that postcard writes for the same type in Rust, and come back as they were."""

import dataclasses
import random
import struct
from typing import Annotated, Any

import dca

ROUNDS = 500
VALUES = 20


def length(number: int) -> bytes:
    """A number of variable length: seven bits a byte, the lowest first."""
    out = bytearray()
    while number >= 0x80:
        out.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*out, number])


def leaf(dice: random.Random) -> tuple[Any, Any, Any]:
    """Returns an annotation, what makes a value, and what makes its bytes: an encoder of its own, after the format's description."""
    number = lambda: dice.uniform(-1e9, 1e9)  # noqa: E731
    f64 = lambda value: struct.pack("<d", value)  # noqa: E731
    text = lambda: "".join(dice.choice("aä€😀\0") for _ in range(dice.randrange(200)))  # noqa: E731
    raw = lambda value: length(len(value)) + value  # noqa: E731
    return dice.choice(
        [
            (float, number, f64),
            (dca.Force, number, f64),
            (int, lambda: dice.randrange(-(2**53), 2**53), f64),
            (bool, lambda: dice.random() < 0.5, lambda value: bytes([value])),
            (str, text, lambda value: raw(value.encode())),
            (dca.Bytes, lambda: memoryview(dice.randbytes(dice.randrange(300))), lambda value: raw(bytes(value))),
        ]
    )


def field(dice: random.Random, depth: int) -> tuple[Any, Any, Any]:
    kind = dice.randrange(6) if depth < 4 else 0
    if kind == 5:
        cls, make, write = record(dice, depth + 1)
        return cls, make, write
    annotation, make, write = leaf(dice)
    count = dice.randrange(4)
    if kind == 1:
        return (
            list[annotation],
            lambda: [make() for _ in range(dice.randrange(150))],
            lambda values: length(len(values)) + b"".join(map(write, values)),
        )
    if kind == 2:
        fixed = Annotated[list[annotation], dca.Count(count)]
        return fixed, lambda: [make() for _ in range(count)], lambda values: b"".join(map(write, values))
    if kind == 3 and annotation is not dca.Bytes:
        optional = annotation | None if annotation is not dca.Force else dca.Force | None
        return (
            optional,
            lambda: make() if dice.random() < 0.5 else None,
            lambda value: b"\0" if value is None else b"\1" + write(value),
        )
    if kind == 4:
        of = (annotation,) * (count + 1)
        return (
            tuple[of],
            lambda: tuple(make() for _ in range(count + 1)),
            lambda values: b"".join(map(write, values)),
        )
    return annotation, make, write


def record(dice: random.Random, depth: int = 0) -> tuple[Any, Any, Any]:
    fields = [(f"f{at}", *field(dice, depth)) for at in range(dice.randrange(1, 5))]
    cls = dataclasses.make_dataclass("Any", [(name, annotation) for name, annotation, _, _ in fields])
    return (
        dca.message(cls),
        lambda: cls(*(make() for _, _, make, _ in fields)),
        lambda value: b"".join(write(getattr(value, name)) for name, _, _, write in fields),
    )


def test_random_types_and_values():
    dice = random.Random(1)
    for _ in range(ROUNDS):
        cls, make, write = record(dice)
        for _ in range(VALUES):
            value = make()
            data = dca.encode(value)
            assert data == write(value)
            assert dca.decode(cls, data) == value
            hostile = bytearray(data)
            for _ in range(3):
                if hostile:
                    hostile[dice.randrange(len(hostile))] = dice.choice((0, 1, 2, 127, 128, 255))
            del hostile[dice.randrange(len(hostile) + 1) :]
            try:
                back = dca.decode(cls, bytes(hostile))
            except ValueError:
                continue
            assert dca.decode(cls, dca.encode(back)) == back or "nan" in repr(back)
