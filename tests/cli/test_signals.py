"""Signals at random moments of real runs: one line, an exit code, nothing left behind."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from helpers.commands import ppmcal
from helpers.fleets import write_fleet

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="signals of POSIX")
START = ("import os, signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
         "os.write(int(os.environ['READY']), b'x'); from ppmcal.cli import main; main()")
BEFORE = 'Traceback (most recent call last):\n  File "<string>", line 1, in <module>\nKeyboard'
"""Python's own words where it was not in a file of ppmcal's yet."""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A planar machine with simulated measurements, and a fleet."""
    folder = tmp_path_factory.mktemp("bench")
    ppmcal("init", "3-RPR", "--out", "m.yaml", cwd=folder, expect=0)
    ppmcal("simulate", "m.yaml", "m.scenario.yaml", "--out", "s", cwd=folder, expect=0)
    return folder


def stopped(words: str, folder: Path, name: str, delay: float, group: bool) -> str:
    """Send a signal so long after the first line of ppmcal; return what was wrong after it."""
    number = getattr(signal, name)
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    ready, write = os.pipe()
    run = subprocess.Popen(
        [sys.executable, "-c", START, *words.split(), "--out", "out"], cwd=folder, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, pass_fds=[write], start_new_session=True,
        env={**os.environ, "READY": str(write)})
    os.close(write)
    os.read(ready, 1)
    os.close(ready)
    time.sleep(delay)
    (os.killpg if group else os.kill)(run.pid, number)
    try:
        _, err = run.communicate(timeout=60)
    except subprocess.TimeoutExpired:
        os.killpg(run.pid, signal.SIGKILL)
        run.communicate()
        return "does not end"
    return _wrong(run, err, number) or _left(run.pid, folder)


def _wrong(run: subprocess.Popen[str], err: str, number: int) -> str:
    if run.returncode not in (0, 1, 128 + number, -number):
        return f"exit {run.returncode}: {err}"
    if "resource_tracker" in err or ("Traceback" in err and not err.startswith(BEFORE)):
        return err
    if run.returncode == 128 + number and err != "Stopped.\n":
        return f"not one line: {err}"
    return ""


def _left(group: int, folder: Path) -> str:
    stages = [str(p) for p in folder.rglob(".ppmcal.*.part")]
    end = time.monotonic() + 5.0    # the tracker of semaphores ends a moment later
    while time.monotonic() < end:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return f"left behind: {stages}" if stages else ""
        time.sleep(0.05)
    return "processes are left"


RUNS = {
    "identify": ("identify m.yaml s/measurements.csv", 1.5),
    "tolerances": ("tolerances m.yaml --accuracy 0.5 --machines 2000 --cores 2", 4.0),
    "diagnose": ("diagnose m.yaml s/measurements.csv", 3.0),
    "verify": ("verify made", 1.5),
}
"""Command -> its words, and seconds within which to stop it."""


@pytest.mark.long
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_a_signal_now_and_then(bench: Path, name: str) -> None:
    drawn = random.Random(name)
    for _ in range(2):
        delay = drawn.uniform(0.0, 1.0)
        assert not stopped(RUNS["identify"][0], bench, name, delay, False), delay


@pytest.mark.long
@pytest.mark.parametrize(("name", "group"), [
    ("SIGINT", True), ("SIGTERM", False), ("SIGHUP", True)])
@pytest.mark.parametrize("command", [c for c in RUNS if c != "verify"])
def test_a_signal_at_any_moment(bench: Path, command: str, name: str, group: bool) -> None:
    words, span = RUNS[command]
    drawn = random.Random(f"{command} {name} {group}")
    found = []
    for _ in range(2):
        delay = drawn.uniform(0.0, span)
        found.append((delay, stopped(words, bench, name, delay, group)))
    assert not [f for f in found if f[1]]


@pytest.mark.long
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_batch_in_two_processes(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pyarrow")
    manifest = write_fleet(tmp_path / "fleet", machines=4)
    drawn = random.Random(f"batch {name}")
    for _ in range(2):
        delay = drawn.uniform(0.5, 5.0)
        words = f"batch {manifest.name} --cores 2"
        assert not stopped(words, manifest.parent, name, delay, True), delay


@pytest.mark.long
def test_processes_end_with_the_first_one(bench: Path) -> None:
    """Killed without a word, it leaves none behind that waits for work for ever."""
    run = subprocess.Popen(
        [sys.executable, "-c", "from ppmcal.cli import main; main()",
         *RUNS["tolerances"][0].replace("2000", "100000").split(), "--out", "k"], cwd=bench,
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    end = time.monotonic() + 60.0
    while len(_processes(run.pid)) < 4 and time.monotonic() < end:    # with the tracker
        time.sleep(0.1)
    time.sleep(1.0)
    run.kill()
    run.wait()
    end = time.monotonic() + 20.0
    while _processes(run.pid) and time.monotonic() < end:
        time.sleep(0.1)
    left = _processes(run.pid)
    for pid in left:
        os.kill(pid, signal.SIGKILL)
    assert not left


def _processes(group: int) -> list[int]:
    """Return the living processes of a group."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            rest = path.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(rest[2]) == group and rest[0] != "Z":
            found.append(int(path.parent.name))
    return found


def test_a_signal_that_a_compiled_module_makes_an_error_of_its_own_stops(tmp_path: Path) -> None:
    """A serialiser's function is called by compiled code, which wraps whatever it raises."""
    code = """
import os, signal, sys
from pydantic import BaseModel, PlainSerializer
from typing import Annotated
import ppmcal.cli
class Model(BaseModel):
    x: Annotated[int, PlainSerializer(lambda v: os.kill(os.getpid(), signal.SIGTERM) or v)] = 1
ppmcal.cli.cli = lambda standalone_mode: Model().model_dump()
ppmcal.cli.main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True,
                          cwd=tmp_path, timeout=60)
    assert (done.returncode, done.stderr.strip()) == (128 + signal.SIGTERM, "Stopped.")
