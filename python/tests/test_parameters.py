"""Parameters that change while a controller runs, with real processes."""

import time

PROGRAM = """
import dca

@dca.task("Waits for another parameter.", every="20 ms")
class Turn:
    gain = dca.parameter(float, (0, 10), default=1)

    def configure(self):
        print("configured")

    def main_calc(self, tick):
        if self.gain == 7.5:
            return dca.done()

if __name__ == "__main__":
    dca.run(Turn)
"""

SPEC = """
module Turn { python "turn.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ one instof Turn(c1); }
    internal_event_actions{ one within 40 s }
}
"""


def test_a_parameter_changes_while_it_runs(missions):
    missions.write("turn.py", PROGRAM)
    missions.write("turn.dca", SPEC)
    running = missions.begin("run", "turn.dca")
    try:
        until = time.monotonic() + 30
        while True:
            told = missions("param", "set", "one", "gain", "7.5")
            if told.returncode == 0 or time.monotonic() > until or running.poll() is not None:
                break
        assert told.returncode == 0, told.stdout + told.stderr
        out, _ = running.communicate(timeout=60)
        assert running.returncode == 0, out
    finally:
        if running.poll() is None:
            running.terminate()
            running.communicate(timeout=30)


WHOLE = """
import dca

@dca.task("Waits for another gain.", every="20 ms")
class Count:
    gain = dca.parameter(float, (-1e9, 1e9), default=1)
    whole = dca.parameter(int, (0, 10), default=3)

    def main_calc(self, tick):
        if self.gain == 5.0:
            return dca.done() if repr(self.whole) == "7" else dca.abort(f"whole is {self.whole!r}")

if __name__ == "__main__":
    dca.run(Count)
"""

WHOLE_SPEC = """
module Count { python "count.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ count instof Count(c1); }
    internal_event_actions{ count within 50 s }
}
"""


def test_a_fraction_for_a_whole_number_leaves_the_other_parameters(missions):
    missions.write("count.py", WHOLE)
    missions.write("count.dca", WHOLE_SPEC)
    running = missions.begin("run", "count.dca")
    try:
        until = time.monotonic() + 30
        while missions("param", "set", "count", "whole", "7").returncode != 0:
            assert time.monotonic() < until and running.poll() is None
        assert missions("param", "set", "count", "whole", "4.5").returncode == 0
        wrong = "parameter `whole` is `4.5`, which is not a whole number from 0 to 10"
        while wrong not in missions("logs", "count").stdout:
            assert time.monotonic() < until and running.poll() is None
        assert missions("param", "set", "count", "gain", "5").returncode == 0
        out, _ = running.communicate(timeout=60)
        assert running.returncode == 0, out
    finally:
        if running.poll() is None:
            running.terminate()
            running.communicate(timeout=30)
