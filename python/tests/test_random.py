"""Random types and values: serde and postcard write the same bytes for the same type in Rust, and the values are read back unchanged."""

import dataclasses
import json
import os
import random
import struct
import subprocess
from pathlib import Path
from typing import Annotated, Any

import dca
import pytest

from conftest import target

ROUNDS = 520
VALUES = 20


def size(dice: random.Random) -> int:
    """Returns the length of a text or a list; sometimes one that needs two bytes."""
    return dice.randrange(128, 200) if dice.random() < 0.02 else dice.randrange(20)


def bits(number: float) -> int:
    return struct.unpack("<Q", struct.pack("<d", number))[0]


class Reference:
    """The program of `examples/golden.rs`."""

    def __init__(self, program: Path) -> None:
        self.program = program

    def ask(self, questions: list[dict[str, Any]]) -> list[Any]:
        text = "".join(json.dumps(question) + "\n" for question in questions)
        told = subprocess.run([self.program], input=text, capture_output=True, text=True, timeout=120, check=True)
        return [json.loads(line) for line in told.stdout.splitlines()]


@pytest.fixture(scope="module")
def reference() -> Reference:
    program = target() / "debug" / "examples" / "golden"
    if not program.exists():
        pytest.skip("there is no reference: `cargo build -p dca-python --example golden` makes it")
    return Reference(program)


def leaf(dice: random.Random) -> tuple[Any, Any, Any, Any]:
    """Returns an annotation, its type for the reference, a function that makes a value, and the same value for the reference."""
    number = lambda: dice.choice((0.0, -0.0, 5e-324, 1.7e308, dice.uniform(-1e9, 1e9)))  # noqa: E731
    text = lambda: "".join(dice.choice("aä€😀\0") for _ in range(size(dice)))  # noqa: E731
    return dice.choice(
        [
            (float, "number", number, bits),
            (dca.Force, "number", number, bits),
            (int, "number", lambda: dice.randrange(-(2**53), 2**53), lambda value: bits(float(value))),
            (bool, "truth", lambda: dice.random() < 0.5, lambda value: value),
            (str, "text", text, lambda value: value),
            (dca.Bytes, "bytes", lambda: memoryview(dice.randbytes(size(dice))), lambda value: bytes(value).hex()),
        ]
    )


def field(dice: random.Random, depth: int) -> tuple[Any, Any, Any, Any]:
    kind = dice.randrange(7) if depth < 4 else 0
    if kind == 5:
        return record(dice, depth + 1)
    if kind == 6:
        cls, of, make, told = record(dice, depth + 1)
        many = lambda: [make() for _ in range(dice.randrange(4))]  # noqa: E731
        return list[cls], ["list", of, None], many, lambda values: [told(one) for one in values]
    annotation, of, make, told = leaf(dice)
    count = dice.randrange(1, 4)
    each = lambda values: [told(one) for one in values]  # noqa: E731
    if kind == 1:
        return list[annotation], ["list", of, None], lambda: [make() for _ in range(size(dice))], each
    if kind == 2:
        fixed = Annotated[list[annotation], dca.Count(count)]
        return fixed, ["list", of, count], lambda: [make() for _ in range(count)], each
    if kind == 3 and annotation is not dca.Bytes:
        maybe = lambda: make() if dice.random() < 0.5 else None  # noqa: E731
        return annotation | None, ["optional", of], maybe, lambda value: None if value is None else told(value)
    if kind == 4:
        return tuple[(annotation,) * count], ["list", of, count], lambda: tuple(make() for _ in range(count)), each
    return annotation, of, make, told


def record(dice: random.Random, depth: int = 0) -> tuple[Any, Any, Any, Any]:
    fields = [(f"f{at}", *field(dice, depth)) for at in range(dice.randrange(1, 5))]
    cls = dataclasses.make_dataclass(f"Any{dice.randrange(1 << 32)}", [(name, annotation) for name, annotation, *_ in fields])
    return (
        dca.message(cls),
        ["record", [of for _, _, of, _, _ in fields]],
        lambda: cls(*(make() for _, _, _, make, _ in fields)),
        lambda value: [told(getattr(value, name)) for name, *_, told in fields],
    )


def test_random_types_and_values_are_those_of_rust(reference):
    dice = random.Random(int(os.environ.get("SEED", "1")))
    cases = []
    for _ in range(ROUNDS):
        cls, of, make, told = record(dice)
        cases += [(cls, of, told, make()) for _ in range(VALUES)]
    assert len(cases) >= 10_000
    encoded = reference.ask([{"type": of, "value": told(value)} for _, of, told, value in cases])
    ours = [dca.encode(value) for *_, value in cases]
    assert ours == [bytes.fromhex(one) for one in encoded]
    assert [dca.decode(cls, data) for (cls, *_), data in zip(cases, ours, strict=True)] == [value for *_, value in cases]
    back = reference.ask([{"type": of, "bytes": data.hex()} for (_, of, *_), data in zip(cases, ours, strict=True)])
    assert back == [told(value) for _, _, told, value in cases]


def test_bytes_that_rust_refuses_are_refused_and_no_bytes_crash(reference):
    dice = random.Random(int(os.environ.get("SEED", "2")))
    cases = []
    for _ in range(ROUNDS):
        cls, of, make, told = record(dice)
        for _ in range(VALUES):
            hostile = bytearray(dca.encode(make()))
            for _ in range(dice.randrange(4)):
                if hostile:
                    hostile[dice.randrange(len(hostile))] = dice.choice((0, 1, 2, 127, 128, 255))
            if dice.random() < 0.5:
                del hostile[dice.randrange(len(hostile) + 1) :]
            if dice.random() < 0.1:
                hostile += dice.randbytes(3)
            cases.append((cls, of, told, bytes(hostile)))
    read = reference.ask([{"type": of, "bytes": data.hex()} for _, of, _, data in cases])
    taken = 0
    for (cls, _, told, data), theirs in zip(cases, read, strict=True):
        try:
            value = dca.decode(cls, data)
        except ValueError:
            continue
        taken += 1
        assert theirs is not None and told(value) == theirs, (cls, data)
    assert taken > ROUNDS
