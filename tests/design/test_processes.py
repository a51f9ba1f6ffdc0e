"""Pools of processes that are stopped: nothing is said, nothing is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.commands import environment
from helpers.staging import stay

from ppmcal.design.processes import over

pytestmark = pytest.mark.skipif(not hasattr(os, "killpg"), reason="signals of POSIX")
CODE = """
import os, signal, sys
from helpers.staging import stay
from ppmcal.cli.streams import Stopped, interruptible
from ppmcal.design.processes import over

with interruptible():
    try:
        for answer in over(stay, sys.argv[1], range(200), 2):
            if answer == 8:
                {send}(os.getpid(), signal.{name})
    except Stopped:
        sys.exit(7)
"""


@pytest.mark.slow
def test_answers_come_in_order(tmp_path: Path) -> None:
    assert list(over(stay, str(tmp_path), range(9), 2)) == list(range(9))


@pytest.mark.parametrize("send", ["os.kill", "os.killpg"])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
@pytest.mark.slow
def test_a_pool_is_stopped(tmp_path: Path, name: str, send: str) -> None:
    """A closed terminal ends all its processes, also Python's own that counts semaphores."""
    run = subprocess.run(
        [sys.executable, "-c", CODE.format(send=send, name=name), str(tmp_path)], text=True,
        capture_output=True, start_new_session=True, timeout=120,
        env=environment())
    assert (run.returncode, run.stderr) == (7, "")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_what_the_first_process_ignores_ends_none(tmp_path: Path) -> None:
    """`nohup ppmcal batch ...` goes on in all of its processes when the terminal is closed."""
    code = CODE.format(send="os.killpg", name="SIGHUP")
    run = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path)], text=True, capture_output=True, timeout=120,
        start_new_session=True, env=environment(),
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    assert (run.returncode, run.stderr) == (0, "")


def test_a_second_signal_lets_a_process_clean_up(tmp_path: Path) -> None:
    """The pool ends its processes when a terminal has told them already."""
    code = ("import os, signal, sys\nfrom helpers.staging import stay\n"
            "from ppmcal.design import processes\nfrom ppmcal.store import stage\n"
            "release = stage.Staging.release\n"
            "def slow(self):\n"
            "    os.kill(os.getpid(), signal.SIGTERM)\n"
            "    release(self)\n"
            "stage.Staging.release = slow\n"
            "processes._remember(stay, sys.argv[1])\n"
            "signal.setitimer(signal.ITIMER_REAL, 0.01)\n"
            "signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGHUP))\n"
            "processes._do([1])\n")
    run = subprocess.run([sys.executable, "-c", code, str(tmp_path)], text=True,
                         capture_output=True, timeout=120,
                         env=environment())
    assert (run.returncode, run.stderr) == (128 + signal.SIGHUP, "")
    assert not list(tmp_path.iterdir())
