"""A client of robots for asyncio: calls, states, values of outputs, events, keys, deployments.

    async with dca.aio.Client() as robot:
        width = await robot.call("hand.Grip", {"force": "20 N"})
        async for value in robot.echo("force.Out"):
            ...

Each request runs the program `dca` once, and its answer completes a future on the running loop. Nothing here blocks the loop, and there
are no threads. A service with many requests should be a controller instead. When a task is cancelled, its request is ended.
"""

import asyncio
import contextlib
import json
import os
import shutil
from collections.abc import AsyncIterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

__all__ = ["Client", "ClientError", "Deployment"]

_LINE_MAX = 16 << 20
_ENDS = {1: "refused or failed", 2: "not understood", 3: "no node can be reached", 4: "not decided in time"}


class ClientError(Exception):
    """A request without an answer. `code` is the exit code of `dca`, and the text is its error message."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text or _ENDS.get(code, f"`dca` has ended with code {code}"))
        self.code = code


@dataclass(slots=True)
class Deployment:
    """A deployment that was started. `wait` returns the exit code of its mission, 0 if the mission is done."""

    _process: asyncio.subprocess.Process
    _told: "asyncio.Task[tuple[str, str]]"

    async def wait(self) -> int:
        """Waits for the end of the mission. Returns 0 if the mission is done, and raises `ClientError` if it has failed."""
        out, errors = await asyncio.shield(self._told)
        code = await self._process.wait()
        if code != 0:
            raise ClientError(code, _last(errors) or _last(out))
        return code

    @property
    def is_over(self) -> bool:
        """Whether the mission has ended."""
        return self._process.returncode is not None


class Client:
    """Sends requests to this machine's node, or with `lan` to the nodes of the local network.

    `program` is `dca`, by default from `$DCA` or `PATH`.
    """

    def __init__(
        self,
        *,
        program: str | os.PathLike[str] | None = None,
        run_dir: str | os.PathLike[str] | None = None,
        lan: bool = False,
        keys: str | os.PathLike[str] | None = None,
        directory: str | os.PathLike[str] | None = None,
    ) -> None:
        found = program or os.environ.get("DCA") or shutil.which("dca")
        if found is None:
            raise FileNotFoundError("there is no program `dca` in `PATH`: give its path, `dca.aio.Client(program=...)`")
        self._program = os.fspath(found)
        self._directory = directory
        self._options: list[str] = ["--lan"] if lan else []
        self._options += [] if run_dir is None else ["--run-dir", os.fspath(run_dir)]
        self._options += [] if keys is None else ["--keys", os.fspath(keys)]
        self._running: set[asyncio.subprocess.Process] = set()

    async def __aenter__(self) -> "Client":
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def close(self) -> None:
        """Ends all open requests. Deployments continue."""
        for process in list(self._running):
            await _end(process)
        self._running.clear()

    async def call(self, name: str, argument: Mapping[str, Any] | None = None, *, within: float = 5.0) -> Any:
        """Calls a procedure, `hand.Grip`; returns its result as dicts and lists. A quantity is a text with a unit, `"20 N"`."""
        words = [f"{field}={_spelt(value)}" for field, value in (argument or {}).items()]
        return _result(await self._json("call", name, *words, options=["--within", str(within)]))

    async def get(self, name: str, *, within: float = 5.0) -> Any:
        """Reads a state, `hand.opening`."""
        return _result(await self._json("get", name, options=["--within", str(within)]))

    async def status(self, deployment: str | None = None) -> Any:
        """Returns the processes of all hosts, as `dca status --json` shows them."""
        return await self._json("status", *_optional(deployment))

    async def key(self, key: str) -> Any:
        """Returns the output of `dca db get --json` for a key."""
        return await self._json("db get", key)

    def echo(self, output: str, *, count: int | None = None) -> AsyncIterator[Any]:
        """Iterates over the values that leave an output, `force.Out`, as dicts with `value` and `at`."""
        return self._lines("echo", output, options=[] if count is None else ["--count", str(count)])

    def events(self, deployment: str | None = None) -> AsyncIterator[Any]:
        """Iterates over the past and new events, as dicts."""
        return self._lines("events", *_optional(deployment), options=["--follow"])

    def watch(self, prefix: str = "") -> AsyncIterator[Any]:
        """Iterates over the changes of the keys below a prefix that ends with `/`, or of one key, as dicts."""
        return self._lines("db watch", prefix)

    async def deploy(self, spec: str | os.PathLike[str], *, set: Mapping[str, Any] | None = None) -> Deployment:
        """Deploys a spec on the hosts that it names. The mission continues until it ends or is stopped."""
        values = [word for name, value in (set or {}).items() for word in ("--set", f"{name}={_spelt(value)}")]
        process = await self._start("deploy", [os.fspath(spec)], ["--no-record", *values])
        return Deployment(process, asyncio.create_task(_told(process)))

    async def stop(self, deployment: str) -> Any:
        """Stops a deployment on all its hosts."""
        return await self._json("stop", deployment)

    async def _start(self, verb: str, words: Sequence[str], options: Sequence[str]) -> asyncio.subprocess.Process:
        pipe = asyncio.subprocess.PIPE
        return await asyncio.create_subprocess_exec(
            self._program,
            *verb.split(),
            *options,
            *self._options,
            # A name that looks like an option is not treated as one.
            "--",
            *words,
            stdin=asyncio.subprocess.DEVNULL,
            stdout=pipe,
            stderr=pipe,
            cwd=self._directory,
            limit=_LINE_MAX,
            start_new_session=True,
        )

    async def _json(self, verb: str, *words: str, options: Sequence[str] = ()) -> Any:
        process = await self._start(verb, words, [*options, "--json"])
        self._running.add(process)
        try:
            out, errors = await _told(process)
        finally:
            self._running.discard(process)
            await _end(process)
        if process.returncode != 0:
            raise ClientError(process.returncode or 0, _last(errors) or _last(out))
        return json.loads(out) if out.strip() else None

    async def _lines(self, verb: str, *words: str, options: Sequence[str] = ()) -> AsyncIterator[Any]:
        process = await self._start(verb, words, [*options, "--json"])
        self._running.add(process)
        errors = asyncio.create_task(_read(process.stderr))
        try:
            assert process.stdout is not None
            async for line in process.stdout:
                value = json.loads(line)
                if isinstance(value, dict) and set(value) == {"end"}:
                    break
                yield value
            code = await process.wait()
            if code != 0:
                raise ClientError(code, _last(await errors))
        finally:
            self._running.discard(process)
            await _end(process)
            errors.cancel()


def _spelt(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{name} = {_spelt(one)}" for name, one in value.items()) + " }"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(_spelt, value)) + "]"
    return str(value) if isinstance(value, str) else repr(value)


def _optional(word: str | None) -> list[str]:
    return [] if word is None else [word]


def _result(answer: Any) -> Any:
    return answer["value"] if isinstance(answer, dict) and "value" in answer else None


def _last(text: str) -> str:
    lines = text.strip().splitlines()
    return lines[-1].removeprefix("error: ") if lines else ""


async def _read(stream: asyncio.StreamReader | None) -> str:
    return "" if stream is None else (await stream.read()).decode(errors="replace")


async def _told(process: asyncio.subprocess.Process) -> tuple[str, str]:
    out, errors = await asyncio.gather(_read(process.stdout), _read(process.stderr))
    await process.wait()
    return out, errors


async def _end(process: asyncio.subprocess.Process) -> None:
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        # The process is waited for, even if the task is cancelled again.
        await asyncio.shield(process.wait())
