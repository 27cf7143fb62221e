"""The native half of `dca`."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Generic, TypeVar

A = TypeVar("A")
T = TypeVar("T")

class CallError(Exception):
    """A call has no result; the text is the reason."""

class Refused(Exception):
    """A procedure refuses a call; the text is the reason for the caller."""

class DatabaseFailure(Exception):
    """A request to the database has no result; the text is the reason."""

class DatabaseUnknown(DatabaseFailure):
    """The result of a request is unknown: the write may have been committed."""

class Entry:
    """A key and its value at the time when it was read."""

    @property
    def key(self) -> str: ...
    @property
    def value(self) -> Any:
        """The value; `None` if it was deleted."""
    @property
    def version(self) -> str:
        """The transaction that has written the value."""
    @property
    def is_conflict(self) -> bool:
        """Whether another value was written concurrently, and the conflict is not resolved."""

class Opaque:
    """A value that this program cannot read, such as a sealed secret. It is written back unchanged."""

class Database:
    """The database of the robot."""

    @property
    def pending(self) -> int:
        """The number of requests without an answer."""
    def get(self, key: str, *, within: str | float) -> Request:
        """Requests the value of a key; `result()` then returns an `Entry`, or `None` if the key has no value."""
    def put(self, key: str, value: Any, *, within: str | float, expected: str | None = None) -> Request:
        """Writes one key. With `expected`, only if the key is in this state: `ABSENT`, `EXISTS`, or the version of an entry."""
    def transact(
        self,
        reason: str,
        writes: Mapping[str, Any],
        *,
        within: str | float,
        requires: Mapping[str, str] | None = None,
    ) -> Request:
        """Changes several keys, all or none. `writes` has new values by key, `None` to delete; `requires` has expected states."""
    def watch(self, prefix: str) -> Watch:
        """Watches a key, or the keys below a prefix that ends with `/`, until the activation ends."""

class Request:
    """A request to the database."""

    @property
    def done(self) -> bool:
        """Whether the answer has arrived."""
    def result(self) -> Any:
        """Returns the entry that was read, or the version that was committed; raises `dca.DatabaseFailure` if there is none."""

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
    """A watch of keys. Iterating over it gives the events since the last iteration."""

    def __iter__(self) -> Iterator[WatchChange]: ...
    def stop(self) -> None:
        """Ends the watch."""

class Calls(Generic[A, T]):
    """Calls of one procedure of another process, which the spec connects."""

    @property
    def is_connected(self) -> bool:
        """Whether the spec connects this call to a process."""
    @property
    def pending(self) -> int:
        """The number of calls without an answer."""
    def call(self, argument: A | None = None, *, within: str | float, to: str | None = None) -> Call[T]:
        """Makes a call, which is sent after this calculation. If the spec connects several processes, `to` is the path of one."""

class Call(Generic[T]):
    """A call whose result is expected."""

    @property
    def done(self) -> bool:
        """Whether the answer has arrived."""
    def result(self) -> T:
        """Returns the result; raises `dca.CallError` if there is none."""
    def cancel(self) -> None:
        """Stops waiting for the answer. If the other end has not begun the call, it never will."""

class Reply(Generic[T]):
    """The way of the answer to one call. A method may keep it, and answer in a later calculation."""

    @property
    def is_wanted(self) -> bool:
        """Whether the caller still waits."""
    def send(self, value: T | None = None) -> None:
        """Sends the answer."""
    def refuse(self, reason: str) -> None:
        """Refuses the call, with a reason in one line."""

class SendError(Exception):
    """A message is not in its queue, or may not be; the text is the reason."""

class Taken(Generic[T]):
    """A message that was taken from a queue."""

    @property
    def data(self) -> T: ...
    @property
    def category(self) -> str: ...
    @property
    def sender(self) -> str:
        """The process that has sent the message."""
    @property
    def priority(self) -> int: ...
    @property
    def marker(self) -> int:
        """The number that connects a reply with its request; 0 in all other messages."""
    @property
    def fence(self) -> int | None:
        """The fencing number of the lock under which the message was sent."""

class Queue(Generic[T]):
    """A queue, to which other processes send."""

    def take(self) -> Taken[T] | None:
        """Takes the message of the highest priority, the oldest among several; `None` if the queue is empty."""
    def __iter__(self) -> Iterator[Taken[T]]: ...
    def __len__(self) -> int: ...

class Sender(Generic[T]):
    """Another process's queue, as seen by its client."""

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
        """Sends a message after this calculation, and repeats it until its receipt comes. The queue takes it once."""

class Sending:
    """A message that was sent."""

    @property
    def done(self) -> bool:
        """Whether the result of the message is known."""
    def result(self) -> None:
        """Returns `None` if the queue has accepted the message. Raises `dca.SendError` if the queue has not accepted the message, or may not have accepted it."""

class Lock:
    """A lock, as seen by the class with the resource."""

    @property
    def held(self) -> int | None:
        """The fencing number of the present holder; `None` if the lock is free."""
    @property
    def holder(self) -> str:
        """The name of the present holder; empty if the lock is free."""
    def admits(self, fence: int | None) -> bool:
        """Returns whether a command with this fencing number may be carried out."""

class LockUser:
    """Another process's lock, as seen by its user."""

    @property
    def held(self) -> int | None:
        """The fencing number to send with each command, as long as the lock counts as held; otherwise `None`."""
    @property
    def is_wanted(self) -> bool:
        """Whether a user of greater priority waits for the lock that this user holds."""
    @property
    def is_idle(self) -> bool:
        """Whether the lock is neither wanted nor held."""
    @property
    def holder(self) -> str:
        """The name of the holder when this user was last told to wait."""
    @property
    def lost(self) -> str | None:
        """Why the lock was lost, or could not be granted, since it was last wanted; otherwise `None`."""
    def want(self, priority: int = 0) -> None:
        """Requests the lock; a greater priority goes first."""
    def let_go(self) -> None:
        """Releases the lock, or stops waiting for it."""

class Router(Generic[T]):
    """A router, as seen by its class."""

    @property
    def subscribers(self) -> list[str]:
        """The names of the subscribers."""
    def send(self, value: T, *, category: str = "", priority: int = 0, marker: int = 0) -> None:
        """Sends a message to all subscribers whose filters accept its header."""
    def dropped(self) -> list[tuple[str, str, int]]:
        """Takes the subscribers that were removed since the last call: the name, the reason, and the number of lost messages."""

class Subscriber(Generic[T]):
    """Another process's router, as seen by its subscriber."""

    @property
    def state(self) -> str:
        """The state of the subscription: `asking` while it is unknown, `yes`, or the reason why it was refused."""
    def take(self) -> Taken[T] | None:
        """Takes the next message; `None` if none waits."""
    def set_filters(self, filters: Sequence[Any]) -> None:
        """Replaces the filters; without filters, the subscriber gets all messages."""
    def __iter__(self) -> Iterator[Taken[T]]: ...
    def __len__(self) -> int: ...

class KeyNews:
    """An input that receives the changes of the keys that it is connected to."""

    def __iter__(self) -> Iterator[WatchChange]: ...

class KeyAnswers:
    """An input that receives whether the writes of an output were committed."""

    def __iter__(self) -> Iterator[tuple[int, str | None]]:
        """Iterates over answers: the number of a write, and `None` if it was committed, otherwise why it was not, or may not be."""

class KeyWriter:
    """An output that writes values at the keys that it is connected to."""

    def put(self, key: str, value: Any, *, within: str | float, expected: str | None = None) -> int:
        """Writes a value at a key after this calculation; `None` deletes the key. Returns the number of the write."""

__version__: str

class MessageType:
    name: str
    fields: str
    inner: list[tuple[str, str]]
    def __init__(self, described: Any, form: Any) -> None: ...
    is_standard: bool
    @staticmethod
    def of_ros(name: str, classes: Sequence[type[Any]], allow_nan: bool) -> MessageType:
        """Returns the type of a standard ROS 2 message; `classes` are the Python classes of its structs."""
    def encode(self, value: Any) -> bytes: ...
    def decode(self, bytes: bytes) -> Any: ...
    def encode_cdr(self, value: Any) -> bytes: ...
    def decode_cdr(self, bytes: bytes) -> Any: ...

class RosDefinition:
    """The definition of a standard ROS 2 message."""

    name: str
    spec: str
    fields: list[RosField]
    constants: list[tuple[str, Any]]
    inner: list[str]
    allow_nan: bool

class RosField:
    """A field of a definition. `count` is the length of an array, 0 for a list of any length, and `None` for a single value."""

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
    """An input of a controller. It holds the newest value that has arrived."""

    @property
    def measured(self) -> float | None:
        """When the newest value was measured, or arrived if it has no such time; seconds on this host's clock."""
    @property
    def arrived(self) -> float | None:
        """When the newest value arrived; seconds on this host's clock."""
    @property
    def received(self) -> int:
        """The number of values that have arrived in this activation."""
    @property
    def lost(self) -> int:
        """The number of values that were sent to this input in this activation but did not arrive."""
    @property
    def refused(self) -> int:
        """The number of values that were refused in this activation because a number in them was not finite."""
    def latest(self) -> T | None:
        """Returns the newest value of any age; `None` before the first one."""
    def fresh(self) -> T | None:
        """Returns the newest value if it arrived since the last calculation, otherwise `None`."""
    def fresh_within(self, now: float, age_max: str | float) -> T | None:
        """Returns the newest value if it is at most `age_max` old at `now`, otherwise `None`."""
    def stale(self, now: float, age_max: str | float) -> bool:
        """Returns whether no value is at most `age_max` old at `now`."""
    def age(self, now: float) -> float | None:
        """Returns the age of the newest value at `now`, in seconds; `None` before the first one."""

class EveryInput(Generic[T]):
    """An input that keeps every value since the last calculation."""

    @property
    def received(self) -> int:
        """The number of values that have arrived in this activation."""
    @property
    def lost(self) -> int:
        """The number of values that were sent to this input in this activation but did not arrive."""
    @property
    def refused(self) -> int:
        """The number of values that were refused in this activation because a number in them was not finite."""
    def __iter__(self) -> Iterator[T]: ...
    def __len__(self) -> int: ...

class Output(Generic[T]):
    """An output of a controller."""

    @property
    def pending(self) -> bool:
        """Whether a value waits to be sent."""
    def send(self, value: T) -> None:
        """Sends a value after this calculation. If several are sent in one calculation, only the last one leaves."""

class Tick:
    """The moment of one calculation."""

    @property
    def now(self) -> float:
        """The time on this host's clock, in seconds."""
    @property
    def elapsed(self) -> float:
        """The seconds since the previous calculation of this activation. At the first calculation it is one period."""
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
