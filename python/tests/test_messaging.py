"""Queues, locks, routers, requests and ports of keys, with real processes."""

from dataclasses import dataclass

import dca
import pytest

TYPES = """
from dataclasses import dataclass
import dca

@dca.message
@dataclass
class Pace:
    speed: dca.Speed

@dca.message
@dataclass
class Doubled:
    speed: dca.Speed
    of: int
"""

SERVER = """
import dca
from types_ import Doubled, Pace

@dca.service("A base.", every="5 ms")
class Base:
    wheels = dca.Lock(lease="1 s", status="lock")
    Commands = dca.Queue(Pace, capacity=4, full="drop oldest", lock="wheels", status="commands")
    Orders = dca.Queue(Pace, capacity=2)
    Questions = dca.Queue(Pace)
    Answers = dca.Sender(Doubled)
    News = dca.Router(Pace, status="readers")

    def __init__(self):
        self.speeds, self.told = [], 0

    def main_calc(self, tick):
        for taken in self.Commands:
            self.speeds.append((taken.data.speed, taken.fence))
        for taken in self.Questions:
            self.Answers.send(Doubled(2 * taken.data.speed, len(self.speeds)), to=taken.sender, marker=taken.marker, within="2 s")
        if self.News.subscribers and self.told < 4:
            self.told += 1
            self.News.send(Pace(float(self.told)), category="odd" if self.told % 2 else "even")

    @dca.procedure
    def Ready(self) -> None:
        pass

    @dca.procedure
    def Drain(self) -> None:
        self.drained = [(taken.data.speed, taken.priority) for taken in self.Orders]
        print("orders", self.drained)

if __name__ == "__main__":
    dca.run(Base)
"""

CLIENT = """
import dca
from types_ import Doubled, Pace

@dca.task("Drives.", every="10 ms")
class Pilot:
    wheels = dca.LockUser()
    Commands = dca.Sender(Pace)
    Orders = dca.Sender(Pace)
    Questions = dca.Sender(Pace)
    Answers = dca.Queue(Doubled)
    News = dca.Subscriber(Pace, filters=[dca.Filter(category="od*")])
    Ready = dca.Calls()
    Drain = dca.Calls()

    def init(self, value):
        self.ready, self.requests = self.Ready.call(within="2 s"), None

    def begin(self):
        self.requests = dca.Requester(self.Questions, self.Answers)
        # Without the lock.
        self.early = self.Commands.send(Pace(9.0), within="2 s")
        self.orders = [self.Orders.send(Pace(float(n)), priority=n, within="2 s") for n in (1, 2, 3)]
        self.wheels.want()
        self.asked, self.command, self.heard, self.drain = None, None, [], None

    def main_calc(self, tick):
        if self.requests is None:
            if not self.ready.done:
                return None
            try:
                self.ready.result()
            except dca.CallError:
                # The base is started at the same time, and may not run yet.
                self.ready = self.Ready.call(within="2 s")
                return None
            self.begin()
        self.requests.work(tick.now)
        self.heard += [taken.data.speed for taken in self.News]
        if self.wheels.held is not None and self.command is None:
            self.command = self.Commands.send(Pace(0.5), fence=self.wheels.held, within="2 s")
        if self.command is not None and self.command.done and self.asked is None:
            self.asked = self.requests.ask(tick.now, Pace(21.0), within="2 s")
        if self.drain is None and all(one.done for one in self.orders):
            self.drain = self.Drain.call(within="2 s")
        if not (self.asked and self.asked.done and self.drain and self.drain.done and len(self.heard) >= 2):
            return None
        ends = []
        for one in [self.early, self.command, *self.orders]:
            try:
                ends.append(one.result() or "accepted")
            except dca.SendError as error:
                ends.append(str(error))
        print("ends", ends)
        print("answer", self.asked.result())
        print("heard", self.heard, self.News.state)
        self.wheels.let_go()
        return dca.done()

if __name__ == "__main__":
    dca.run(Pilot)
"""

SPEC = """
module Base { python "base.py"; venv ".venv"; }
module Pilot { python "pilot.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ base instof Base(c1); pilot instof Pilot(c1); }
    internal_connections(base, all){
        pilot, wheels -> base, wheels;
        pilot, Commands -> base, Commands;
        pilot, Orders -> base, Orders;
        pilot, Questions -> base, Questions;
        base, Answers -> pilot, Answers;
        pilot, News -> base, News;
        pilot, Ready -> base, Ready;
        pilot, Drain -> base, Drain;
    }
    internal_event_actions{ base[all], pilot within 20 s }
}
"""


def test_queues_locks_routers_and_requests(missions):
    missions.write("types_.py", TYPES)
    missions.write("base.py", SERVER)
    missions.write("pilot.py", CLIENT)
    missions.write("post.dca", SPEC)
    ended = missions.run("post.dca")
    logs = missions("logs", "pilot").stdout
    assert ended.returncode == 0, ended.stdout + ended.stderr + logs + missions("logs", "base").stdout
    assert "ends ['the queue has rejected the message: " in logs, logs
    assert "', 'accepted', 'accepted', 'accepted', 'the queue has rejected the message: 2 messages are already waiting']" in logs, logs
    assert "answer Doubled(speed=42.0, of=1)" in logs, logs
    assert "heard [1.0, 3.0] yes" in logs, logs
    assert "orders [(2.0, 2), (1.0, 1)]" in missions("logs", "base").stdout


KEYS = """
import dca

@dca.task("Claims a cup.", every="20 ms", triggered_by="Claims")
class Claim:
    Claims = dca.KeyNews()
    Claim = dca.KeyWriter()
    Done = dca.KeyAnswers()

    def init(self, value):
        self.first = self.Claim.put("team/claim/cup", "r1", within="5 s", expected=dca.ABSENT)
        self.other = self.Claim.put("team/other", 1, within="5 s")
        self.answers, self.events = {}, []

    def main_calc(self, tick):
        self.events += [(event.kind, [(entry.key, entry.value) for entry in event.entries]) for event in self.Claims]
        self.answers |= dict(self.Done)
        if len(self.answers) == 2 and any(entries for _, entries in self.events):
            print("first", self.answers[self.first], "other", self.answers[self.other])
            print("events", self.events)
            return dca.done()

if __name__ == "__main__":
    dca.run(Claim)
"""


def test_ports_of_keys(missions):
    missions.write("claim.py", KEYS)
    missions.write(
        "claim.dca",
        """
module Claim { python "claim.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ one instof Claim(c1); }
    internal_connections{
        db("team/claim/**") -> one, Claims;
        one, Claim -> db("team/claim/**");
        db("team/claim/**") -> one, Done;
    }
    internal_event_actions{ one within 20 s }
}
""",
    )
    ended = missions.run("claim.dca")
    logs = missions("logs", "one").stdout
    assert ended.returncode == 0, ended.stdout + ended.stderr + logs
    assert "first None other `team/other` is not among the keys" in logs or "first None other" in logs, logs
    assert "[('team/claim/cup', 'r1')]" in logs, logs


@dca.message
@dataclass
class Pace:
    speed: dca.Speed


def test_their_interface_is_that_of_the_kit():
    @dca.service("A base.")
    class Base:
        wheels = dca.Lock(status="lock")
        Commands = dca.Queue(Pace, lock="wheels", status="commands", doc="How fast.")
        News = dca.Router(Pace)
        Orders = dca.Sender(Pace, optional=True)
        arm = dca.LockUser()
        Ready = dca.Subscriber(Pace)
        Claims = dca.KeyNews(optional=True)

        def main_calc(self, tick):
            pass

    text = dca._dca.interface([dca._controller.declaration(Base)])
    for line in (
        "in Claims: KeyNews optional;",
        "proc wheels(LockRequest) -> LockAnswer;",
        "state lock: LockStatus;",
        "/// How fast.\n  proc Commands(QueueMessage) -> Receipt;",
        "state commands: QueueStatus;",
        "proc News(Subscription) -> Delivery;",
        "calls Orders(QueueMessage) -> Receipt optional;",
        "calls arm(LockRequest) -> LockAnswer;",
        "calls Ready(Subscription) -> Delivery;",
    ):
        assert line in text, text


def test_wrong_declarations_are_named():
    with pytest.raises(TypeError, match="`block` is not what a full queue does"):
        dca.Queue(Pace, full="block")
    with pytest.raises(TypeError, match="there are two `lock`"):

        @dca.service("A base.")
        class Base:
            wheels = dca.Lock(status="lock")
            arm = dca.Lock(status="lock")

            def main_calc(self, tick):
                pass
