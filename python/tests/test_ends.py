"""Events outside of a Python program that end it, or prevent its start: the mission shows each cause, and no process is left."""

import os
import signal
import sys
import time
import venv
from pathlib import Path

import pytest

WAITS = """
import os
from pathlib import Path
import dca

@dca.task("Waits.", every="20 ms")
class Bad:
    def main_calc(self, tick):
        Path("pid").write_text(str(os.getpid()))
        {act}

if __name__ == "__main__":
    {before}
    dca.run(Bad)
"""

# The module block has the interface, so the program is not asked for it before PREPARE.
SPEC = """
module Bad(host: Host) {{ python "bad.py"; venv "{venv}"; done; stop within 500 ms; }}
process main(){{
    host{{c1}}
    instantiated_processes{{ bad instof Bad(c1){policy}; }}
    internal_event_actions{{ bad within 30 s }}
}}
"""


def write(missions, act="pass", before="pass", policy="", environment=".venv"):
    missions.write("bad.py", WAITS.format(act=act, before=before))
    missions.write("bad.dca", SPEC.format(policy=policy, venv=environment))


def pid_of(missions, running):
    until = time.monotonic() + 30
    while time.monotonic() < until and running.poll() is None:
        text = (missions.folder / "pid").read_text() if (missions.folder / "pid").exists() else ""
        if text:
            return int(text)
    pytest.fail(f"it did not start: {running.communicate(timeout=30)}")


def is_there(pid):
    """Whether the process is running. A process that has ended may still wait for its parent."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


@pytest.mark.parametrize(
    ("number", "policy", "expected"),
    [
        (signal.SIGKILL, "", "SIGKILL"),
        (signal.SIGSTOP, " { watchdog 500 ms; }", "its loop has not come round"),
        (signal.SIGTERM, "", ""),
    ],
)
def test_a_program_that_is_signalled(missions, number, policy, expected):
    write(missions, policy=policy)
    with missions.begin("run", "bad.dca") as running:
        pid = pid_of(missions, running)
        os.kill(pid, number)
        out, _ = running.communicate(timeout=40)
    assert running.returncode == 1 and expected in out, out
    assert not is_there(pid)


def test_a_program_that_takes_too_much_memory(missions):
    write(missions, act="self.hoard = bytearray(1 << 30)", policy=" { memory 300 MB; }")
    ended = missions.run("bad.dca")
    out = ended.stdout + ended.stderr
    if "control group" in out:
        pytest.skip("this machine has no control groups to limit memory with")
    assert ended.returncode == 1 and ("memory" in out or "MemoryError" in out), out


def test_a_package_of_another_version_is_refused_at_prepare(missions):
    write(missions, before="dca._controller._dca.__version__ = '0.0.1'")
    ended = missions.run("bad.dca")
    out = ended.stdout + ended.stderr
    assert ended.returncode == 1, out
    assert "`dca` 0.0.1 from `" in out and "does not run under DCA" in out and sys.executable.split("/")[-1][:6] in out, out


def test_an_environment_without_the_package_is_refused_at_prepare(missions):
    # The previous process has been replaced.
    venv.create(missions.folder / "other", with_pip=False, symlinks=True)
    write(missions, environment="other")
    ended = missions.run("bad.dca")
    out = ended.stdout + ended.stderr
    assert ended.returncode == 1 and "No module named 'dca'" in out, out


def test_an_environment_that_is_gone_is_refused_at_prepare(missions):
    write(missions, environment="gone")
    ended = missions.run("bad.dca")
    assert ended.returncode == 1 and "no program is at `gone/bin/python`" in ended.stdout + ended.stderr


def test_an_exception_while_it_begins(missions):
    write(missions, before="raise SystemExit('not today')")
    ended = missions.run("bad.dca")
    assert ended.returncode == 1 and "not today" in ended.stdout + ended.stderr, ended.stdout + ended.stderr


def test_a_failing_program_is_a_diagnostic_at_each_instance(missions):
    missions.write("bad.py", "import nothing_of_this_name\n")
    missions.write(
        "bad.dca",
        """
module Bad { python "bad.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ one instof Bad(c1); two instof Bad(c1); }
    internal_event_actions{ one within 1 s }
}
""",
    )
    checked = missions("check", "--format", "json", "bad.dca")
    assert checked.returncode == 1
    import json

    found = [one for one in json.loads(checked.stdout)["diagnostics"] if one["code"] == "E0011"]
    assert len(found) == 2 and all(one["place"]["start"]["line"] == 5 for one in found), checked.stdout
    assert found[0]["help"][-1] == "ModuleNotFoundError: No module named 'nothing_of_this_name'"


def test_doctor_names_the_interpreter_and_its_package(missions):
    told = missions("doctor", "--json")
    import json

    [python] = [one for one in json.loads(told.stdout) if one["name"] == "python"]
    assert python["finding"].startswith("`.venv/bin/python` is Python 3.") and "with `dca` " in python["finding"], python


def test_a_thread_that_began_on_import_does_not_keep_the_interface(missions):
    missions.write(
        "bad.py",
        WAITS.format(act="return dca.done()", before="pass").replace(
            "import dca\n", "import dca, threading, time\nthreading.Thread(target=lambda: time.sleep(3600)).start()\n", 1
        ),
    )
    spec = SPEC.format(policy="", venv=".venv").replace("(host: Host)", "").replace(" done; stop within 500 ms;", "")
    missions.write("bad.dca", spec)
    checked = missions("check", "bad.dca")
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_a_child_of_fork_that_comes_back_is_ended(missions):
    act = "self.count = getattr(self, 'count', 0) + 1; self.child = os.fork() if self.count == 2 else None"
    act += "\n        if self.child == 0: raise ValueError('in the child')"
    act += "\n        if self.child: assert os.waitstatus_to_exitcode(os.waitpid(self.child, 0)[1]) == 1"
    act += "\n        if self.count == 5: return dca.done()"
    write(missions, act=act)
    ended = missions.run("bad.dca")
    logs = missions("logs", "bad")
    assert ended.returncode == 0, ended.stdout + ended.stderr + logs.stdout
    assert "a child of os.fork() has come back to the control loop" in logs.stdout


def test_a_long_end_reaches_the_mission(missions):
    write(missions, act="return dca.done(bytes(17 << 20))")
    ended = missions.run("bad.dca")
    assert ended.returncode == 1 and "it leaves a value of 17825792 bytes" in ended.stdout + ended.stderr


def test_an_exception_of_init_is_its_reason(missions):
    missions.write("bad.py", WAITS.format(act="pass", before="pass").replace("    def main", "    def __init__(self): raise KeyError('boo')\n\n    def main"))
    missions.write("bad.dca", SPEC.format(policy="", venv=".venv"))
    ended = missions.run("bad.dca")
    out = ended.stdout + ended.stderr
    assert ended.returncode == 1 and "`Bad`: KeyError: 'boo'" in out and "usage" not in out, out


STOPS = """
import time
from pathlib import Path
import dca

@dca.{kind}("Stops badly.", every="20 ms", stop_within="500 ms")
class Bad:
    def main_calc(self, tick):
        {act}

    def stop(self, tick):
        {stop}

@dca.task("Is done after a while.", every="20 ms")
class Other:
    count = 0
    def main_calc(self, tick):
        Path("other").touch()
        self.count += 1
        return dca.done() if self.count > 5 else None

if __name__ == "__main__":
    dca.run(Bad, Other)
"""

STOPS_SPEC = """
module Bad {{ python "bad.py"; venv ".venv"; }}
module Other {{ python "bad.py"; venv ".venv"; }}
process main(){{
    host{{c1}}
    instantiated_processes{{ bad instof Bad(c1); other instof Other(c1); }}
    internal_event_actions{{ {events} }}
}}
"""


@pytest.mark.parametrize(
    ("stop", "reason"),
    [
        ("raise ValueError('the hand still presses')", "its stop failed: ValueError: the hand still presses"),
        ("return False", "its stop did not finish within 0.5 s, so the program was ended"),
        ("time.sleep(3600)", "its stop did not finish within 0.5 s, so the program was ended"),
    ],
)
@pytest.mark.parametrize("is_asked", [False, True])
def test_a_stop_that_goes_wrong_is_an_abort(missions, stop, reason, is_asked):
    kind, act, events = ("service", "pass", "other # bad") if is_asked else ("task", "return dca.done()", "bad ; other")
    missions.write("bad.py", STOPS.format(kind=kind, act=act, stop=stop))
    missions.write("bad.dca", STOPS_SPEC.format(events=events))
    ended = missions.run("bad.dca")
    out = ended.stdout + ended.stderr
    # A process that is stopped may fail, and the group is still done. Its failure is in the summary.
    assert ended.returncode == (0 if is_asked else 1) and reason in out, out
    assert (missions.folder / "other").exists() == is_asked, out


def test_lost_values_are_counted_without_signals(missions):
    missions.write(
        "bad.py",
        """
import time
from dataclasses import dataclass
import dca

@dca.message
@dataclass
class Beat:
    number: int

@dca.task("Sends many values.", every="2 ms")
class Many:
    Out = dca.Out(Beat)
    count = 0
    def main_calc(self, tick):
        self.count += 1
        self.Out.send(Beat(self.count))
        return dca.done() if self.count == 500 else None

@dca.service("Is slow.", every="20 ms")
class Slow:
    In = dca.Every(Beat)
    def main_calc(self, tick):
        time.sleep(0.4)

if __name__ == "__main__":
    dca.run(Many, Slow)
""",
    )
    missions.write(
        "bad.dca",
        """
module Many { python "bad.py"; venv ".venv"; }
module Slow { python "bad.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ many instof Many(c1); slow instof Slow(c1); }
    internal_connections(many, beats){ many, Out -> slow, In; }
    internal_event_actions{ many[beats] # slow }
}
""",
    )
    ended = missions.run("bad.dca")
    out = ended.stdout + ended.stderr
    assert ended.returncode == 0 and "values lost" in out, out
