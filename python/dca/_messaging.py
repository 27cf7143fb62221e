"""Declarations of queues, locks, routers and ports of keys in a class, and requests over queues."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from . import _dca
from ._declared import Declared, R
from ._message import message_type

T = TypeVar("T")
A = TypeVar("A")

_CAPACITY_MAX = 65_536
_FULL = ("reject", "drop lowest", "drop oldest")


@dataclass(frozen=True, slots=True)
class Filter:
    """Selects messages for a subscriber. All given parts have to match; a text that ends with `*` matches all with this beginning."""

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


class _Station(Declared[R]):
    """The declaration of a station. In an instance of the class, the station itself replaces it."""

    kind = ""
    status: str | None = None
    """The name of the state that shows the station to people; none without such a state."""

    @property
    def names(self) -> list[str]:
        """The names of the station in the interface."""
        return [self.name, *([self.status] if self.status else [])]


class Queue(_Station["_dca.Queue[T]"], Generic[T]):
    """A queue, to which other processes send: `Commands = dca.Queue(Pace, capacity=4, full="drop oldest", lock="wheels")`.

    `full` is `reject`, `drop lowest` or `drop oldest`. With `lock`, the attribute of a `dca.Lock`, the queue accepts only messages of
    the user that holds this lock. `status` is the name of the state that `dca queue` shows.
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
        super().__init__(name, doc=doc)
        self.message = message_type(message)
        if full not in _FULL:
            raise TypeError(f"`{full}` is not what a full queue does: {', '.join(_FULL)}")
        self.capacity, self.full, self.lock, self.status = _capacity(capacity), full, lock, status


class Sender(_Station["_dca.Sender[T]"], Generic[T]):
    """The queue of another process, which the spec connects: `Commands = dca.Sender(Pace)`."""

    kind = "sender"

    def __init__(self, message: type[T], *, optional: bool = False, name: str | None = None, doc: str = "") -> None:
        super().__init__(name, optional=optional, doc=doc)
        self.message = message_type(message)


class Lock(_Station["_dca.Lock"]):
    """The lock of a resource of this class: `wheels = dca.Lock(lease="1 s")`.

    A grant ends after `lease` without a renewal. With `preempt_after`, a holder may keep the lock for at most this time when a user of
    greater priority wants it.
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
        super().__init__(name, doc=doc)
        self.lease = _span(lease, "lease")
        self.preempt_after = None if preempt_after is None else _span(preempt_after, "preempt_after")
        self.status = status


class LockUser(_Station["_dca.LockUser"]):
    """The lock of another process, which the spec connects: `wheels = dca.LockUser()`."""

    kind = "lock user"

    def __init__(self, *, optional: bool = False, name: str | None = None, doc: str = "") -> None:
        super().__init__(name, optional=optional, doc=doc)


class Router(_Station["_dca.Router[T]"], Generic[T]):
    """A router, to which others subscribe: `News = dca.Router(Speed, outbox=64)`. If an outbox is full, its oldest message is dropped."""

    kind = "router"

    def __init__(
        self, message: type[T], *, outbox: int = 64, status: str | None = None, name: str | None = None, doc: str = ""
    ) -> None:
        super().__init__(name, doc=doc)
        self.message = message_type(message)
        self.outbox_max, self.status = _capacity(outbox), status


class Subscriber(_Station["_dca.Subscriber[T]"], Generic[T]):
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
        super().__init__(name, optional=optional, doc=doc)
        self.message = message_type(message)
        self.capacity, self.filters = _capacity(capacity), list(filters)


class _Keys(Declared[R]):
    kind = ""

    def __init__(self, *, optional: bool = False, name: str | None = None, doc: str = "") -> None:
        super().__init__(name, optional=optional, doc=doc)


class KeyNews(_Keys["_dca.KeyNews"]):
    """An input that a spec connects with keys of the database: `db("team/claim/**") -> robot, Claims;`."""

    kind = "news"


class KeyAnswers(_Keys["_dca.KeyAnswers"]):
    """An input that receives whether the writes of a `dca.KeyWriter` were committed."""

    kind = "answers"


class KeyWriter(_Keys["_dca.KeyWriter"]):
    """An output that a spec connects with keys of the database: `robot, Claim -> db("team/claim/**");`."""

    kind = "writer"


class Asked(Generic[A]):
    """A request whose reply is expected."""

    def __init__(self, sending: "_dca.Sending", until: float) -> None:
        self._sending, self._until = sending, until
        self._end: tuple[Any, str | None] | None = None

    @property
    def done(self) -> bool:
        """Whether the answer has arrived, or will certainly not arrive."""
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
            self._end = (None, "no answer came in time: the request may have been carried out")


class Requester(Generic[T, A]):
    """Requests over queues: questions go to a queue of another process, and answers come to a queue of this process. A marker connects question and answer.

    Make it in `init` of a class with `Questions = dca.Sender(Question)` and `Answers = dca.Queue(Answer)`. The other process answers with
    `self.Answers.send(answer, to=taken.sender, marker=taken.marker, within="1 s")`.
    """

    def __init__(self, questions: "_dca.Sender[T]", answers: "_dca.Queue[A]") -> None:
        self._questions, self._answers = questions, answers
        self._open: dict[int, Asked[A]] = {}
        self._last = 0

    def ask(self, now: float, question: T, *, within: str | float, category: str = "", priority: int = 0) -> Asked[A]:
        """Sends a question after this calculation."""
        self._last += 1
        sending = self._questions.send(
            question, within=within, category=category, priority=priority, marker=self._last
        )
        asked: Asked[A] = Asked(sending, now + _dca.si(within, "Time"))
        self._open[self._last] = asked
        return asked

    def work(self, now: float) -> None:
        """Takes the answers. Call this once in each calculation."""
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
