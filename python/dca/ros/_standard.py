"""Classes for the standard messages of ROS 2. Each is made from the native half's definition when it is first used."""

import dataclasses
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from .. import _dca
from .._message import _MESSAGE, message_type

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Protocol, Self, overload

    from typing_extensions import Buffer

T = TypeVar("T")
M = TypeVar("M", bound="Message")


class Message:
    """The base class of the messages of ROS 2."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        if other.__class__ is not self.__class__:
            return NotImplemented
        names = [field.name for field in dataclasses.fields(self)]  # pyright: ignore[reportArgumentType]
        return all(_is_same(getattr(self, name), getattr(other, name)) for name in names)

    def __reduce__(self) -> tuple[Any, ...]:
        """Copies and pickles a message as its bytes, because its lists of numbers may be views, which cannot be copied themselves."""
        return from_cdr, (type(self), to_cdr(self))


def to_cdr(message: Message) -> bytes:
    """Returns the CDR of a message: the bytes that ROS 2 sends."""
    return message_type(type(message)).encode_cdr(message)


def from_cdr(cls: type[M], data: bytes) -> M:
    """Returns the message in CDR bytes from ROS 2; raises `ValueError` if they do not have this type."""
    return message_type(cls).decode_cdr(data)


def _is_same(one: Any, other: Any) -> bool:
    """Compares fields. A list of numbers may be a list, an array or a view."""
    if isinstance(one, (int, float, str, Message)) or one.__class__ is other.__class__ is list:
        return one == other
    return _plain(one) == _plain(other)


def _plain(values: Any) -> list[Any]:
    return list(values.ravel().tolist() if hasattr(values, "ravel") else values)


if TYPE_CHECKING:

    class Array(Protocol):
        """A numpy array, as far as this package uses it: a buffer of numbers."""

        def __array__(self) -> Any: ...

    class Numbers(Generic[T]):
        """A field of numbers. Any sequence or buffer of numbers can be set. In a received message it is a read-only `memoryview`."""

        @overload
        def __get__(self, message: None, cls: type) -> Self: ...
        @overload
        def __get__(self, message: object, cls: type) -> Sequence[T]: ...
        def __get__(self, message: object, cls: type) -> Any: ...
        def __set__(self, message: object, value: Sequence[T] | Buffer | Array) -> None: ...

    class Octets:
        """A field of bytes. Any buffer or sequence of numbers can be set. In a received message it is a read-only `memoryview`."""

        @overload
        def __get__(self, message: None, cls: type) -> Self: ...
        @overload
        def __get__(self, message: object, cls: type) -> bytes | bytearray | memoryview: ...
        def __get__(self, message: object, cls: type) -> Any: ...
        def __set__(self, message: object, value: Sequence[int] | Buffer | Array) -> None: ...


_ZERO: dict[str, Any] = {"bool": False, "string": "", "float32": 0.0, "float64": 0.0}
_BYTES = ("byte", "uint8")


def lazily(module: str) -> tuple[Callable[[str], type[Message]], Callable[[], Iterable[str]]]:
    """Returns the functions `__getattr__` and `__dir__` for the module of a ROS 2 package."""
    package = module.rpartition(".")[2]

    def get(name: str) -> type[Message]:
        definition = None if name.startswith("_") else _dca.ros_definition(f"ros.{package}.{name}")
        if definition is None:
            raise AttributeError(f"there is no message `{name}` in `{module}`")
        made = _class(module, name, definition)
        setattr(sys.modules[module], name, made)
        return made

    def names() -> list[str]:
        return _dca.ros_names(package)

    return get, names


def _class(module: str, name: str, definition: _dca.RosDefinition) -> type[Message]:
    fields = [(field.name, _annotation(field), _default(field)) for field in definition.fields]
    about = {"__module__": module, "__doc__": f"A message of the type `{definition.name}`.", **dict(definition.constants)}
    made = dataclasses.make_dataclass(name, fields, bases=(Message,), namespace=about, eq=False, slots=True)
    made.__module__ = module
    classes = [made, *(_standard(spec) for spec in definition.inner)]
    setattr(made, _MESSAGE, _dca.MessageType.of_ros(definition.spec, classes, definition.allow_nan))
    return made


def _standard(spec: str) -> type[Message]:
    """Returns the class of a message by its name in a spec."""
    _, package, name = spec.split(".")
    module = f"{__package__}.{package}"
    __import__(module)
    return getattr(sys.modules[module], name)


def _annotation(field: _dca.RosField) -> Any:
    if field.count is not None:
        return list
    return _standard(field.of) if "." in field.of else type(_ZERO.get(field.of, 0))


def _default(field: _dca.RosField) -> Any:
    if field.count is None:
        if "." in field.of:
            return dataclasses.field(default_factory=_standard(field.of))
        zero = _ZERO.get(field.of, 0)
        if field.default is None:
            return zero
        return field.default == "true" if zero is False else type(zero)(field.default)
    if field.of in _BYTES:
        return bytes(field.count)
    make = _standard(field.of) if "." in field.of else lambda zero=_ZERO.get(field.of, 0): zero
    return dataclasses.field(default_factory=lambda: [make() for _ in range(field.count or 0)])
