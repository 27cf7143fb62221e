"""The native half of `dca`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

A = TypeVar("A")
T = TypeVar("T")

class CallError(Exception):
    """A call that has no result, and why."""

class Refused(Exception):
    """A procedure that is not carried out, and why, for its caller."""

class DatabaseFailure(Exception):
    """A request to the database that has no result, and why."""

class DatabaseUnknown(DatabaseFailure):
    """The result is unknown: the write may have been committed."""

class Entry:
    """A key with its value, when it was read."""

    @property
    def key(self) -> str: ...
    @property
    def value(self) -> Any:
        """The value; `None` if it was deleted."""
    @property
    def version(self) -> str:
        """The transaction that has written it."""
    @property
    def is_conflict(self) -> bool:
        """Whether another value was written concurrently, and the conflict is not settled."""

class Opaque:
    """A value that this program cannot read, such as a sealed secret. It is written back as it was."""

class Database:
    """The database of the robot."""

    @property
    def pending(self) -> int:
        """How many requests have no answer yet."""
    def get(self, key: str, *, within: str | float) -> Request:
        """Asks what a key holds."""
    def put(self, key: str, value: Any, *, within: str | float, expected: str | None = None) -> Request:
        """Writes one key; with `expected` only if the key is as expected."""
    def transact(
        self,
        reason: str,
        writes: Mapping[str, Any],
        *,
        within: str | float,
        requires: Mapping[str, str] | None = None,
    ) -> Request:
        """Changes several keys together, or none."""
    def watch(self, prefix: str) -> Watch:
        """Watches a key, or the keys below a prefix that ends in `/`, until the activation ends."""

class Request:
    """A request to the database."""

    @property
    def done(self) -> bool:
        """Whether there is an answer."""
    def result(self) -> Any:
        """Returns the entry that was read, or the version that was committed."""

class WatchChange:
    """An event of a watch."""

    @property
    def kind(self) -> str:
        """`begin`, `present`, `complete` or `changed`."""
    @property
    def entries(self) -> list[Entry]: ...
    @property
    def by(self) -> str: ...
    @property
    def reason(self) -> str: ...

class Watch:
    """A watch of keys."""

    def __iter__(self) -> Iterator[WatchChange]: ...
    def stop(self) -> None:
        """Ends the watch."""

class Calls(Generic[A, T]):
    """Calls of one procedure of another process, which the spec connects."""

    @property
    def is_connected(self) -> bool:
        """Whether the spec connects this call with something."""
    @property
    def pending(self) -> int:
        """How many calls have no answer yet."""
    def call(self, argument: A | None = None, *, within: str | float, to: str | None = None) -> Call[T]:
        """Calls after this calculation; `to` is the path of a process, where the spec connects several."""

class Call(Generic[T]):
    """A call on its way."""

    @property
    def done(self) -> bool:
        """Whether there is an answer."""
    def result(self) -> T:
        """Returns the result; raises `dca.CallError` if there is none."""
    def cancel(self) -> None:
        """Waits no more for it. If it has not begun at the other end, it never does."""

class Reply(Generic[T]):
    """The way of the answer to one call, which may be kept and answered in a later calculation."""

    @property
    def is_wanted(self) -> bool:
        """Whether the caller still waits."""
    def send(self, value: T | None = None) -> None:
        """Answers."""
    def refuse(self, reason: str) -> None:
        """Answers with a reason for not doing it, in one line."""

class SendError(Exception):
    """A message that is not in its queue, or may not be, and why."""

class Taken(Generic[T]):
    """A message that was taken out of a queue."""

    @property
    def data(self) -> T: ...
    @property
    def category(self) -> str: ...
    @property
    def sender(self) -> str:
        """The process that has sent it."""
    @property
    def priority(self) -> int: ...
    @property
    def marker(self) -> int:
        """What joins an answer with its question; 0 if it is neither."""
    @property
    def fence(self) -> int | None:
        """The fencing number of the lock under which it was sent."""

class Queue(Generic[T]):
    """A queue, which others send to."""

    def take(self) -> Taken[T] | None:
        """Takes the message with the highest priority, and of those the one that came first; `None` if none waits."""
    def __iter__(self) -> Iterator[Taken[T]]: ...
    def __len__(self) -> int: ...

class Sender(Generic[T]):
    """The queue of another process, as its client sees it."""

    def send(
        self,
        value: T,
        *,
        within: str | float,
        category: str = "",
        priority: int = 0,
        marker: int = 0,
        to: str | None = None,
        fence: int | None = None,
    ) -> Sending:
        """Sends a message after this calculation, and again until its receipt comes; the queue takes it once."""

class Sending:
    """A message on its way."""

    @property
    def done(self) -> bool:
        """Whether it is known what became of the message."""
    def result(self) -> None:
        """Returns nothing if the message is in the queue, or was; raises `dca.SendError` if it is not, or may not be."""

class Lock:
    """A lock as the class that has the resource sees it."""

    @property
    def held(self) -> int | None:
        """The fencing number of the user that holds it; `None` if it is free."""
    @property
    def holder(self) -> str:
        """The name of the user that holds it; empty if it is free."""
    def admits(self, fence: int | None) -> bool:
        """Returns whether a command with this fencing number may be carried out."""

class LockUser:
    """The lock of another process as its user sees it."""

    @property
    def held(self) -> int | None:
        """The fencing number that goes with each command, as long as the lock may be believed to be held."""
    @property
    def is_wanted(self) -> bool:
        """Whether a user with a greater priority waits for this one to let go."""
    @property
    def is_idle(self) -> bool:
        """Whether nothing is wanted or held."""
    @property
    def holder(self) -> str:
        """The name of the user that held it when this one was last told to wait."""
    @property
    def lost(self) -> str | None:
        """Why the lock was lost, or was not to be had, since it was wanted last."""
    def want(self, priority: int = 0) -> None:
        """Wants the lock, with a priority."""
    def let_go(self) -> None:
        """Lets go of it, or waits no more."""

class Router(Generic[T]):
    """A router as its class sees it."""

    @property
    def subscribers(self) -> list[str]:
        """The names of its subscribers."""
    def send(self, value: T, *, category: str = "", priority: int = 0, marker: int = 0) -> None:
        """Sends a message to all subscribers whose filters take its header."""
    def dropped(self) -> list[tuple[str, str, int]]:
        """Takes the subscribers that were dropped since: the name, why, and how many messages for it were lost."""

class Subscriber(Generic[T]):
    """The router of another process, as its subscriber sees it."""

    @property
    def state(self) -> str:
        """Whether the router sends to it: `asking` as long as that is not known, `yes`, or the reason why not."""
    def take(self) -> Taken[T] | None:
        """Takes the next message; `None` if none waits."""
    def set_filters(self, filters: Sequence[Any]) -> None:
        """Wants other messages from now on."""
    def __iter__(self) -> Iterator[Taken[T]]: ...
    def __len__(self) -> int: ...

class KeyNews:
    """What is known of the keys that an input is connected with."""

    def __iter__(self) -> Iterator[WatchChange]: ...

class KeyAnswers:
    """What became of the values that an output has put."""

    def __iter__(self) -> Iterator[tuple[int, str | None]]:
        """Iterates over the number of a put, and `None` if it was committed, else why it was not, or may not be."""

class KeyWriter:
    """An output that puts values at the keys that it is connected with."""

    def put(self, key: str, value: Any, *, within: str | float, expected: str | None = None) -> int:
        """Puts a value at a key after this calculation, or deletes it with `None`; returns the number of the put."""

__version__: str

class MessageType:
    name: str
    fields: str
    inner: list[tuple[str, str]]
    def __init__(self, described: Any, form: Any) -> None: ...
    is_standard: bool
    @staticmethod
    def of_ros(name: str, classes: Sequence[type[Any]], allow_nan: bool) -> MessageType:
        """Returns the type of a standard message of ROS 2, whose structs have these classes."""
    def encode(self, value: Any) -> bytes: ...
    def decode(self, bytes: bytes) -> Any: ...
    def encode_cdr(self, value: Any) -> bytes: ...
    def decode_cdr(self, bytes: bytes) -> Any: ...

class RosDefinition:
    """The definition of a standard message of ROS 2."""

    name: str
    spec: str
    fields: list[RosField]
    constants: list[tuple[str, Any]]
    inner: list[str]
    allow_nan: bool

class RosField:
    """A field of a definition. `count` is 0 of a list, and `None` of a single value."""

    name: str
    of: str
    count: int | None
    default: str | None

def ros_definition(spec: str) -> RosDefinition | None:
    """Returns the definition of a standard message by its name in a spec."""

def ros_names(package: str) -> list[str]:
    """Returns the names of the standard messages in a package."""

class NativeHarness:
    @property
    def now(self) -> float: ...
    def __init__(self, seed: int, is_busy: bool) -> None: ...
    def add(self, declaration: Any, arguments: Sequence[str]) -> int: ...
    def connect(self, from_: tuple[int, str], to: tuple[int, str], /) -> int: ...
    def switch(self, wire: int, is_open: bool) -> None: ...
    def activate(self, module: int, value: bytes) -> None: ...
    def configure(self, module: int, arguments: Sequence[str]) -> None: ...
    def stop(self, module: int) -> None: ...
    def crash(self, module: int) -> None: ...
    def send_to(self, module: int, port: str, bytes: bytes) -> None: ...
    def run(self, within: str | float) -> tuple[int, float, str, bytes, str] | None: ...
    def is_active(self, module: int) -> bool: ...
    def take_sent(self) -> list[tuple[float, int, str, bytes]]: ...

class Input(Generic[T]):
    """An input of a controller: holds the newest value that arrived."""

    @property
    def measured(self) -> float | None:
        """The time when the newest value was measured, or else when it arrived."""
    @property
    def arrived(self) -> float | None:
        """The time when the newest value arrived."""
    @property
    def received(self) -> int:
        """How many values have arrived in this activation."""
    @property
    def lost(self) -> int:
        """How many values were sent to this input in this activation and have not come."""
    @property
    def refused(self) -> int:
        """How many values were refused in this activation, because a number in them was not finite."""
    def latest(self) -> T | None:
        """Returns the newest value, however old; `None` before the first."""
    def fresh(self) -> T | None:
        """Returns the newest value if it arrived since the last calculation."""
    def fresh_within(self, now: float, age_max: str | float) -> T | None:
        """Returns the newest value if it is at most `age_max` old at `now`."""
    def stale(self, now: float, age_max: str | float) -> bool:
        """Returns whether there is no value that is at most `age_max` old at `now`."""
    def age(self, now: float) -> float | None:
        """Returns how old the newest value is at `now`, in seconds."""

class EveryInput(Generic[T]):
    """An input that keeps every value that has arrived since the last calculation."""

    @property
    def lost(self) -> int:
        """How many values were sent to this input in this activation and are not among those that it had."""
    @property
    def refused(self) -> int:
        """How many values were refused in this activation, because a number in them was not finite."""
    def __iter__(self) -> Iterator[T]: ...
    def __len__(self) -> int: ...

class Output(Generic[T]):
    """An output of a controller."""

    @property
    def pending(self) -> bool:
        """Whether a value waits to be sent."""
    def send(self, value: T) -> None:
        """Sends a value after this calculation; of two values in one calculation the second goes."""

class Tick:
    """The moment of one calculation."""

    @property
    def now(self) -> float:
        """This host's clock, in seconds."""
    @property
    def elapsed(self) -> float:
        """The seconds since the last calculation of this activation; one period at the first."""
    def __init__(self, now: float, elapsed: float = 0.0) -> None: ...

class Done:
    """The normal end of an activation."""

    @property
    def value(self) -> bytes: ...
    @property
    def tag(self) -> str | None: ...
    def __init__(self, bytes: bytes, tag: str | None = None) -> None: ...

class Abort:
    """The failed end of an activation."""

    @property
    def reason(self) -> str: ...
    def __init__(self, reason: str) -> None: ...

def run(declarations: Sequence[Any], arguments: Sequence[str]) -> int: ...
def interface(declarations: Sequence[Any]) -> str: ...
def si(value: str | float, type_name: str) -> float: ...
