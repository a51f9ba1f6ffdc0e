"""The short form of ``make torture``: writing commands killed, refused, stopped and crowded."""

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


@pytest.mark.long
@pytest.mark.skipif(not AVAILABLE, reason="needs ptrace of x86-64")
def test_commands_survive() -> None:
    said = torture("init", "simulate", "--kinds", "kills,disks,signals,crowds", "--every", "4")
    total = re.search(r"^all((?: +\d+){4}) +0$", said, re.MULTILINE)
    assert total and all(int(number) > 30 for number in total[1].split()), said
    assert not re.search(r"\b(nothing|old|new|read) 0\b", said), said


@pytest.mark.long
@pytest.mark.skipif(not AVAILABLE, reason="needs ptrace of x86-64")
@pytest.mark.parametrize("words", [
    "--kinds names", "--kinds locales", "--kinds small --every 3 init import simulate",
    "--kinds kills,disks,signals --every 9 verify identify batch"])
def test_commands_work_where_things_are_odd(words: str) -> None:
    torture(*words.split())
