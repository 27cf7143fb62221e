"""Calls and exports in real processes: two Python controllers, and a person with `dca call`."""

from dataclasses import dataclass

import dca
import pytest

SERVER = """
from dataclasses import dataclass
import dca

@dca.message
@dataclass
class Push:
    force: dca.Force

@dca.message
@dataclass
class Width:
    length: dca.Length

@dca.service("Fingers.", every="10 ms")
class Hand:
    def __init__(self):
        self.width, self.waiting = 0.1, []

    def main_calc(self, tick):
        for reply in self.waiting:
            reply.send(Width(self.width))
        self.waiting.clear()

    @dca.procedure
    def Grip(self, push: Push) -> Width:
        '''Closes the fingers.'''
        if push.force > 50.0:
            raise dca.Refused(f"{push.force} N would break it")
        self.width = 0.02
        return Width(self.width)

    @dca.procedure(name="Later")
    def later(self, reply: dca.Reply[Width]) -> None:
        self.waiting.append(reply)

    @dca.procedure
    def Break(self) -> None:
        raise ValueError("it is broken")

    @dca.state
    def opening(self) -> Width:
        return Width(self.width)

if __name__ == "__main__":
    dca.run(Hand)
"""

CLIENT = """
import dca
from hand import Push, Width

@dca.task("Grips.", every="20 ms", triggered_by="Grip")
class Client:
    Grip = dca.Calls(Push, Width)
    Later = dca.Calls(None, Width)
    Break = dca.Calls()
    lost = dca.Calls(None, None, name="Lost", optional=True)

    def init(self, value):
        self.first, self.calls = self.Grip.call(Push(20.0), within="10 s"), []

    def main_calc(self, tick):
        if not self.calls:
            if not self.first.done:
                return None
            try:
                self.first.result()
            except dca.CallError:
                # The hand is started at the same time, and may not run yet.
                self.first = self.Grip.call(Push(20.0), within="10 s")
                return None
            self.calls = [
                self.first,
                self.Grip.call(Push(100.0), within="10 s"),
                self.Later.call(within=10),
                self.Break.call(within=10),
                self.lost.call(within=10),
            ]
        if not all(call.done for call in self.calls):
            return None
        told = []
        for call in self.calls:
            try:
                told.append(repr(call.result()))
            except dca.CallError as error:
                told.append(str(error))
        print("; ".join(told))
        return dca.done()

if __name__ == "__main__":
    dca.run(Client)
"""

SPEC = """
module Hand { python "hand.py"; venv ".venv"; }
module Client { python "client.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ hand instof Hand(c1); client instof Client(c1); }
    internal_connections(hand, calls){
        client, Grip -> hand, Grip;
        client, Later -> hand, Later;
        client, Break -> hand, Break;
    }
    internal_event_actions{ hand[calls], client within 20 s }
}
"""


def test_calls_have_their_answers(missions):
    missions.write("hand.py", SERVER)
    missions.write("client.py", CLIENT)
    missions.write("hand.dca", SPEC)
    ended = missions.run("hand.dca")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    logs = missions("logs", "client").stdout
    assert "Width(length=0.02); 100.0 N would break it; Width(length=0.02); ValueError: it is broken; " in logs
    assert "`Lost` is not connected to anything at this time" in logs
    assert "Traceback" in missions("logs", "hand").stdout


@dca.message
@dataclass
class Width:
    length: dca.Length


def test_exports_and_calls_are_in_the_interface():
    @dca.service("Fingers.")
    class Hand:
        Home = dca.Calls(None, Width, optional=True, doc="Goes home.")

        def main_calc(self, tick):
            pass

        @dca.procedure(idle=True, access="look")
        def Measure(self) -> Width:
            """Measures."""
            return Width(1.0)

        @dca.procedure
        def Open(self, width: Width) -> None:
            pass

        @dca.state
        def opening(self) -> Width:
            return Width(1.0)

    text = dca._dca.interface([dca._controller.declaration(Hand)])
    assert (
        "  /// Measures.\n  proc Measure() -> Width idle;\n  proc Open(Width);\n  state opening: Width;\n"
        "  /// Goes home.\n  calls Home() -> Width optional;\n"
    ) in text


def test_wrong_exports_are_named():
    def refused(function, text, decorate=dca.procedure):
        with pytest.raises(TypeError, match=text):
            decorate(function)

    def untyped(self, width):
        pass

    def two(self, width: Width, other: Width) -> None:
        pass

    def nothing(self) -> None:
        pass

    def number(self, width: int) -> None:
        pass

    refused(untyped, "the type of `width` is missing")
    refused(two, "takes one message")
    refused(nothing, "is a state, so it returns a message", dca.state)
    refused(number, "`int` is not a message")
    with pytest.raises(TypeError, match="`all` is not a right"):
        dca.procedure(access="all")(nothing)
