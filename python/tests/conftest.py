"""Finds the programs of DCA, and runs missions of Python controllers in real processes."""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def target() -> Path:
    """Returns the folder in which cargo builds."""
    return Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))


def program() -> Path | None:
    """Returns the path of `dca`: `$DCA`, or the program that `cargo build` has built."""
    if "DCA" in os.environ:
        return Path(os.environ["DCA"])
    found = target() / "debug" / "dca"
    return found if found.exists() else None


class Missions:
    """Runs missions in a separate folder for each test, with the interpreter that runs the tests."""

    def __init__(self, dca: Path, folder: Path) -> None:
        self.dca, self.folder = dca, folder
        # The path of this folder is short enough for a socket.
        self.run_dir = Path(tempfile.mkdtemp(prefix="dca"))
        # `venv` of a module names a virtual environment, possibly through a link.
        (folder / ".venv").symlink_to(sys.prefix)

    def __call__(self, *words: str, within: float = 60.0) -> subprocess.CompletedProcess[str]:
        with self.begin(*words, stderr=subprocess.PIPE) as begun:
            try:
                out, err = begun.communicate(timeout=within)
            except subprocess.TimeoutExpired:
                begun.kill()
                raise
        return subprocess.CompletedProcess(begun.args, begun.returncode, out, err)

    def begin(self, *words: str, stderr: int = subprocess.STDOUT) -> subprocess.Popen[str]:
        """Starts a command, which finds only the nodes of this test."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        environment["DCA_RUN_DIR"] = str(self.run_dir)
        return subprocess.Popen(
            [str(self.dca), *words],
            cwd=self.folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=stderr,
            text=True,
        )

    def write(self, name: str, text: str) -> None:
        (self.folder / name).write_text(text)

    def run(self, *words: str, within: float = 60.0) -> subprocess.CompletedProcess[str]:
        return self("run", *words, within=within)


@pytest.fixture
def missions(tmp_path: Path) -> Iterator[Missions]:
    dca = program()
    if dca is None:
        pytest.skip("there is no `dca`: `cargo build` makes it")
    made = Missions(dca, tmp_path)
    yield made
    shutil.rmtree(made.run_dir, ignore_errors=True)
