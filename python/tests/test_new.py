"""A project made by `dca new --python` passes its tests and runs at once."""

import os
import subprocess
import sys
from pathlib import Path

CLONE = Path(__file__).resolve().parents[2]


def test_a_new_folder_passes_its_tests_and_runs(missions):
    made = missions("new", f"--python={CLONE}", "robot")
    assert made.returncode == 0, made.stderr
    assert made.stdout.startswith("cd robot && python3 -m venv .venv && .venv/bin/pip install /"), made.stdout
    folder = missions.folder / "robot"
    (folder / ".venv").symlink_to(sys.prefix)
    tested = subprocess.run(
        [Path(sys.prefix) / "bin/pytest", "-q", "-p", "no:cacheprovider"],
        cwd=folder,
        env={name: value for name, value in os.environ.items() if not name.startswith("PYTEST")},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert tested.returncode == 0 and "2 passed" in tested.stdout, tested.stdout + tested.stderr
    missions.folder = folder
    ran = missions.run("robot.dca")
    assert ran.returncode == 0, ran.stdout + ran.stderr
    assert "robot: done" in ran.stdout
