"""The line of progress, at a pseudo-terminal and in a pipe; and what ``-v`` says."""

from __future__ import annotations

import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from helpers.commands import ppmcal, ppmcal_process
from helpers.terminal import CLEAR, Terminal

from ppmcal.cli.display import INNER, duration, shortened
from ppmcal.commands import command, names
from ppmcal.commands.spec import PYTHON, flags, taken

pytest.importorskip("pty")

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
WORK = """
import time
from ppmcal.cli import main
from ppmcal.wording.progress import stage
from ppmcal.commands.simulate import run as work

def slow(*_, **__):
    with stage("simulating", 12, "poses") as work:
        for _ in range(12):
            time.sleep(PAUSE)
            work.done()
    from ppmcal.errors import NoResult
    raise NoResult("that was it")

work.run = slow
main()
"""


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("desk")
    for name in ("hexapod.yaml", "scenario.yaml", "measurements.csv", "measurements.yaml"):
        shutil.copy(SAMPLES / name, folder / name)
    return folder


def slow(desk: Path, pause: float, *more: str) -> Terminal:
    return Terminal(WORK.replace("PAUSE", str(pause)), "simulate", desk / "hexapod.yaml",
                    desk / "scenario.yaml", "--out", desk / "s", *more)


@pytest.mark.long
def test_the_time_left_is_shown_and_the_line_is_gone_at_the_end(desk: Path) -> None:
    terminal = slow(desk, 0.25)
    assert terminal.code() == 3
    drawn = [part for part in terminal.shown.split(CLEAR) if part.startswith("simulating")]
    left = [int(found[1]) for part in drawn if (found := re.search(r"about (\d+) s left", part))]
    assert len(left) >= 3 and left[-1] < left[0], drawn
    assert all(len(part) < 80 for part in drawn)
    assert [line for line in terminal.lines() if line] == ["Error: that was it."]


@pytest.mark.parametrize("more", [("--quiet",)])
@pytest.mark.long
def test_quiet_shows_no_progress(desk: Path, more: tuple[str, ...]) -> None:
    terminal = slow(desk, 0.1, *more)
    assert terminal.code() == 3
    assert CLEAR not in terminal.shown


@pytest.mark.long
def test_an_interrupt_leaves_a_clean_line(desk: Path) -> None:
    terminal = slow(desk, 0.5)
    assert terminal.until(" left")
    terminal.process.send_signal(signal.SIGINT)
    assert terminal.code() == 130
    assert [line for line in terminal.lines() if line] == ["Stopped."]


@pytest.mark.long
def test_nothing_is_drawn_into_a_pipe(desk: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", WORK.replace("PAUSE", "0.1"), "simulate", desk / "hexapod.yaml",
         desk / "scenario.yaml", "--out", desk / "s"], capture_output=True, text=True, timeout=60,
        check=False, env={**os.environ, "FORCE_COLOR": "1"})
    assert (done.returncode, done.stdout, done.stderr) == (3, "", "Error: that was it.\n")


@pytest.mark.long
def test_what_is_printed_never_stands_in_the_line(desk: Path) -> None:
    code = WORK.replace("PAUSE", "0.3").replace("work.done()", "work.done(); log.info('a remark')")
    terminal = Terminal("import logging\nlog = logging.getLogger('ppmcal.x')\n" + code, "simulate",
                        desk / "hexapod.yaml", desk / "scenario.yaml", "--out", desk / "s", "-v")
    assert terminal.code() == 3
    remarks = [line for line in terminal.lines() if "a remark" in line]
    assert len(remarks) == 12
    assert all(re.fullmatch(r" *[\d.]+ s x: a remark", line) for line in remarks)


def test_all_shares_are_of_stages_that_there_are() -> None:
    """A stage that is called otherwise would have no time left."""
    root = Path(__file__).resolve().parents[2] / "ppmcal"
    code = "\n".join(p.read_text(encoding="utf-8") for p in root.rglob("*.py")
                     if p.name not in ("shares.py", "options.py"))
    known = set(re.findall(r"(?:begin|stage)\(\s*\"([^\"]+)\"", code)) | set(names())
    of_commands = [command(name).shares for name in names()]
    named = {name for shares in (*of_commands, *INNER.values()) for name in shares}
    assert named <= known, named - known
    assert set(INNER) <= known


@pytest.mark.parametrize(("seconds", "words"), [
    (0.2, "1 s"), (11.3, "12 s"), (130.0, "2 min"), (9000.0, "2.5 h")])
def test_durations_are_no_finer_than_anybody_knows(seconds: float, words: str) -> None:
    assert duration(seconds) == words


def test_long_names_are_cut_in_the_middle() -> None:
    assert shortened("short", 20) == "short"
    cut = shortened("fitting a very long name of something", 20)
    assert len(cut) == 20 and cut.startswith("fitting") and cut.endswith("something")


# ---------------------------------------------------------------- -v


@pytest.mark.long
def test_verbose_says_what_was_read_decided_and_how_long_it_took(desk: Path) -> None:
    run = ppmcal("identify", "hexapod.yaml", "measurements.csv", "--out", "v", "-v", cwd=desk)
    said = " ".join(run.err.split())
    for words in ("ppmcal 0.", "Python 3.", "numpy", "scipy", "120 rows, 20 columns: pose",
                  "units mm and deg", "frame fitted", "sigma position 0.01",
                  "defaults taken: --method prior", "normal equations", "condition",
                  "set aside as gross errors", "weighted down", "left out as gross errors",
                  "fitting: ", "judging the fit: ", "writing the results: "):
        assert words in said, words
    assert "iteration 1: chi-squared" not in said
    assert max(map(len, run.err.splitlines())) <= 80
    more = ppmcal("identify", "hexapod.yaml", "measurements.csv", "--out", "v", "-vv", cwd=desk)
    assert "iteration 1: chi-squared" in more.err
    plain = ppmcal("identify", "hexapod.yaml", "measurements.csv", "--out", "v", cwd=desk)
    assert plain.out == run.out == more.out and not plain.err
    assert logging.getLogger("ppmcal").level == logging.NOTSET
    assert not logging.getLogger("ppmcal").handlers


def test_standard_output_stays_json(desk: Path) -> None:
    run = ppmcal("check", "hexapod.yaml", "--json", "-vv", cwd=desk)
    assert json.loads(run.out)["format"] == "ppmcal/check/1"
    assert "hexapod.yaml: spatial" in run.err


@pytest.mark.parametrize("name", [name for name in names() if not command(name).data])
def test_quiet_and_verbose_together_are_refused(name: str, tmp_path: Path) -> None:
    words = []
    for one in taken(command(name).arguments, PYTHON):
        if one.required:
            words += [] if one.option.argument else [flags(one)[0]]
            words.append(one.option.choices[0] if one.option.choices else "a")
    run = ppmcal(name, *words, "-q", "-v", cwd=tmp_path, expect=2)
    assert "contradict each other" in run.err and not run.out


def test_verbose_is_everywhere() -> None:
    for name in names():
        assert "--verbose" in ppmcal(name, "--help", expect=0).out, name


@pytest.mark.slow
def test_a_process_says_the_same(desk: Path) -> None:
    run = ppmcal_process("schema", "mechanism", "-v", cwd=desk, expect=0)
    assert json.loads(run.out) and "numpy" in run.err
