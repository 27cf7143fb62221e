"""Makes controllers from classes, with their ports, parameters and ends."""

import inspect
import io
import logging
import os
import signal
import sys
import typing
from collections.abc import Callable
from typing import Any, Generic, NamedTuple, TypeVar

from . import _dca
from ._declared import Declared, R
from ._message import encode, message_type
from ._messaging import Lock, LockUser, Queue, Sender, Subscriber, _Keys, _Station
from ._quantity import name_of

A = TypeVar("A")
T = TypeVar("T")

_DECLARATION = "__dca_controller__"
_EXPORT = "__dca_export__"
_PARAMETERS = {float: "Number", int: "Number", bool: "Truth", str: "Text"}
_MODES = ("--list", "--dca-interface", "--help", "-h", "--version", "-V")


class _Port(Declared[R], Generic[T, R]):
    """The declaration of a port in a class. In an instance, the port itself replaces it."""

    missing = "has no port"
    is_input = True
    keeps_all = False

    def __init__(
        self,
        message: type[T],
        name: str | None = None,
        *,
        optional: bool = False,
        device: str | None = None,
        owner: bool = False,
        doc: str = "",
    ) -> None:
        super().__init__(name, optional=optional, doc=doc)
        self.message = message_type(message)
        self.device = None
        if device is not None:
            self.device, self.name = "owner" if owner else "client", device


class In(_Port[T, "_dca.Input[T]"]):
    """An input that holds the newest value: `In = dca.In(Range)`.

    The port has the name of its attribute, unless `name` gives another one. With `device="arm/state"` it is a port of a device.
    """


class Every(_Port[T, "_dca.EveryInput[T]"]):
    """An input that keeps every value since the last calculation. The controller iterates over them."""

    keeps_all = True


class Out(_Port[T, "_dca.Output[T]"]):
    """An output: `Out = dca.Out(Velocity)`."""

    is_input = False


class Calls(Declared["_dca.Calls[A, T]"], Generic[A, T]):
    """Calls of a procedure of another process, which the spec connects: `Grip = dca.Calls(Push, Width)`.

    `None` instead of a type means no value.
    """

    missing = "calls nothing"

    def __init__(
        self,
        argument: type[A] | None = None,
        result: type[T] | None = None,
        *,
        name: str | None = None,
        optional: bool = False,
        doc: str = "",
    ) -> None:
        super().__init__(name, optional=optional, doc=doc)
        self.argument = None if argument is None else message_type(argument)
        self.result = None if result is None else message_type(result)


class Database(Declared["_dca.Database"]):
    """The robot's database: `database = dca.Database()`. In an instance, the database itself replaces the declaration."""

    missing = "reaches nothing"

    def __init__(self) -> None:
        super().__init__()


class _Export:
    """A method that other processes may call or read."""

    def __init__(self, function: Callable[..., Any], *, is_state: bool, name: str | None, idle: bool, access: str) -> None:
        if access not in ("look", "operate", "deploy"):
            raise TypeError(f"`{access}` is not a right: look, operate or deploy")
        self.attribute = function.__name__
        self.name = name or function.__name__
        self.is_state = is_state
        self.is_answered_idle = idle or is_state
        self.access = "look" if is_state else access
        self.doc = (function.__doc__ or "").strip().partition("\n")[0]
        hints = typing.get_type_hints(function)
        names = list(inspect.signature(function).parameters)[1:]
        self.is_later = "reply" in names
        names = [one for one in names if one != "reply"]
        if len(names) > (0 if is_state else 1):
            raise TypeError(f"`{self.attribute}` takes {'nothing' if is_state else 'one message'}")
        kinds = [self._kind(hints, one) for one in [*names, "return"]]
        self.argument = kinds[0] if names else None
        self.result = kinds[-1]
        if self.is_later:
            self.result = self._kind({"reply": next(iter(typing.get_args(hints.get("reply"))), None)}, "reply")
        if is_state and self.result is None:
            raise TypeError(f"`{self.attribute}` is a state, so it returns a message: `-> Width`")

    def _kind(self, hints: dict[str, Any], name: str) -> _dca.MessageType | None:
        if name not in hints:
            raise TypeError(f"`{self.attribute}`: the type of `{name}` is missing; None for nothing")
        return None if hints[name] in (None, type(None)) else message_type(hints[name])


def procedure(
    function: Callable[..., Any] | None = None, *, name: str | None = None, idle: bool = False, access: str = "operate"
) -> Any:
    """Exports a method, which other processes call between two calculations: `def Grip(self, push: Push) -> Width`.

    To refuse a call, the method raises `dca.Refused("why")`. With a parameter `reply: dca.Reply[Width]`, it can keep the reply and
    answer in a later calculation. With `idle`, calls are also answered while no activation runs. `access` is the right that a user of
    a team needs.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        setattr(function, _EXPORT, _Export(function, is_state=False, name=name, idle=idle, access=access))
        return function

    return decorate if function is None else decorate(function)


def state(function: Callable[..., Any] | None = None, *, name: str | None = None) -> Any:
    """Exports a method as a state, which other processes read between two calculations: `def opening(self) -> Width`."""

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        setattr(function, _EXPORT, _Export(function, is_state=True, name=name, idle=True, access="look"))
        return function

    return decorate if function is None else decorate(function)


class _Parameter:
    """The declaration of a parameter in a class. In an instance, its value replaces it."""

    def __init__(
        self,
        kind: Any,
        limits: tuple[Any, ...] = (),
        *,
        default: Any = None,
        name: str | None = None,
    ) -> None:
        type_name = "Secret" if kind is _Secret else name_of(kind) or _PARAMETERS.get(kind)
        if type_name is None:
            raise TypeError(f"`{kind}` is not a type of parameters: float, int, bool, str, or a quantity such as dca.Force")
        self.type_name = type_name
        self.is_whole = kind is int
        self.words: list[str] = [str(word) for word in limits] if type_name == "Text" else []
        self.low, self.high = None, None
        if limits and type_name != "Text":
            if len(limits) != 2:
                raise TypeError("the limits of a parameter are two: (low, high); None for no limit")
            self.low, self.high = limits
        self.default = default
        self.name = name or ""
        self.attribute = ""

    def __set_name__(self, _: type, attribute: str) -> None:
        self.attribute = attribute
        self.name = self.name or attribute

    def attribute_value(self, value: Any) -> Any:
        """Returns a checked value in the form of the attribute."""
        return int(value) if self.is_whole else value


class _Secret:
    """The type of a secret."""


def parameter(kind: Any, limits: tuple[Any, ...] = (), *, default: Any = None, name: str | None = None) -> Any:
    """Declares a parameter, which is an attribute of each instance, in SI units.

    `limits` are the lowest and the highest value, or the permitted words of a text. Without `default` a spec has to give the value.
    When a parameter changes while the controller runs, the attribute has the new value in the next calculation.
    """
    return _Parameter(kind, limits, default=default, name=name)


def secret(*, name: str | None = None) -> Any:
    """Declares a secret of the database, which a spec gives as `secret("team/camera/password")`; the attribute is bytes."""
    return _Parameter(_Secret, name=name)


ABSENT = "absent"
"""What a key has to be: without a value."""
EXISTS = "exists"
"""What a key has to be: with any value."""


class Signal(NamedTuple):
    """A number for people and recorders, which the method `signals` returns."""

    name: str
    value: float
    unit: str = ""
    headline: bool = False


def done(value: Any = None) -> _dca.Done:
    """Returns the normal end of a task, with a message or bytes for the next process."""
    return _dca.Done(_bytes(value))


def outcome(tag: str, value: Any = None) -> _dca.Done:
    """Returns one of the normal ends that the class declares, with a message or bytes for the next process."""
    return _dca.Done(_bytes(value), tag)


def abort(reason: str) -> _dca.Abort:
    """Returns the failed end of an activation, with the reason in one line."""
    # The reason may contain a file name with bytes that are not text.
    return _dca.Abort(str(reason).encode(errors="backslashreplace").decode())


def _bytes(value: Any) -> bytes:
    if value is None:
        return b""
    return bytes(value) if isinstance(value, (bytes, bytearray, memoryview)) else encode(value)


class _Members:
    """The attributes of a class that are declarations, its own and those of its bases."""

    def __init__(self, cls: type[Any]) -> None:
        declared = {name: value for base in reversed(cls.__mro__) for name, value in vars(base).items()}
        self.ports = [value for value in declared.values() if isinstance(value, _Port)]
        self.parameters = [value for value in declared.values() if isinstance(value, _Parameter)]
        self.calls = [value for value in declared.values() if isinstance(value, Calls)]
        self.stations = [value for value in declared.values() if isinstance(value, _Station)]
        self.keys = [value for value in declared.values() if isinstance(value, _Keys)]
        databases = [value for value in declared.values() if isinstance(value, Database)]
        if len(databases) > 1:
            raise TypeError(f"{cls.__name__}: a controller has one dca.Database")
        self.database = databases[0].attribute if databases else None
        found = (getattr(value, _EXPORT, None) for value in declared.values())
        self.exports = [one for one in found if isinstance(one, _Export)]
        self._check(cls)

    def _check(self, cls: type[Any]) -> None:
        names = [one.name for one in [*self.ports, *self.parameters, *self.calls, *self.exports, *self.keys]]
        names += [name for station in self.stations for name in station.names]
        if twice := {name for name in names if names.count(name) > 1}:
            raise TypeError(f"{cls.__name__}: there are two `{min(twice)}`")
        locks = [station.attribute for station in self.stations if isinstance(station, Lock)]
        for queue in (station for station in self.stations if isinstance(station, Queue)):
            if queue.lock is not None and queue.lock not in locks:
                raise TypeError(f"{cls.__name__}: the queue `{queue.name}` has a lock `{queue.lock}`, which is not one of its dca.Lock")

    def triggers(self) -> list[str]:
        """The names of the inputs and calls, whose values and answers can trigger a calculation."""
        names = [port.name for port in self.ports if port.is_input] + [one.name for one in self.calls]
        names += [one.name for one in self.stations if isinstance(one, (Sender, LockUser, Subscriber))]
        names += [one.name for one in self.keys if one.kind != "writer"]
        return names + (["database"] if self.database else [])


class Declaration:
    """The declaration of a class. The native half reads the attributes of this object."""

    def __init__(self, cls: type[Any], doc: str, *, is_service: bool, **about: Any) -> None:
        self.cls = cls
        self.name: str = about["name"] or cls.__name__
        self.doc = doc
        self.is_service = is_service
        self.every = about["every"]
        self.triggered_by = about["triggered_by"]
        self.stop_within = about["stop_within"]
        self.remembers = about["remembers"]
        self.signals_every = about["signals_every"]
        start = None if about["starts_with"] is None else message_type(about["starts_with"])
        outcomes = [(tag, None if kind is None else message_type(kind).name) for tag, kind in about["outcomes"].items()]
        self.values = (start, outcomes)
        self.members = _Members(cls)
        self._check()

    def _check(self) -> None:
        if self.triggered_by is not None and self.triggered_by not in self.members.triggers():
            raise TypeError(f"{self.cls.__name__}: triggered_by `{self.triggered_by}`, which is not one of its inputs or calls")
        if not callable(getattr(self.cls, "main_calc", None)):
            raise TypeError(f"{self.cls.__name__}: a controller has a method `main_calc(self, tick)`")
        if self.signals_every is not None and not callable(getattr(self.cls, "signals", None)):
            raise TypeError(f"{self.cls.__name__}: signals_every needs a method `signals(self)`")
        # So a wrong name, period or parameter is reported at the class definition.
        _dca.interface([self])

    def make(self, attributes: dict[str, Any], values: dict[str, Any]) -> Any:
        """Makes an instance. `attributes` has its ports by attribute, `values` its parameters by name."""
        cls: Any = self.cls
        controller = cls.__new__(cls)
        for attribute, port in attributes.items():
            setattr(controller, attribute, port)
        self.set(controller, values)
        controller.__init__()
        return controller

    def set(self, controller: Any, values: dict[str, Any]) -> None:
        """Sets the parameters of an instance; `values` has them by name."""
        for one in self.members.parameters:
            setattr(controller, one.attribute, one.attribute_value(values[one.name]))


def service(
    doc: str,
    *,
    name: str | None = None,
    every: str | float | None = None,
    triggered_by: str | None = None,
    stop_within: str | float | None = None,
    remembers: bool = False,
    signals_every: str | float | None = None,
    starts_with: type[Any] | None = None,
) -> Callable[[type[T]], type[T]]:
    """Turns a class into a controller type that never ends by itself.

    It calculates once per period `every` (10 ms), and at once for each value of the input `triggered_by`. Its `init` gets a value of
    the message type `starts_with`.
    """

    def decorate(cls: type[T]) -> type[T]:
        about = {"name": name, "every": every, "triggered_by": triggered_by, "stop_within": stop_within}
        about |= {"remembers": remembers, "signals_every": signals_every, "outcomes": {}, "starts_with": starts_with}
        setattr(cls, _DECLARATION, Declaration(cls, doc, is_service=True, **about))
        return cls

    return decorate


def task(
    doc: str,
    *,
    name: str | None = None,
    every: str | float | None = None,
    triggered_by: str | None = None,
    stop_within: str | float | None = None,
    remembers: bool = False,
    signals_every: str | float | None = None,
    outcomes: dict[str, type[Any] | None] | None = None,
    starts_with: type[Any] | None = None,
) -> Callable[[type[T]], type[T]]:
    """Makes a class a controller type that ends by itself, with `dca.done` or one of its `outcomes`.

    Its `init` gets a value of the message type `starts_with`.
    """

    def decorate(cls: type[T]) -> type[T]:
        about = {"name": name, "every": every, "triggered_by": triggered_by, "stop_within": stop_within}
        about |= {"remembers": remembers, "signals_every": signals_every, "outcomes": outcomes or {}, "starts_with": starts_with}
        setattr(cls, _DECLARATION, Declaration(cls, doc, is_service=False, **about))
        return cls

    return decorate


def declaration(cls: Any) -> Declaration:
    """Returns the declaration of a class; raises `TypeError` if the class is not a controller."""
    found = cls.__dict__.get(_DECLARATION) if isinstance(cls, type) else None
    if found is None:
        shown = getattr(cls, "__name__", repr(cls))
        raise TypeError(f"`{shown}` is not a controller: write @dca.service(...) or @dca.task(...) above it")
    return found


_PLAIN = frozenset(vars(logging.makeLogRecord({}))) | {"message", "asctime", "taskName"}


class _Formatter(logging.Formatter):
    """Formats a log record as one line with its level, its logger and its fields: `INFO root: the door is open width=0.8`."""

    def __init__(self) -> None:
        super().__init__("%(levelname)s %(name)s: %(message)s")

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802
        fields = [f"{name}={value}" for name, value in vars(record).items() if name not in _PLAIN]
        return " ".join([super().formatMessage(record), *fields]).replace("\n", "\\n")


def _level() -> int:
    """Returns the log level in `RUST_LOG`, which programs in Rust also use; INFO if it has none."""
    word = os.environ.get("RUST_LOG", "").split(",")[0].strip().upper()
    levels = {"ERROR": logging.ERROR, "WARN": logging.WARNING, "DEBUG": logging.DEBUG, "TRACE": logging.DEBUG}
    return levels.get(word, logging.INFO)


def _refuse_other_version() -> None:
    """Ends this program if a node of another version starts it, since the two may not understand each other."""
    wanted = os.environ.get("DCA_VERSION", _dca.__version__)
    if wanted != _dca.__version__:
        folder = os.path.dirname(__file__)
        sys.exit(
            f"`dca` {_dca.__version__} from `{folder}` does not run under DCA {wanted}: install that version into the environment "
            f"of `{sys.executable}`"
        )


def run(*controllers: type[Any]) -> None:
    """Runs this process as the controller that its arguments name, and does not return. A main program only has to call this."""
    declarations = [declaration(cls) for cls in controllers]
    _refuse_other_version()
    arguments = sys.argv[1:]
    if len(declarations) == 1 and (not arguments or arguments[0] not in (*_MODES, declarations[0].name)):
        # A program with one controller does not need its name as an argument.
        arguments = [declarations[0].name, *arguments]
    for stream in (sys.stdout, sys.stderr):
        # Printed lines are in the log at once, not only when a buffer is full.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(line_buffering=True)
    if not logging.getLogger().handlers:
        handler = logging.StreamHandler()
        handler.setFormatter(_Formatter())
        logging.basicConfig(handlers=[handler], level=_level())
    # A node stops its programs itself. Ctrl-C ends a program that was started by hand.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    code = _dca.run(declarations, arguments)
    if arguments[0] in _MODES:
        # Threads that the program has started during import must not delay the answer.
        sys.stdout.flush()
        os._exit(code)
    sys.exit(code)
