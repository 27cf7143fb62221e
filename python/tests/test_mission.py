"""Missions of Python controllers in real processes: their work and their ends."""

import shutil
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "python"

PROGRAM = """
import ctypes, os, signal, sys, time
import dca

@dca.{kind}("Ends badly.", every="20 ms")
class Bad:
    count = 0

    def main_calc(self, tick):
        self.count += 1
        if self.count > 5:
            {act}

if __name__ == "__main__":
    dca.run(Bad)
"""

SPEC = """
module Bad {{ python "bad.py"; venv ".venv"; }}
process main(){{
    host{{c1}}
    instantiated_processes{{ bad instof Bad(c1){policy}; }}
    internal_event_actions{{ bad within 30 s }}
}}
"""


def mission(missions, act, policy="", kind="task"):
    missions.write("bad.py", PROGRAM.format(act=act, kind=kind))
    missions.write("bad.dca", SPEC.format(policy=policy))
    return missions.run("bad.dca")


def test_three_controllers_keep_a_distance(missions):
    for name in ("keep.py", "room.py", "wall.dca"):
        shutil.copy(EXAMPLES / name, missions.folder / name)
    checked = missions("check", "wall.dca")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    ended = missions.run("wall.dca")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "wall: done" in ended.stdout
    logs = missions("logs", "there")
    assert "INFO root: the wall is 0.4" in logs.stdout, logs.stdout + logs.stderr


@pytest.mark.parametrize(
    ("act", "policy", "expected"),
    [
        ("raise ValueError('the sensor is upside down')", "", "ValueError: the sensor is upside down"),
        ("sys.exit(3)", "", "SystemExit: 3"),
        ("return dca.abort('it is too dark')", "", "it is too dark"),
        ("return 7", "", "`main_calc` returned a `int`"),
        ("os._exit(3)", "", "code 3"),
        ("ctypes.string_at(0)", "", "SIGSEGV"),
        ("os.kill(os.getpid(), signal.SIGKILL)", "", "SIGKILL"),
        ("while True: pass", " { watchdog 500 ms; }", "its loop has not come round"),
        ("time.sleep(3600)", " { watchdog 500 ms; }", "its loop has not come round"),
    ],
)
def test_each_end_has_its_cause(missions, act, policy, expected):
    ended = mission(missions, act, policy)
    assert ended.returncode == 1, ended.stdout + ended.stderr
    assert expected in ended.stdout + ended.stderr


def test_a_traceback_is_in_the_log(missions):
    assert mission(missions, "raise ValueError('oh dear')").returncode == 1
    logs = missions("logs", "bad")
    assert "Traceback (most recent call last):" in logs.stdout, logs.stdout + logs.stderr
    assert "ValueError: oh dear" in logs.stdout


def test_a_program_that_closes_its_output_goes_on(missions):
    ended = mission(missions, "os.close(1); os.close(2); return dca.done()")
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_what_does_not_start_is_said_before_anything_runs(missions):
    missions.write("bad.py", "import nothing_of_this_name\n")
    missions.write("bad.dca", SPEC.format(policy=""))
    ended = missions.run("bad.dca")
    assert ended.returncode == 1
    assert "`Bad` did not print its interface" in ended.stderr
    assert "No module named 'nothing_of_this_name'" in ended.stderr


def test_threads_and_other_processes_go_on_beside_the_loop(missions):
    missions.write(
        "many.py",
        """
import asyncio, multiprocessing, os, subprocess, sys, threading, time
import dca

@dca.task("Starts all kinds of things.", every="20 ms")
class Many:
    def __init__(self):
        self.count, self.local, self.tries = 0, threading.local(), 0
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while True:
            time.sleep(0.001)
            self.count += 1

    def init(self, value):
        self.local.word = "kept"
        self.thread = threading.get_ident()

    def main_calc(self, tick):
        self.tries += 1
        if self.tries < 20:
            return None
        # The loop is one thread of Python, from the first calculation to the last.
        assert self.local.word == "kept" and self.thread == threading.get_ident()
        # The other thread has run while the loop waited.
        assert self.count > 20, self.count
        assert asyncio.run(later()) == 7
        assert subprocess.run([sys.executable, "-c", "print(1)"], capture_output=True).stdout == b"1\\n"
        child = os.fork()
        if child == 0:
            os._exit(3)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 3
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            assert pool.apply(abs, (-5,)) == 5
        return dca.done()

async def later():
    await asyncio.sleep(0.01)
    return 7

if __name__ == "__main__":
    dca.run(Many)
""",
    )
    # One calculation starts two interpreters, which takes long on a busy machine.
    missions.write("many.dca", SPEC.format(policy=" { watchdog 60 s; }").replace("bad.py", "many.py").replace("Bad", "Many"))
    ended = missions.run("many.dca")
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_a_value_goes_from_one_process_to_the_next(missions):
    missions.write(
        "pair.py",
        """
from dataclasses import dataclass
import dca

@dca.message
@dataclass
class Count:
    number: int

@dca.task("Counts.")
class First:
    def main_calc(self, tick):
        return dca.done(Count(7))

@dca.task("Goes on.")
class Second:
    def init(self, value):
        self.count = dca.decode(Count, value)

    def main_calc(self, tick):
        return dca.done() if self.count.number == 7 else dca.abort(f"got {self.count}")

if __name__ == "__main__":
    dca.run(First, Second)
""",
    )
    missions.write(
        "pair.dca",
        """
module First { python "pair.py"; venv ".venv"; }
module Second { python "pair.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ first instof First(c1); second instof Second(c1); }
    internal_event_actions{ first : second }
}
""",
    )
    ended = missions.run("pair.dca")
    assert ended.returncode == 0, ended.stdout + ended.stderr


def test_a_detector_of_images_and_a_service_over_http(missions):
    pytest.importorskip("numpy")
    for name in ("image.py", "web.py", "image.dca"):
        shutil.copy(EXAMPLES / name, missions.folder / name)
    ended = missions.run("image.dca")
    logs = missions("logs", "browser").stdout
    assert ended.returncode == 0, ended.stdout + ended.stderr + logs + missions("logs", "web").stdout
    assert "the spot is at " in logs


@pytest.mark.parametrize(("cup", "code"), [("true", 0), ("false", 1)])
def test_a_judge_that_has_learnt(missions, cup, code):
    pytest.importorskip("sklearn")
    shutil.copy(EXAMPLES / "grasp.py", missions.folder)
    missions.write("grasp.dca", (EXAMPLES / "grasp.dca").read_text().replace("cup = true", f"cup = {cup}"))
    ended = missions.run("grasp.dca")
    assert ended.returncode == code, ended.stdout + ended.stderr
    assert code == 0 or "the hand is empty" in ended.stdout + ended.stderr
