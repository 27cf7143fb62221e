"""Tests of controllers in virtual time: an hour takes a moment, and the same test always gives the same numbers.

    def test_it_keeps_its_distance():
        harness = dca.testing.Harness()
        keep = harness.add(KeepDistance, reach=0.5)
        keep.start()
        keep.send("In", Range(distance=1.0))
        harness.run("20 ms")
        assert keep.last("Out").forward > 0
"""

from dataclasses import dataclass
from typing import Any

from . import _dca
from ._controller import declaration
from ._message import encode

__all__ = ["Ended", "Harness", "Module", "Sent", "Wire"]

_Parameters = dict[str, str | float | bool]


@dataclass(frozen=True, slots=True)
class Sent:
    """A value that an output has sent, with its time in seconds."""

    at: float
    value: Any


@dataclass(frozen=True, slots=True)
class Ended:
    """The end of an activation: `how` is `done`, `aborted` or `stopped`."""

    module: "Module"
    at: float
    how: str
    value: bytes
    reason: str


class Wire:
    """A wire between two controllers. It is open at the beginning."""

    def __init__(self, native: _dca.NativeHarness, number: int) -> None:
        self._native, self._number = native, number
        self._is_open = True

    def open(self) -> None:
        """Opens the wire: values pass."""
        self._switch(True)

    def close(self) -> None:
        """Closes the wire: values do not pass."""
        self._switch(False)

    def _switch(self, is_open: bool) -> None:
        if is_open != self._is_open:
            self._is_open = is_open
            self._native.switch(self._number, is_open)


class Module:
    """A controller in a harness."""

    def __init__(self, harness: "Harness", number: int, cls: type[Any], parameters: _Parameters) -> None:
        self._harness, self._number, self._cls, self._parameters = harness, number, cls, parameters
        self._outputs: dict[str, list[tuple[float, bytes]]] = {}

    def __repr__(self) -> str:
        return f"<{self._cls.__name__} {self._number}>"

    @property
    def is_active(self) -> bool:
        """Whether the controller is running or stopping."""
        return self._harness._native.is_active(self._number)

    def start(self, value: Any = b"") -> "Module":
        """Begins an activation. The value comes from the previous process: a message or bytes."""
        data = bytes(value) if isinstance(value, (bytes, bytearray, memoryview)) else encode(value)
        self._harness._native.activate(self._number, data)
        return self

    def configure(self, **parameters: str | float | bool) -> None:
        """Changes parameters, like `dca param set` for a running controller."""
        changed = self._parameters | parameters
        self._harness._native.configure(self._number, _arguments(self._cls, changed))
        self._parameters = changed

    def stop(self) -> None:
        """Asks the controller to stop."""
        self._harness._native.stop(self._number)

    def crash(self) -> None:
        """Ends the controller like `kill -9`."""
        self._harness._native.crash(self._number)

    def send(self, port: str, value: Any) -> None:
        """Sends a value to one of the controller's inputs, like over a wire."""
        expected = self._message(port, is_input=True)
        self._harness._native.send_to(self._number, port, expected.encode(value))

    def sent(self, port: str) -> list[Sent]:
        """Returns all values that an output has sent, the oldest first."""
        message = self._message(port, is_input=False)
        self._harness._collect()
        return [Sent(at, message.decode(data)) for at, data in self._outputs.get(port, [])]

    def last(self, port: str) -> Any:
        """Returns the last value that an output has sent; `None` before the first one."""
        message = self._message(port, is_input=False)
        self._harness._collect()
        values = self._outputs.get(port)
        return message.decode(values[-1][1]) if values else None

    def _message(self, port: str, *, is_input: bool) -> _dca.MessageType:
        for declared in declaration(self._cls).members.ports:
            if declared.name == port and declared.is_input == is_input:
                return declared.message
        raise ValueError(f"`{self._cls.__name__}` has no {'input' if is_input else 'output'} `{port}`")


class Harness:
    """Controllers in one thread and in virtual time.

    A value takes 0.1 ms from one controller to the next. With `busy`, calculations and values are delayed and some values are lost, like
    on an overloaded machine. The same `seed` gives the same run.
    """

    def __init__(self, *, seed: int = 0, busy: bool = False) -> None:
        self._native = _dca.NativeHarness(seed, busy)
        self._modules: list[Module] = []

    @property
    def now(self) -> float:
        """The present virtual time, in seconds."""
        return self._native.now

    def add(self, cls: type[Any], **parameters: str | float | bool) -> Module:
        """Adds an idle controller with these parameters; quantities are in SI units, or texts with a unit."""
        number = self._native.add(declaration(cls), _arguments(cls, parameters))
        module = Module(self, number, cls, parameters)
        self._modules.append(module)
        return module

    def connect(self, producer: Module, output: str, consumer: Module, input: str) -> Wire:
        """Makes an open wire from an output to an input."""
        return Wire(self._native, self._native.connect((producer._number, output), (consumer._number, input)))

    def run(self, within: str | float) -> Ended | None:
        """Lets time pass until an activation ends, at most `within`. Returns the end, or `None` if there was none."""
        ended = self._native.run(within)
        if ended is None:
            return None
        number, at, how, value, reason = ended
        return Ended(self._modules[number], at, how, value, reason)

    def _collect(self) -> None:
        for at, number, port, data in self._native.take_sent():
            self._modules[number]._outputs.setdefault(port, []).append((at, data))


def _arguments(cls: type[Any], parameters: _Parameters) -> list[str]:
    types = {one.name: one.type_name for one in declaration(cls).members.parameters}
    return [f"{name}={_argument(value, types.get(name))}" for name, value in parameters.items()]


def _argument(value: str | float | bool, type_name: str | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str) and type_name not in (None, "Text", "Truth", "Secret"):
        return repr(_dca.si(value, type_name))
    return str(value) if isinstance(value, str) else repr(float(value))
