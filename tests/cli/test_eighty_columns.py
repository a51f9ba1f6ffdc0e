"""Every command keeps to 80 columns, also for a machine and files with long names."""

from __future__ import annotations

import re
import shlex
import shutil
from pathlib import Path

import pytest
from helpers.commands import ppmcal
from helpers.desk import SAMPLES
from helpers.terminal import Terminal

from ppmcal.cli.common import WIDTH
from ppmcal.cli.display import wrapped
from ppmcal.commands import command, names

LIMB = "strut_of_the_north_eastern_corner_"
DAY = "laser tracker in the measuring room of the second hall"
CODE = "from ppmcal.cli import main; main()"
LINES = {
    "init": "init 6-UPS --out here/a-machine-with-a-name-as-long-as-people-give-it.yaml",
    "import": "import klipper printer.cfg --out printer",
    "read": "read run.csv --mechanism mine.yaml --out read/measurements-of-the-second-hall.csv",
    "check": "check mine.yaml run.csv",
    "kinematics": "kinematics inverse mine.yaml poses.csv",
    "simulate": "simulate mine.yaml mine.scenario.yaml --seed 5 --out may",
    "identify": "identify mine.yaml run.csv --out identified",
    "diagnose": "diagnose mine.yaml hidden.csv --out diagnosed --kind backlash --kind compliance "
                "--kind leg_thermal --kind hysteresis",
    "validate": "validate diagnosed hidden.csv --against identified",
    "compare": "compare identified identified-may",
    "compensate": "compensate identified targets.csv",
    "sensitivity": "sensitivity mine.yaml --grid x=-20:20:3,y=-20:20:3",
    "tolerances": "tolerances mine.yaml --accuracy 0.2 --machines 20 --cores 1",
    "stiffness": "stiffness mine.yaml --load fx=1,fy=2,fz=-100 --grid x=-50:50:3,y=-50:50:3",
    "workspace": "workspace mine.yaml --grid x=-200:200:7,y=-200:200:7",
    "plan": "plan mine.yaml --count 8",
    "export": "export linuxcnc identified",
    "batch": "batch fleet.yaml --cores 1",
    "report": "report identified compensated sensitivity plan",
    "verify": "verify identified compensated",
    "certify": "certify identified before/measurements.csv --about about.yaml",
}
LINES |= {name: " ".join(shlex.split(command(name).examples[0])[1:]) for name in names()
          if name not in LINES and not (command(name).data or command(name).script)}
"""By command; no data for programs, and nothing that prints what others print."""
QUIET = ("simulate mine.yaml mine.scenario.yaml --seed 5 --out before --quiet",
         "identify mine.yaml run.csv --out identified --quiet",
         "identify mine.yaml before/measurements.csv --out identified-may --quiet")


def named(text: str) -> str:
    """Give limbs a name that fills a column."""
    return re.sub(r"(?<![a-z])leg(?=\d)", LIMB, text)


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder of a machine, files and data sets with long names."""
    folder = tmp_path_factory.mktemp("desk")
    for source, name in (("hexapod.yaml", "mine.yaml"), ("scenario.yaml", "mine.scenario.yaml"),
                         ("measurements.csv", "run.csv"), ("measurements.yaml", "run.yaml"),
                         ("hidden/measurements.csv", "hidden.csv"),
                         ("hidden/measurements.yaml", "hidden.yaml"),
                         ("targets.csv", "targets.csv"), ("poses.csv", "poses.csv"),
                         ("about.yaml", "about.yaml")):
        text = named((SAMPLES / source).read_text(encoding="utf-8"))
        (folder / name).write_text(re.sub(r"(?m)^name: .*$", f"name: {DAY}", text),
                                   encoding="utf-8")
    for name in ("run.csv", "hidden.csv"):
        few = (folder / name).read_text(encoding="utf-8").splitlines(keepends=True)[:41]
        (folder / name).write_text("".join(few), encoding="utf-8")
    with (folder / "mine.yaml").open("a", encoding="utf-8") as file:
        file.write("stiffness: {bar: 5e4, drive: 2e5}\n")
    (folder / "here").mkdir()
    (folder / "read").mkdir()
    (folder / "fleet.yaml").write_text(
        "format: ppmcal/batch/1\nmodel: mine.yaml\ncampaigns:\n" + "".join(
            f"  - {{machine: hexapod-{n}-{DAY.replace(' ', '-')}, date: 2026-03-1{n}, "
            f"data: {data}}}\n"
            for n, data in ((1, "run.csv"), (2, "before/measurements.csv"))), encoding="utf-8")
    shutil.copy(SAMPLES / "printer/printer.cfg", folder / "printer.cfg")
    for line in QUIET:
        ppmcal(*shlex.split(line), cwd=folder)
    return folder


def too_wide(text: str) -> list[str]:
    """Return lines of more than 80 columns that hold more than one long name."""
    return [line for line in text.splitlines()
            if len(line) > WIDTH and not line.endswith("\\") and len(line.split()) > 1]


@pytest.mark.long
def test_no_line_is_wider_than_80_columns(desk: Path) -> None:
    for line in LINES.values():
        run = ppmcal(*shlex.split(line), cwd=desk)
        assert run.code in (0, 1), f"{line}\n{run.err}"
        assert run.out, line
        assert not too_wide(run.out), line
        # no number is broken, and none stands apart from its unit
        assert not re.search(r"[\d.] *\n *(?:mm|deg|N|kg)\b", run.out), line
        assert not re.search(r"(?m)^ {20,}[-+]?\d\S* *$", run.out), f"{line}\n{run.out}"


@pytest.mark.parametrize("name", [name for name in names() if not command(name).data])
def test_help_keeps_to_80_columns(name: str) -> None:
    assert not too_wide(ppmcal(name, "--help", expect=0).out)


# ---------------------------------------------------------------- wrapping


def test_lines_that_fit_stay_and_others_end_between_words() -> None:
    short = "  a: 1\n    b: [2,  3]"
    assert wrapped(short) == short
    text = " ".join(["some words"] * 30)
    lines = wrapped(text).split("\n")
    assert max(map(len, lines)) <= WIDTH and " ".join(lines) == text


@pytest.mark.parametrize("path", [
    "/home/someone/measurements/" + 12 * "in-a-deep-folder/" + "run-1.csv",
    "measurements of the second hall/first day of the new tracker/run 1.csv"])
def test_a_path_is_never_broken(path: str) -> None:
    for lead in range(WIDTH):
        text = f"Error: {'x' * lead} {path}: header: there is no column q_leg1. Add it."
        assert path in wrapped(text, [path])


@pytest.mark.parametrize("kept", ["0.0123 mm", "-3 deg", "1.2e+04 N/mm", "3.43 N m/deg", "x -0.4",
                                  "rz +12 deg", "0.3 +- 0.02 mm", "4.2e-06 1/K"])
def test_a_number_stays_with_its_unit(kept: str) -> None:
    for lead in range(WIDTH):
        assert kept in wrapped(f"{'x' * lead} {kept} and more words {'y' * 40} that follow it")


@pytest.mark.long
def test_an_error_is_wrapped_at_a_terminal_and_one_line_in_a_pipe(tmp_path: Path) -> None:
    path = tmp_path / ("a folder of measurements that has a name as long as people give them "
                       "and spaces in it") / "mine.yaml"
    path.parent.mkdir()
    text = (SAMPLES / "hexapod.yaml").read_text(encoding="utf-8")
    path.write_text(text.replace("tolerances:", "tolerance:"), encoding="utf-8")
    piped = ppmcal("check", path, expect=2)
    assert piped.err.count("\n") == 1 and "unknown" in piped.err
    terminal = Terminal(CODE, "check", path)
    assert terminal.code() == 2
    lines = [line for line in terminal.lines() if line]
    assert any(str(path) in line for line in lines)
    assert len(lines) > 1
    assert all(len(line) <= WIDTH for line in lines if str(path) not in line)
    assert " ".join(" ".join(lines).split()) == " ".join(piped.err.split())


def test_a_wrong_option_is_wrapped_at_a_terminal(tmp_path: Path) -> None:
    terminal = Terminal(CODE, "identifi")
    assert terminal.code() == 2
    lines = [line for line in terminal.lines() if line]
    assert max(map(len, lines)) <= WIDTH and "Did you mean 'identify'?" in " ".join(lines)


@pytest.mark.parametrize("name", ["mine", "delta-linear", "a-machine-with-quite-a-long-name-of-it"])
def test_the_next_command_can_be_copied_in_one_piece(tmp_path: Path, name: str) -> None:
    said = ppmcal("init", "delta-linear", "--out", f"{name}.yaml", cwd=tmp_path, expect=0).out
    assert f"ppmcal check {name}.yaml\n" in said and not too_wide(said)
