"""What commands say where they say too little, or the wrong thing."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import click
import numpy as np
import pytest
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT

from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    InterpretationError,
)
from ppmcal.cli import cli
from ppmcal.commands import names
from ppmcal.units import SI

SCENARIO = """
format: ppmcal/scenario/1
units: {length: mm, angle: deg}
poses: {random: {center: {x: 500, y: 290, rz: 30}, half_range: {x: 60, y: 60, rz: 8}, count: 30}}
errors: {random: {scale: 1.0}}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: {x: 5, y: -3, rz: 1}
target: [12, 50]
approach: both
seed: 5
"""


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A 3-RPR machine, measured twice at a mark off its platform's origin."""
    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(ROOT / "configs" / "3-RPR.yaml", folder / "m.yaml")
    for name, change in (("a", ("", "")), ("b", ("seed: 5", "seed: 6")),
                         ("two", ("count: 30", "count: 2"))):
        (folder / "s.yaml").write_text(SCENARIO.replace(*change) if change[0] else SCENARIO)
        ppmcal("simulate", "m.yaml", "s.yaml", "--out", f"sim/{name}", cwd=folder, expect=0)
        for kind in ("csv", "yaml"):
            shutil.copy(folder / f"sim/{name}/measurements.{kind}", folder / f"{name}.{kind}")
    return folder


@pytest.mark.parametrize("name", names())
def test_no_mark_of_the_help_is_printed(name: str) -> None:
    """A raw docstring shows click's sign for lines that are to stay as they are."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    assert "\\b" not in ppmcal(name, "--help", expect=0).out
    assert "\b" not in (command.help or ""), "docs would show it"


@pytest.mark.parametrize(("asked", "words"), [
    ("3-PRR", "more than one '3-PRR'. Give 3-PRR-1 (3-(P)RR); 3-PRR-2 (3-P(R)R)"),
    ("3-rpp", "which joint is driven. Give 3-RPP-2 (3-R(P)P)"),
    ("delta", "delta-linear (3-(P)US, translational)"), ("3-PRS", "Did you mean '3-RPS'")])
def test_a_kind_that_leaves_the_drives_open_is_answered_with_those_there_are(
        asked: str, words: str, tmp_path: Path) -> None:
    assert words in ppmcal("init", asked, cwd=tmp_path, expect=2).err


@pytest.mark.long
def test_fewer_numbers_than_unknowns_are_a_finding(bench: Path) -> None:
    run = ppmcal("identify", "m.yaml", "two.csv", "--out", "few", cwd=bench, expect=1)
    assert "! 2 poses give 6 numbers for 17 unknowns" in run.out
    found = json.loads((bench / "few" / "identification.json").read_text())["findings"]
    assert any("2 poses give 6 numbers" in f for f in found)
    ppmcal("identify", "m.yaml", "a.csv", "--out", "enough", "--keep-outliers", cwd=bench,
           expect=0)
    # two poses more for what thirty know already
    run = ppmcal("identify", "m.yaml", "two.csv", "--start", "enough", "--keep", "--out", "kept",
                 cwd=bench)
    assert "the tolerances decide" not in " ".join(run.out.split())


@pytest.mark.slow
def test_which_point_targets_are_of_is_said(bench: Path) -> None:
    """Of the mark that was measured, or of the platform's origin, 51 mm beside it."""
    ppmcal("identify", "m.yaml", "a.csv", "--out", "i", "--keep-outliers", cwd=bench,
           expect=0)
    (bench / "t.csv").write_text("x,y,rz\n505,290,30\n")
    for words, said in (([], "the mark that a measured is to be"),
                        (["--frame", "base"], "poses of the platform's origin, in the base frame")):
        run = ppmcal("compensate", "i", "t.csv", *words, "--out", "c", cwd=bench, expect=0)
        assert said in " ".join(run.out.split())
        assert " mm in its axes)" in " ".join(run.out.split()) or words
        assert said in json.loads((bench / "c" / "commands.json").read_text())["targets"]
    told = ppmcal("compensate", "i", "t.csv", "--out", "c", cwd=bench, expect=0).out
    found = " ".join(told.split()).partition("to be: ")[2]
    assert float(found.split(" mm")[0]) == pytest.approx(51.4, abs=2.0)
    assert "measured mark" in " ".join(ppmcal("compensate", "--help", expect=0).out.split())


@pytest.mark.slow
def test_a_failure_says_its_reason_in_json_and_names_every_file(bench: Path, tmp_path: Path
                                                               ) -> None:
    for name in ("a", "b"):
        text = (bench / f"{name}.csv").read_text()
        (tmp_path / f"{name}.csv").write_text(text.replace("q_leg1,q_leg2", "q_leg2,q_leg1", 1))
        shutil.copy(bench / f"{name}.yaml", tmp_path)
    run = ppmcal("identify", bench / "m.yaml", "a.csv", "b.csv", "--json", "--out", "o",
                 cwd=tmp_path, expect=3)
    said = json.loads(run.out)
    assert said["exit_code"] == 3 and said["reason"] in run.err
    assert "a.csv: q_leg1 and q_leg2 are exchanged" in said["reason"]
    assert "b.csv: q_leg1 and q_leg2 are exchanged" in said["reason"]
    assert "sidecars of a.csv and b.csv: `read: {columns:" in said["reason"]
    run = ppmcal("identify", bench / "m.yaml", "none.csv", "--json", cwd=tmp_path, expect=2)
    assert "none.csv" in json.loads(run.out)["reason"]


@pytest.mark.slow
def test_the_interval_is_in_the_table(bench: Path) -> None:
    ppmcal("identify", "m.yaml", "a.csv", "--out", "i", "--keep-outliers", cwd=bench,
           expect=0)
    for row in rows(bench / "i" / "parameters.csv"):
        if row["status"] != "fixed":
            assert float(row["low"]) < float(row["value"]) < float(row["high"])
            half = (float(row["high"]) - float(row["low"])) / 2.0
            assert half == pytest.approx(1.96 * float(row["sigma"]), rel=0.1)


@pytest.mark.slow
def test_rows_left_out_are_told_below_the_finding_that_counts_them(bench: Path) -> None:
    """Whatever other findings there are: here tolerances that are too tight."""
    machine = (bench / "m.yaml").read_text()
    (bench / "tight.yaml").write_text(machine.replace(
        "{point: 0.3, length: 0.3, angle: 0.1, offset: 0.4}",
        "{point: 0.06, length: 0.06, angle: 0.02, offset: 0.08}"))
    header, *table = (bench / "a.csv").read_text().splitlines()
    cells = table[7].split(",")
    x = header.split(",").index("x")
    cells[x] = str(float(cells[x]) + 1.0)
    table[7] = ",".join(cells)
    (bench / "typo.csv").write_text("\n".join([header, *table]) + "\n")
    shutil.copy(bench / "a.yaml", bench / "typo.yaml")
    said = ppmcal("identify", "tight.yaml", "typo.csv", "--out", "typo", cwd=bench, expect=1).out
    assert "the tolerances are too tight" in " ".join(said.split())
    assert " ".join(said.partition("for each reason")[2].split()).startswith("a, row 8: x")


def test_a_file_with_two_mistakes_is_named_once() -> None:
    """Joints outside their limits are a mistake each."""
    found = [Interpretation("a.csv",
                            (FileFault("outside-limits", (q,), f"{q} is outside its limits"),),
                            None, "length", np.nan, np.nan, np.nan) for q in ("q_leg1", "q_leg2")]
    said = str(InterpretationError.of(found, SI))
    assert said.startswith("a.csv: q_leg1 is outside its limits; q_leg2 is outside its limits")
