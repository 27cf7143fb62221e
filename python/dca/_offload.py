"""Long work on other threads: one calculation starts it, and a later one takes the result."""

import queue
import threading
from collections.abc import Callable
from typing import Generic, ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")

_THREADS = 4
_WAITING_MAX = 64


class Offloaded(Generic[T]):
    """Work that runs on another thread."""

    def __init__(self, run: Callable[[], T]) -> None:
        self._run: Callable[[], T] | None = run
        self._over = threading.Event()
        self._result: T | None = None
        self._error: BaseException | None = None

    @property
    def done(self) -> bool:
        """Whether the work has ended."""
        return self._over.is_set()

    def result(self) -> T:
        """Returns the result of the function, or raises its exception."""
        if not self._over.is_set():
            raise RuntimeError("the work has not ended yet: see `done`")
        if self._error is not None:
            raise self._error
        return self._result  # type: ignore[return-value]

    def cancel(self) -> bool:
        """Prevents the work from beginning. Work that is already running continues. Returns false if the work has ended."""
        self._run = None
        return not self._over.is_set()

    def _work(self) -> None:
        run = self._run
        if run is not None:
            try:
                self._result = run()
            except BaseException as error:
                self._error = error
        else:
            self._error = RuntimeError("the work was cancelled")
        # The objects of the function are released here, not by the control loop.
        self._run = run = None
        self._over.set()


class _Pool:
    def __init__(self) -> None:
        self._waiting: queue.Queue[Offloaded] = queue.Queue(_WAITING_MAX)
        self._lock = threading.Lock()
        self._threads = 0
        self._idle = 0

    def put(self, work: Offloaded) -> None:
        try:
            self._waiting.put_nowait(work)
        except queue.Full:
            raise RuntimeError(f"{_WAITING_MAX} pieces of work wait already") from None
        with self._lock:
            is_needed = self._idle < self._waiting.qsize() and self._threads < _THREADS
            self._threads += is_needed
        if is_needed:
            # Daemon threads do not prevent a program from ending.
            threading.Thread(target=self._serve, name="dca-offload", daemon=True).start()

    def _serve(self) -> None:
        while True:
            with self._lock:
                self._idle += 1
            work = self._waiting.get()
            with self._lock:
                self._idle -= 1
            work._work()
            del work


_pool = _Pool()


def offload(function: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Offloaded[T]:
    """Runs a function on another thread. A later calculation checks `done` and takes `result()`.

    Four functions run at a time, and 64 wait. The control loop and its watchdog continue as long as the function releases the
    interpreter's lock, like numpy, files and sockets. For work in pure Python use a process: `subprocess`, or `multiprocessing` with the
    method `spawn`.
    """
    work: Offloaded[T] = Offloaded(lambda: function(*args, **kwargs))
    _pool.put(work)
    return work
