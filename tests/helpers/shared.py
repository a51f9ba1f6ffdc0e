"""What several tests look at and none changes: made once in a run, whichever worker asks first."""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from helpers.desk import examples_of, lay_desk, run

try:
    import fcntl
except ImportError:    # not on Windows: each worker makes its own
    fcntl = None    # type: ignore[assignment]


def made_once(factory: pytest.TempPathFactory, name: str, make: Callable[[Path], object]) -> Path:
    """Return the folder of that name, which ``make`` has filled; others wait while it does."""
    base = factory.getbasetemp()
    top = base.parent if fcntl and os.environ.get("PYTEST_XDIST_WORKER") else base
    folder, done = top / f"shared-{name}", top / f"shared-{name}.done"
    with (top / f"shared-{name}.lock").open("w") as lock:
        if fcntl:
            fcntl.flock(lock, fcntl.LOCK_EX)
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)    # of a worker that failed
            folder.mkdir()
            make(folder)
            done.touch()
    return folder


def shared_desk(factory: pytest.TempPathFactory) -> Path:
    """Return a folder with everything that the examples of the pages and of the help name."""
    return made_once(factory, "desk", lay_desk)


def shared_demo(factory: pytest.TempPathFactory) -> Path:
    """Return the folder in which the example of the demo's help was run; said.txt: what it said."""
    def make(folder: Path) -> None:
        with contextlib.chdir(folder):
            said = run(examples_of("demo")[0])
        (folder / "said.txt").write_text(said, encoding="utf-8")

    return made_once(factory, "demo", make)
