"""The short form of ``make torture``: writing commands killed, refused and crowded."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from torture.trace import AVAILABLE

ROOT = Path(__file__).resolve().parents[2]


def torture(*words: str) -> str:
    path = os.pathsep.join([str(ROOT / "benchmarks"), str(ROOT)])
    done = subprocess.run([sys.executable, "-m", "torture", *words], capture_output=True,
                          text=True, check=False, env={**os.environ, "PYTHONPATH": path})
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.skipif(not AVAILABLE, reason="needs ptrace of x86-64")
@pytest.mark.parametrize("kind", ["kills", "disks", "crowds"])
def test_commands_survive(kind: str) -> None:
    said = torture("init", "simulate", "--kinds", kind, "--every", "4")
    total = re.search(r"^all +(\d+) +0$", said, re.MULTILINE)
    assert total and int(total[1]) > 30, said
    assert kind != "kills" or not re.search(r"\b(nothing|old|new|read) 0\b", said), said


@pytest.mark.slow
@pytest.mark.skipif(not AVAILABLE, reason="needs ptrace of x86-64")
@pytest.mark.parametrize("words", [
    "--kinds names", "--kinds locales", "--kinds small,signals --every 3 init import simulate"])
def test_commands_work_where_things_are_odd(words: str) -> None:
    torture(*words.split())
