"""The client for asyncio, with a running mission."""

import asyncio

import dca.aio
import pytest

PROGRAM = """
from dataclasses import dataclass
import dca

@dca.message
@dataclass
class Width:
    length: dca.Length

@dca.task("Fingers.", every="20 ms")
class Hand:
    Out = dca.Out(Width)

    def __init__(self):
        self.width, self.over = 0.1, False

    def main_calc(self, tick):
        self.Out.send(Width(self.width))
        return dca.done() if self.over else None

    @dca.procedure
    def Grip(self, width: Width) -> Width:
        if width.length > 1.0:
            raise dca.Refused("it is too wide")
        self.width = width.length
        return Width(self.width)

    @dca.procedure
    def End(self) -> None:
        self.over = True

    @dca.state
    def opening(self) -> Width:
        return Width(self.width)

if __name__ == "__main__":
    dca.run(Hand)
"""

SPEC = """
module Hand { python "hand.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ hand instof Hand(c1); }
    internal_event_actions{ hand within 60 s }
}
"""


async def until(ask):
    """Repeats a request until it is answered, since the mission may just be starting."""
    for _ in range(100):
        try:
            return await ask()
        except dca.aio.ClientError:
            await asyncio.sleep(0.1)
    return await ask()


async def talk(robot):
    assert await until(lambda: robot.get("hand.opening")) == {"length": 0.1}
    assert await robot.call("hand.Grip", {"length": "20 cm"}) == {"length": 0.2}
    with pytest.raises(dca.aio.ClientError, match="it is too wide") as refused:
        await robot.call("hand.Grip", {"length": "2 m"})
    assert refused.value.code == 1
    with pytest.raises(dca.aio.ClientError):
        await robot.call("--help")
    values = [value async for value in robot.echo("hand.Out", count=2)]
    assert len(values) == 2 and "0.2" in str(values[0]), values
    # Several requests at a time, on one loop.
    answers = await asyncio.gather(*(robot.get("hand.opening") for _ in range(3)))
    assert answers == [{"length": 0.2}] * 3
    async for event in robot.events():
        assert isinstance(event, dict)
        break
    assert "hand" in str(await robot.status())
    # A cancelled request is ended.
    watching = asyncio.create_task(anext(robot.watch("team/nothing/")))
    await asyncio.sleep(0.3)
    watching.cancel()
    with pytest.raises(asyncio.CancelledError):
        await watching
    await robot.call("hand.End")


def test_a_client_calls_reads_and_listens(missions):
    missions.write("hand.py", PROGRAM)
    missions.write("hand.dca", SPEC)
    with missions.begin("run", "hand.dca") as running:

        async def ask():
            async with dca.aio.Client(program=missions.dca, directory=missions.folder, run_dir=missions.run_dir) as robot:
                await talk(robot)
                assert not robot._running

        try:
            asyncio.run(asyncio.wait_for(ask(), 50))
            out, _ = running.communicate(timeout=40)
        finally:
            if running.poll() is None:
                running.terminate()
        assert running.returncode == 0, out


def test_a_program_that_is_not_there_is_named(monkeypatch):
    monkeypatch.setenv("PATH", "/nonexistent")
    monkeypatch.delenv("DCA", raising=False)
    with pytest.raises(FileNotFoundError, match="there is no program `dca` in `PATH`"):
        dca.aio.Client()
