"""Parameters that change while a controller runs, by real processes."""

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
