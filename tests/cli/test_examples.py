"""Every command's help ends with examples, and each of them runs in a folder that has its files."""

from __future__ import annotations

import csv
import re
import shlex
import shutil
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from ppmcal.cli import COMMANDS, cli
from ppmcal.cli.common import WIDTH

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
SLOW = {"demo", "tolerances", "workspace", "batch", "plan", "diagnose", "stiffness"}
"""Commands whose examples take more than some seconds."""


def examples_of(name: str) -> list[str]:
    """Return the lines that follow the word in a command's help, as a user would copy them."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    context = click.Context(command, info_name=name, terminal_width=80)
    _, _, end = command.get_help(context).partition("Examples:")
    lines = [line.strip() for line in end.splitlines() if line.strip()]
    assert all(line.startswith("ppmcal ") for line in lines), lines
    return lines


ALL = [(name, line) for name in COMMANDS for line in examples_of(name)]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_an_example(name: str) -> None:
    lines = examples_of(name)
    assert lines
    for line in lines:
        assert shlex.split(line)[:2] == ["ppmcal", name]
        assert len(line) <= 78


def run(line: str) -> None:
    result = CliRunner().invoke(cli, shlex.split(line)[1:])
    # 1: done, and something needs a look
    assert result.exit_code in (0, 1), f"{line}\n{result.output}\n{result.exception!r}"
    if not line.startswith("ppmcal schema"):    # JSON, for programs
        wide = [shown for shown in result.stdout.splitlines() if len(shown) > WIDTH]
        assert not wide, f"{line}\n" + "\n".join(wide)
        # a column too narrow for its numbers or words goes on in the next line
        assert not re.search(r"^ {8,}(?:ied|ed|d|ifie?d?|nt|t) *$", result.stdout, re.M), line


def _write_log(folder: Path) -> None:
    """Write the joints of each pose and, apart from them, the points that a tracker saw."""
    with (folder / "run1.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["pose"]: row for row in csv.DictReader(file)}
    joints = [name for name in next(iter(rows.values())) if name.startswith("q_")]
    log = [";".join(["pose", *joints])] + [
        ";".join([pose, *(row[j].replace(".", ",") for j in joints)]) for pose, row in rows.items()]
    points = [f"{pose} {row['x']} {row['y']} {row['z']}" for pose, row in rows.items()]
    (folder / "log.csv").write_text("\n".join(log) + "\n", encoding="utf-8")
    (folder / "points.txt").write_text("\n".join(points) + "\n", encoding="utf-8")


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with everything that the examples name."""
    folder = tmp_path_factory.mktemp("desk")
    copies = {"hexapod.yaml": "mine.yaml", "scenario.yaml": "mine.scenario.yaml",
              "measurements.csv": "run1.csv", "measurements.yaml": "run1.yaml",
              "hidden/measurements.csv": "run2.csv", "hidden/measurements.yaml": "run2.yaml",
              "targets.csv": "targets.csv", "poses.csv": "poses.csv",
              "printer/printer.cfg": "printer.cfg"}
    for source, name in copies.items():
        shutil.copy(SAMPLES / source, folder / name)
    (folder / "fleet.yaml").write_text(
        "format: ppmcal/batch/1\nmodel: mine.yaml\ncampaigns:\n"
        "  - {machine: hexapod-07, date: 2026-03-14, data: run1.csv}\n", encoding="utf-8")
    _write_log(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in ("ppmcal identify mine.yaml run1.csv --quiet",
                     "ppmcal simulate mine.yaml mine.scenario.yaml --seed 5 --out may --quiet",
                     "ppmcal identify mine.yaml may/measurements.csv --out identified-may --quiet",
                     "ppmcal compare identified identified-may --quiet",
                     "ppmcal kinematics inverse mine.yaml poses.csv --quiet",
                     "ppmcal import klipper printer.cfg --out printer --quiet",
                     "ppmcal identify printer/machine.yaml printer/heights.csv "
                     "printer/distances.csv --out fitted-printer --quiet"):
            run(line)
        shutil.copy("kinematics/kinematics.csv", "joints.csv")
    return folder


@pytest.mark.parametrize("line", [
    pytest.param(line, marks=pytest.mark.slow if name in SLOW else ()) for name, line in ALL],
    ids=[line.removeprefix("ppmcal ") for _, line in ALL])
def test_an_example_runs(line: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                         ) -> None:
    here = tmp_path / "desk"
    shutil.copytree(desk, here)
    monkeypatch.chdir(here)
    if line.startswith("ppmcal compare"):
        shutil.rmtree("compared")
    run(line)
