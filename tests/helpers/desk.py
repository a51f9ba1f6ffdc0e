"""A folder with every file that the examples of the pages and of the help name."""

from __future__ import annotations

import csv
import re
import shlex
import shutil
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from helpers.paths import ROOT
from ppmcal.cli import cli
from ppmcal.cli.common import WIDTH

SAMPLES = ROOT / "sample_data"
COPIES = {"hexapod.yaml": "mine.yaml", "scenario.yaml": "mine.scenario.yaml",
          "measurements.csv": "run1.csv", "measurements.yaml": "run1.yaml",
          "hidden/measurements.csv": "run2.csv", "hidden/measurements.yaml": "run2.yaml",
          "targets.csv": "targets.csv", "poses.csv": "poses.csv", "about.yaml": "about.yaml",
          "printer/printer.cfg": "printer.cfg", "maslow/maslow.log": "maslow.log",
          "hangprinter/samples.jsonl": "samples.jsonl"}
LINES = ("ppmcal identify mine.yaml run1.csv --quiet",
         "ppmcal simulate mine.yaml mine.scenario.yaml --seed 5 --out may --quiet",
         "ppmcal simulate mine.yaml mine.scenario.yaml --seed 6 --out june --quiet",
         "ppmcal identify mine.yaml may/measurements.csv --out identified-may --quiet",
         "ppmcal compare identified identified-may --quiet",
         "ppmcal kinematics inverse mine.yaml poses.csv --quiet",
         "ppmcal init 3-RPR --out stage.yaml --quiet",
         "ppmcal simulate stage.yaml stage.scenario.yaml --out camera --quiet",
         "ppmcal import klipper printer.cfg --out printer --quiet",
         "ppmcal identify printer/machine.yaml printer/heights.csv printer/distances.csv "
         "--out fitted-printer --quiet",
         "ppmcal import maslow maslow.log --out belts --quiet",
         "ppmcal identify belts/machine.yaml belts/run_1.csv belts/run_2.csv "
         "--out fitted-maslow --quiet")


def examples_of(name: str) -> list[str]:
    """Return the lines that follow the word in a command's help, as a user would copy them."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    context = click.Context(command, info_name=name, terminal_width=80)
    _, _, end = command.get_help(context).partition("Examples:")
    lines = [line.strip() for line in end.splitlines() if line.strip()]
    assert all(line.startswith("ppmcal ") for line in lines), lines
    return lines


def run(line: str) -> str:
    """Run a command line, which has to end with exit code 0 or 1; return what it prints."""
    result = CliRunner().invoke(cli, shlex.split(line)[1:])
    # 1: done, and something needs a look
    assert result.exit_code in (0, 1), f"{line}\n{result.output}\n{result.exception!r}"
    if line.startswith("ppmcal schema"):    # JSON, for programs
        return result.stdout
    # lines to be copied are never broken; export.json has them too
    wide = [shown for shown in re.sub(r"(?m)^Lines to paste, in .*\n(    .*\n)+", "",
                                      result.stdout).splitlines() if len(shown) > WIDTH]
    assert not wide, f"{line}\n" + "\n".join(wide)
    # a column too narrow for its numbers or words goes on in the next line
    assert not re.search(r"^ {8,}(?:ied|ed|d|ifie?d?|nt|t) *$", result.stdout, re.M), line
    return result.stdout


def lay_desk(folder: Path) -> None:
    """Put the files there, and what commands make of them."""
    (folder / "archive").mkdir(exist_ok=True)
    for source, name in COPIES.items():
        shutil.copy(SAMPLES / source, folder / name)
    few = (folder / "run2.csv").read_text(encoding="utf-8").splitlines(keepends=True)[:81]
    (folder / "run2.csv").write_text("".join(few), encoding="utf-8")    # that run, not that find
    with (folder / "mine.yaml").open("a", encoding="utf-8") as file:
        file.write("stiffness: {bar: 5e4, drive: 2e5}\n")
    (folder / "fleet.yaml").write_text(
        "format: ppmcal/batch/1\nmodel: mine.yaml\ncampaigns:\n"
        "  - {machine: hexapod-07, date: 2026-03-14, data: run1.csv}\n", encoding="utf-8")
    _write_log(folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for line in LINES:
            run(line)
    shutil.copy(folder / "kinematics" / "kinematics.csv", folder / "joints.csv")
    with (folder / "camera" / "measurements.csv").open(encoding="utf-8", newline="") as file:
        seen = [f"{row['x']},{row['y']},{row['rz']}" for row in list(csv.DictReader(file))[:2]]
    (folder / "goals.csv").write_text("\n".join(["x,y,rz", *seen, ""]), encoding="utf-8")
    for day in ("may", "june", "camera"):
        shutil.copy(folder / day / "measurements.csv", folder / f"{day}.csv")
        shutil.copy(folder / day / "measurements.yaml", folder / f"{day}.yaml")
    shutil.copy(SAMPLES / "poses.csv", folder / "tasks.csv")
    poses = (SAMPLES / "poses.csv").read_text(encoding="utf-8")
    (folder / "euler.csv").write_text(
        poses.replace("rx,ry,rz", "euler_1,euler_2,euler_3"), encoding="utf-8")
    shutil.copy(folder / "run1.yaml", folder / "tracker.yaml")
    (folder / "config.g").write_text("M665 R140 L300 B110 H290\nM501\n", encoding="utf-8")


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
