"""Message types from dataclasses.

Other programs see a field in the spelling of a spec (second column). It has the bytes of the Rust type (third column):

    float               Number          f64
    dca.Force ...       Force           f64
    int                 Number          f64, which holds whole numbers up to 2^53
    bool                Truth           bool
    str                 Text            String
    dca.Bytes           Bytes           Bytes; read as a read-only memoryview
    Enum of strings     Text            String
    list[X]             X[]             Vec<X>
    tuple[X, X, X]      X[3]            [X; 3]
    X | None            X[]             Option<X>, whose bytes are those of a list of at most one
    a dataclass         { ... }         a struct
    dca.ros.std.Header  ros.std.Header  a struct of controllers::ros
    list[M], M a message M[]            Vec<M>

A port may also have the plain type `str` or `float`: `Heard = dca.Out(str)` is `out Heard: Text;`.
"""

import dataclasses
import enum
import functools
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple, TypeVar, overload

from . import _dca
from ._quantity import name_of

T = TypeVar("T")

Bytes = bytes | bytearray | memoryview
"""A field of bytes: any of these goes out, and a read-only memoryview comes in."""

class _Inner(dict[str, str]):
    """The message types of list elements in a message: their fields, by name."""

    def __init__(self, of_device: bool) -> None:
        self.of_device = of_device


_MESSAGE = "__dca_message__"
_DEPTH_MAX = 60
_TIMES = (("number", "Time"), ("optional", ("number", "Time")), ("stamp",))


@dataclass(frozen=True, slots=True)
class Count:
    """The length of a list with a fixed number of elements: `Annotated[list[float], dca.Count(361)]`."""

    count: int


@dataclass(frozen=True, slots=True)
class _OfDevice:
    """The form of a number in messages of devices."""

    form: str


Natural = Annotated[int, _OfDevice("natural")]
"""A whole number from 0 on in the message of a device in Rust, where it is a `u16`, `u32` or `u64`."""
Stamp = Annotated[float, _OfDevice("stamp")]
"""The time of a device in its message in Rust, where it is a `Time`; in seconds."""

@overload
def message(cls: type[T]) -> type[T]: ...
@overload
def message(
    *, name: str | None = None, allow_nan: bool = False, of_device: bool = False
) -> Callable[[type[T]], type[T]]: ...
def message(
    cls: type[Any] | None = None, *, name: str | None = None, allow_nan: bool = False, of_device: bool = False
) -> Any:
    """Makes a dataclass a message type.

    `name` is its name in specs; by default it is the name of the class. Only with `allow_nan` may its numbers be infinite or NaN.
    A message `of_device` does not declare its fields. So it may have fields of a Rust device that a spec cannot express:
    `dca.Stamp`, `dca.Natural`, and lists in lists. A field `stamp`, of type `dca.Time` or `dca.Time | None`, is the time of measurement.
    """

    def decorate(cls: type[T]) -> type[T]:
        inner = _Inner(of_device)
        form, text = _record(cls, cls.__qualname__, 0, inner)
        names = [field for field, _ in form[2]]
        stamp = names.index("stamp") if "stamp" in names else None
        if stamp is not None and form[2][stamp][1] not in _TIMES:
            raise TypeError(f"{cls.__qualname__}.stamp: the time of measurement is a dca.Time")
        # A spec cannot express some fields of devices, so their messages are compared only by name.
        fields = "" if of_device else text.removeprefix("{ ").removesuffix(" }")
        described = _Described(name or cls.__name__, fields, stamp, allow_nan, list(inner.items()))
        setattr(cls, _MESSAGE, _dca.MessageType(described, form))
        return cls

    return decorate if cls is None else decorate(cls)


class _Described(NamedTuple):
    """The parts of a message type other than its form. The native half reads the attributes of this object."""

    name: str
    fields: str
    stamp: int | None
    allow_nan: bool
    inner: list[tuple[str, str]]


def encode(value: Any) -> bytes:
    """Returns the bytes of a message."""
    return message_type(type(value)).encode(value)


def decode(cls: type[T], data: bytes) -> T:
    """Returns the message in `data`; raises `ValueError` if the bytes do not have this type."""
    return message_type(cls).decode(data)


def message_type(cls: Any) -> _dca.MessageType:
    """Returns the message type of a class, of `str` or of `float`; raises `TypeError` for anything else."""
    if cls is str or cls is float:
        return _plain(cls)
    found = cls.__dict__.get(_MESSAGE) if isinstance(cls, type) else None
    if found is None:
        shown = getattr(cls, "__name__", repr(cls))
        raise TypeError(f"`{shown}` is not a message: write @dca.message above its @dataclass")
    return found


@functools.cache
def _plain(cls: type[Any]) -> _dca.MessageType:
    """Returns the message type of a value that is not a record; ports of activities have such values."""
    form, text = _PLAIN[cls]
    return _dca.MessageType(_Described(text, "", None, False, []), form)


def _record(cls: type[Any], path: str, depth: int, inner: _Inner) -> tuple[Any, str]:
    if not dataclasses.is_dataclass(cls):
        raise TypeError(f"{path}: a message is a dataclass; write @dataclass between @dca.message and the class")
    if depth > _DEPTH_MAX:
        raise TypeError(f"{path}: a message type is nested deeper than {_DEPTH_MAX} levels")
    fields, texts = [], []
    for field, (form, text) in zip(dataclasses.fields(cls), _forms(cls, path, depth, inner), strict=True):
        if not field.init or field.kw_only:
            raise TypeError(f"{path}.{field.name}: a field of a message is an argument by its place")
        fields.append((field.name, form))
        texts.append(f"{field.name}: {text}")
    if not fields:
        raise TypeError(f"{path}: a message has a field at least")
    return ("record", cls, fields), f"{{ {', '.join(texts)} }}"


def _forms(cls: type[Any], path: str, depth: int, inner: _Inner) -> list[tuple[Any, str]]:
    try:
        hints = typing.get_type_hints(cls, include_extras=True)
    except NameError as error:
        if error.name == cls.__name__:
            raise TypeError(f"{path}: a message cannot contain itself") from None
        raise
    return [_form(hints[field.name], f"{path}.{field.name}", depth + 1, inner) for field in dataclasses.fields(cls)]


_BYTES = (("bytes",), "Bytes")
_PLAIN: dict[Any, tuple[Any, str]] = {
    float: (("number", "Number"), "Number"),
    int: (("whole",), "Number"),
    bool: (("truth",), "Truth"),
    str: (("text",), "Text"),
    bytes: _BYTES,
    bytearray: _BYTES,
    memoryview: _BYTES,
}


def _form(annotation: Any, path: str, depth: int, inner: _Inner) -> tuple[Any, str]:
    """Returns the form of a field, and its type as a spec spells it."""
    if annotation in _PLAIN:
        return _PLAIN[annotation]
    if (quantity := name_of(annotation)) is not None:
        return ("number", quantity), quantity
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        for extra in annotation.__metadata__:
            if isinstance(extra, _OfDevice):
                if not inner.of_device:
                    raise TypeError(f"{path}: a spec has no word for this field; it is for @dca.message(of_device=True)")
                return (extra.form,), "?"
        counts = [extra.count for extra in annotation.__metadata__ if isinstance(extra, Count)]
        form, text = _form(arguments[0], path, depth, inner)
        if 0 in counts:
            raise TypeError(f"{path}: a list has one element at least")
        if counts and form[0] == "list" and text.endswith("[]"):
            return ("list", form[1], counts[0], form[3]), f"{text[:-2]}[{counts[0]}]"
        return form, text
    if origin in (typing.Union, types.UnionType):
        others = [one for one in arguments if one is not types.NoneType]
        if all(_PLAIN.get(one) == _BYTES for one in others):
            others = [bytes]
        if len(others) == 1:
            if types.NoneType not in arguments:
                return _form(others[0], path, depth, inner)
            form, text = _element(others[0], path, depth, inner)
            return ("optional", form), _listed(text, "", path, inner)
    if origin is list and len(arguments) == 1:
        form, text = _element(arguments[0], path, depth, inner)
        return ("list", form, None, False), _listed(text, "", path, inner)
    if origin is tuple and arguments:
        if len(arguments) == 2 and arguments[1] is Ellipsis:
            form, text = _element(arguments[0], path, depth, inner)
            return ("list", form, None, True), _listed(text, "", path, inner)
        if all(one == arguments[0] for one in arguments):
            form, text = _element(arguments[0], path, depth, inner)
            return ("list", form, len(arguments), True), _listed(text, str(len(arguments)), path, inner)
        raise TypeError(f"{path}: the elements of a tuple are of one type; make a dataclass of others")
    if origin is typing.Literal and all(isinstance(one, str) for one in arguments):
        return ("words", [(one, one) for one in arguments]), "Text"
    if isinstance(annotation, type) and issubclass(annotation, enum.Enum):
        members = list(annotation)
        if members and all(isinstance(one.value, str) for one in members):
            return ("words", [(one.value, one) for one in members]), "Text"
        raise TypeError(f"{path}: the values of an Enum in a message are strings")
    if isinstance(annotation, type) and (found := annotation.__dict__.get(_MESSAGE)) is not None and found.is_standard:
        return ("standard", found), found.name
    if dataclasses.is_dataclass(annotation) and isinstance(annotation, type):
        return _record(annotation, path, depth, inner)
    shown = getattr(annotation, "__name__", str(annotation))
    raise TypeError(f"{path}: `{shown}` cannot be in a message; see the table in dca._message")


def _element(annotation: Any, path: str, depth: int, inner: _Inner) -> tuple[Any, str]:
    """Returns the form of a list element. A record in a list needs a name that a spec can use."""
    form, text = _form(annotation, path, depth, inner)
    if form[0] != "record":
        return form, text
    found: _dca.MessageType | None = annotation.__dict__.get(_MESSAGE)
    if found is None:
        raise TypeError(f"{path}: a record in a list is a message: write @dca.message above `{annotation.__name__}`")
    inner.update([*found.inner, (found.name, found.fields)])
    return form, found.name


def _listed(text: str, count: str, path: str, inner: _Inner) -> str:
    if not inner.of_device and text.endswith(("]", "}")):
        raise TypeError(f"{path}: a list of lists or of optional values: put the inner one into a message of its own")
    return f"{text}[{count}]"
