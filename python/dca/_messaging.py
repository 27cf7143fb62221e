"""Queues, locks, routers, and ports of keys: their declarations in a class, and requests over queues."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

from . import _dca
from ._message import message_type

T = TypeVar("T")
A = TypeVar("A")

_CAPACITY_MAX = 65_536
_FULL = ("reject", "drop lowest", "drop oldest")


@dataclass(frozen=True, slots=True)
class Filter:
    """Messages that a subscriber wants: all that is given has to fit; a text that ends in `*` takes all that begin so."""

    category: str | None = None
    sender: str | None = None
    priority_min: int | None = None
    marker: int | None = None


def _capacity(number: int) -> int:
    if not 1 <= number <= _CAPACITY_MAX:
        raise ValueError(f"a capacity is a whole number from 1 to {_CAPACITY_MAX}, not {number}")
    return number


def _span(value: str | float, name: str) -> float:
    seconds = _dca.si(value, "Time")
    if not 0.0 < seconds < 1e9:
        raise ValueError(f"`{name}` is a span of time, not {seconds} s")
    return seconds


class _Station:
    """A declaration. An instance of the class has the station itself in its place."""

    kind = ""

    def __init__(self, message: type[Any] | None, *, name: str | None, doc: str) -> None:
        self.message = None if message is None else message_type(message)
        self.name, self.doc, self.attribute = name or "", doc, ""
        self.capacity, self.full, self.lock = 1, "reject", None
        self.lease, self.preempt_after = 1.0, None
        self.status: str | None = None
        self.filters: Sequence[Filter] = ()
        self.is_optional = False

    def __set_name__(self, _: type, attribute: str) -> None:
        self.attribute = attribute
        self.name = self.name or attribute

    def _of(self, controller: object) -> Any:
        if controller is None:
            return self
        raise AttributeError(f"`{self.attribute}` is not there: this object was not made by dca.run or a dca.testing.Harness")

    @property
    def names(self) -> list[str]:
        """The names that it has in the interface."""
        return [self.name, *([self.status] if self.status else [])]


class Queue(_Station, Generic[T]):
    """A queue, which others send to: `Commands = dca.Queue(Pace, capacity=4, full="drop oldest", lock="wheels")`.

    `full` is `reject`, `drop lowest` or `drop oldest`. With `lock`, the attribute of a `dca.Lock`, it takes only messages of the user that
    holds that. `status` is the name of the state that `dca queue` shows.
    """

    kind = "queue"

    def __init__(
        self,
        message: type[T],
        *,
        capacity: int = 64,
        full: str = "reject",
        lock: str | None = None,
        status: str | None = None,
        name: str | None = None,
        doc: str = "",
    ) -> None:
        super().__init__(message, name=name, doc=doc)
        if full not in _FULL:
            raise TypeError(f"`{full}` is not what a full queue does: {', '.join(_FULL)}")
        self.capacity, self.full, self.lock, self.status = _capacity(capacity), full, lock, status

    @overload
    def __get__(self, controller: None, cls: type) -> "Queue[T]": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.Queue[T]": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class Sender(_Station, Generic[T]):
    """The queue of another process, which the spec connects: `Commands = dca.Sender(Pace)`."""

    kind = "sender"

    def __init__(self, message: type[T], *, optional: bool = False, name: str | None = None, doc: str = "") -> None:
        super().__init__(message, name=name, doc=doc)
        self.is_optional = optional

    @overload
    def __get__(self, controller: None, cls: type) -> "Sender[T]": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.Sender[T]": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class Lock(_Station):
    """The lock of a resource of this class: `wheels = dca.Lock(lease="1 s")`.

    A grant ends after `lease` without a renewal. With `preempt_after`, a holder may go on for so long when a user with a greater priority
    wants the lock.
    """

    kind = "lock"

    def __init__(
        self,
        *,
        lease: str | float = "1 s",
        preempt_after: str | float | None = None,
        status: str | None = None,
        name: str | None = None,
        doc: str = "",
    ) -> None:
        super().__init__(None, name=name, doc=doc)
        self.lease = _span(lease, "lease")
        self.preempt_after = None if preempt_after is None else _span(preempt_after, "preempt_after")
        self.status = status

    @overload
    def __get__(self, controller: None, cls: type) -> "Lock": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.Lock": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class LockUser(_Station):
    """The lock of another process, which the spec connects: `wheels = dca.LockUser()`."""

    kind = "lock user"

    def __init__(self, *, optional: bool = False, name: str | None = None, doc: str = "") -> None:
        super().__init__(None, name=name, doc=doc)
        self.is_optional = optional

    @overload
    def __get__(self, controller: None, cls: type) -> "LockUser": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.LockUser": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class Router(_Station, Generic[T]):
    """A router, to which others subscribe: `News = dca.Router(Speed, outbox=64)`. The oldest message of a full outbox gives way."""

    kind = "router"

    def __init__(
        self, message: type[T], *, outbox: int = 64, status: str | None = None, name: str | None = None, doc: str = ""
    ) -> None:
        super().__init__(message, name=name, doc=doc)
        self.capacity, self.status = _capacity(outbox), status

    @overload
    def __get__(self, controller: None, cls: type) -> "Router[T]": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.Router[T]": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class Subscriber(_Station, Generic[T]):
    """The router of another process, which the spec connects: `News = dca.Subscriber(Speed, filters=[dca.Filter(category="base")])`."""

    kind = "subscriber"

    def __init__(
        self,
        message: type[T],
        *,
        capacity: int = 64,
        filters: Sequence[Filter] = (),
        optional: bool = False,
        name: str | None = None,
        doc: str = "",
    ) -> None:
        super().__init__(message, name=name, doc=doc)
        self.capacity, self.filters, self.is_optional = _capacity(capacity), list(filters), optional

    @overload
    def __get__(self, controller: None, cls: type) -> "Subscriber[T]": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.Subscriber[T]": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class _Keys:
    kind = ""

    def __init__(self, *, optional: bool = False, name: str | None = None, doc: str = "") -> None:
        self.name, self.doc, self.attribute, self.is_optional = name or "", doc, "", optional

    def __set_name__(self, _: type, attribute: str) -> None:
        self.attribute = attribute
        self.name = self.name or attribute

    def _of(self, controller: object) -> Any:
        if controller is None:
            return self
        raise AttributeError(f"`{self.attribute}` is not there: this object was not made by dca.run or a dca.testing.Harness")


class KeyNews(_Keys):
    """An input that a spec connects with keys of the database: `db("team/claim/**") -> robot, Claims;`."""

    kind = "news"

    @overload
    def __get__(self, controller: None, cls: type) -> "KeyNews": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.KeyNews": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class KeyAnswers(_Keys):
    """An input that hears what became of the values of a `dca.KeyWriter`."""

    kind = "answers"

    @overload
    def __get__(self, controller: None, cls: type) -> "KeyAnswers": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.KeyAnswers": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class KeyWriter(_Keys):
    """An output that a spec connects with keys of the database: `robot, Claim -> db("team/claim/**");`."""

    kind = "writer"

    @overload
    def __get__(self, controller: None, cls: type) -> "KeyWriter": ...
    @overload
    def __get__(self, controller: object, cls: type) -> "_dca.KeyWriter": ...
    def __get__(self, controller: object, cls: type) -> Any:
        return self._of(controller)


class Asked(Generic[A]):
    """A request on its way."""

    def __init__(self, sending: "_dca.Sending", until: float) -> None:
        self._sending, self._until = sending, until
        self._end: tuple[Any, str | None] | None = None

    @property
    def done(self) -> bool:
        """Whether there is an answer, or known that none comes."""
        return self._end is not None

    def result(self) -> A:
        """Returns the answer; raises `dca.SendError` if there is none."""
        if self._end is None:
            raise RuntimeError("the request has no answer yet: see `done`")
        answer, why = self._end
        if why is not None:
            raise _dca.SendError(why)
        return answer

    def _look(self, now: float) -> None:
        if self._end is None and self._sending.done:
            try:
                self._sending.result()
            except _dca.SendError as error:
                self._end = (None, str(error))
        if self._end is None and now >= self._until:
            self._end = (None, "there was no answer in time: whether it was carried out is not known")


class Requester(Generic[T, A]):
    """Requests over queues: questions go to the queue of another process, and answers come to a queue of this one, joined by a marker.

    Made in `init` of a class with `Questions = dca.Sender(Question)` and `Answers = dca.Queue(Answer)`. The other process answers with
    `self.Answers.send(answer, to=taken.sender, marker=taken.marker, within="1 s")`.
    """

    def __init__(self, questions: "_dca.Sender[T]", answers: "_dca.Queue[A]") -> None:
        self._questions, self._answers = questions, answers
        self._open: dict[int, Asked[A]] = {}
        self._last = 0

    def ask(self, now: float, question: T, *, within: str | float, category: str = "", priority: int = 0) -> Asked[A]:
        """Asks after this calculation."""
        self._last += 1
        sending = self._questions.send(
            question, within=within, category=category, priority=priority, marker=self._last
        )
        asked: Asked[A] = Asked(sending, now + _dca.si(within, "Time"))
        self._open[self._last] = asked
        return asked

    def work(self, now: float) -> None:
        """Takes the answers. Called once in each calculation."""
        for taken in self._answers:
            asked = self._open.pop(taken.marker, None)
            if asked is not None and not asked.done:
                asked._end = (taken.data, None)
        for marker, asked in list(self._open.items()):
            asked._look(now)
            if asked.done:
                del self._open[marker]

    def __iter__(self) -> Iterator[Asked[A]]:
        """Iterates over the requests without an answer."""
        return iter(list(self._open.values()))
