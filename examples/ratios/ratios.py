"""Measures controllers in Python beside those in Rust, in turn on one machine, and prints the ratios.

    cargo build --release && cargo build
    python3 -m venv .venv && .venv/bin/pip install ../../python && .venv/bin/python ratios.py

`DCA` is the program `dca`, and `VENV` the environment. `DORA` is an environment with the packages `dora-rs` and `dora-rs-cli`, to measure dora
beside it. Medians of several rounds, and of starts the time of the processor; other load changes the times, and the ratios much less.

The limits hold for both programs on one core. Free on all cores, a hop may also wake an idle core.
This time does not depend on the language: it is also 14 µs on a virtual machine with plain sockets.
It appears and disappears with the choices of the kernel. These figures are printed without a limit.
"""

import os
import re
import resource
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", HERE.parents[1] / "target")) / os.environ.get("PROFILE", "debug")
DCA = Path(os.environ.get("DCA", TARGET / "dca"))
ROUNDS = int(os.environ.get("ROUNDS", "3"))

PAIR = """
module Ping {{ {ping} }}
module Pong {{ {pong} }}
process main(){{
    host{{c1}}
    instantiated_processes{{ ping instof {kind}Ping(c1, size = {size}, rounds = {rounds}); pong instof {kind}Pong(c1); }}
    internal_connections(pong, all){{ ping, Out -> pong, In; pong, Out -> ping, In; }}
    internal_event_actions{{ pong[all], ping within 120 s }}
}}
"""

STEADY = """
module Steady { python "ping.py"; venv ".venv"; }
module Reads { python "ping.py"; venv ".venv"; }
process main(){
    host{c1}
    instantiated_processes{ steady instof Steady(c1); reads instof Reads(c1); }
    internal_connections(reads, all){ steady, Out -> reads, In; }
    internal_event_actions{ reads[all], steady within 60 s }
}
"""

DORA = """
nodes:
  - id: ping
    path: dora_ping.py
    args: {size} {rounds} {result}
    inputs: {{tick: dora/timer/millis/200, back: pong/out}}
    outputs: [out]
  - id: pong
    path: dora_pong.py
    inputs: {{in: ping/out}}
    outputs: [out]
"""


def run(folder: Path, spec: str, process: str, word: str, *options: str) -> float:
    """Runs a mission; returns the number behind a word in the log of a process."""
    (folder / "ratios.dca").write_text(spec)

    def dca(*words: str) -> str:
        ended = subprocess.run([DCA, *words], cwd=folder, capture_output=True, text=True, timeout=300, check=False)
        return ended.stdout + ended.stderr

    mission, logs = dca("run", "ratios.dca", *options), dca("logs", process)
    found = re.findall(rf"\b{word} ([0-9.]+)", logs)
    if not found:
        sys.exit(f"`{process}` does not print `{word}`:\n{mission}{logs}")
    return float(found[-1])


def hop(folder: Path, language: str, size: int, rounds: int) -> float:
    if language == "Rust":
        spec = PAIR.replace("module Ping {{ {ping} }}\nmodule Pong {{ {pong} }}\n", "")
        spec = spec.format(kind="Rust", size=size, rounds=rounds)
        return run(folder, spec, "ping", "hop", "--controllers", str(TARGET / "dca-examples"))
    program = 'python "ping.py"; venv ".venv";'
    return run(folder, PAIR.format(ping=program, pong=program, kind="", size=size, rounds=rounds), "ping", "hop")


def dora(folder: Path, venv: Path, size: int, rounds: int) -> float:
    """Returns the hop of dora, between two nodes in Python."""
    result = folder / "hop"
    for name in ("ping", "pong"):
        (folder / f"dora_{name}.py").write_text((HERE / "dora" / f"{name}.py").read_text())
    (folder / "flow.yml").write_text(DORA.format(size=size, rounds=rounds, result=result))
    environment = os.environ | {"PATH": f"{venv}/bin:{os.environ['PATH']}"}
    command = [venv / "bin" / "dora", "run", "flow.yml"]
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120, check=False)
    if ended.returncode != 0:
        sys.exit(f"dora has failed:\n{ended.stdout}{ended.stderr}")
    return float(result.read_text())


def start(*command: str) -> float:
    """Returns the time of the processor that a command takes, in milliseconds: other load is not included."""
    began = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, cwd=HERE, stdout=subprocess.DEVNULL, check=True)
    ended = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (ended.ru_utime - began.ru_utime + ended.ru_stime - began.ru_stime) * 1e3


def ratio(folder: Path, size: int, rounds: int, cores: set[int]) -> tuple[float, float]:
    """Returns the medians of a hop in Rust and in Python, measured in turn, with all programs on some cores."""
    times: dict[str, list[float]] = {"Rust": [], "Python": []}
    own = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        for _ in range(ROUNDS):
            for language, found in times.items():
                found.append(hop(folder, language, size, rounds))
    finally:
        os.sched_setaffinity(0, own)
    return statistics.median(times["Rust"]), statistics.median(times["Python"])


def main() -> None:
    venv = Path(os.environ.get("VENV", sys.prefix))
    cores = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / ".venv").symlink_to(venv)
        (folder / "ping.py").write_text((HERE / "ping.py").read_text())
        for size, rounds, most in ((64, 4000, 3.0), (1 << 20, 800, 1.3)):
            rust, python = ratio(folder, size, rounds, {min(cores)})
            print(f"hop of {size} B, one core: Rust {rust:.1f} µs, Python {python:.1f} µs: {python / rust:.2f} (at most {most})")
            rust, python = ratio(folder, size, rounds, cores)
            print(f"hop of {size} B, all cores: Rust {rust:.1f} µs, Python {python:.1f} µs: {python / rust:.2f}")
            if "DORA" in os.environ:
                # A separate folder, because dora would use the environment of the other folder.
                with tempfile.TemporaryDirectory() as own:
                    venv_of = Path(os.environ["DORA"])
                    other = statistics.median(dora(Path(own), venv_of, size, rounds) for _ in range(ROUNDS))
                print(f"hop of {size} B, all cores: dora {other:.1f} µs, {other / python:.1f} times that of Python here")
        core = statistics.median(run(folder, STEADY, "steady", "core") for _ in range(ROUNDS))
        print(f"a controller at 100 Hz: {core:.2f} % of a core (at most 2)")
        python = str(venv / "bin" / "python")
        bare = statistics.median(start(python, "-c", "pass") for _ in range(15))
        program = statistics.median(start(python, "ping.py", "--list") for _ in range(15))
        print(f"start: the interpreter {bare:.0f} ms, a program {program:.0f} ms: {program - bare:.0f} ms more (at most 60)")


if __name__ == "__main__":
    main()
