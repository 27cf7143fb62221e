"""The database, with real processes."""

PROGRAM = """
import dca

@dca.task("Uses the database.", every="20 ms", triggered_by="database")
class Keys:
    database = dca.Database()

    def init(self, value):
        table = {"by": "me", "force": 4.5, "count": 3, "loud": True, "raw": b"\\x00", "way": [1.0, 2.0]}
        self.requests = [
            self.database.put("team/test/a", table, within="5 s"),
            self.database.transact("a free hand", {"team/test/b": 1, "team/test/c": "x"}, within=5,
                                   requires={"team/test/b": dca.ABSENT}),
        ]
        self.watch = self.database.watch("team/test/")
        self.seen = []
        self.step, self.last = 0, None

    def main_calc(self, tick):
        self.seen += [(event.kind, sorted(entry.key for entry in event.entries)) for event in self.watch]
        if not all(request.done for request in self.requests):
            return None
        results = [request.result() for request in self.requests]
        self.step += 1
        if self.step == 1:
            self.requests = [
                self.database.get("team/test/a", within="5 s"),
                self.database.get("team/test/none", within="5 s"),
                self.database.put("team/test/b", 2, within="5 s", expected=results[1]),
            ]
        elif self.step == 2:
            entry, none, version = results
            assert none is None and not entry.is_conflict
            assert entry.value == {"by": "me", "force": 4.5, "count": 3, "loud": True, "raw": b"\\x00", "way": [1.0, 2.0]}
            self.requests = []
            self.refused = self.database.put("team/test/b", 3, within="5 s", expected=dca.ABSENT)
        elif self.last is None and ("complete", []) in self.seen:
            # The present values are known, so this one comes as a change.
            self.last = self.database.put("team/test/d", 4, within="5 s")
        elif self.refused.done and ("changed", ["team/test/d"]) in self.seen:
            try:
                self.refused.result()
            except dca.DatabaseFailure as error:
                print("refused:", type(error).__name__, error)
            print(self.seen)
            return dca.done()

if __name__ == "__main__":
    dca.run(Keys)
"""

SPEC = """
module {0} {{ python "keys.py"; venv ".venv"; }}
process main(){{
    host{{c1}}
    instantiated_processes{{ one instof {0}(c1); }}
    internal_event_actions{{ one within 40 s }}
}}
"""


def test_a_controller_uses_the_database(missions):
    missions.write("keys.py", PROGRAM)
    missions.write("keys.dca", SPEC.format("Keys"))
    ended = missions.run("keys.dca")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    logs = missions("logs", "one").stdout
    assert "refused: DatabaseFailure" in logs, logs
    assert "[('begin', []), " in logs and "('changed', ['team/test/d'])" in logs, logs
