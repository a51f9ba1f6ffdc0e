"""Rows that do not show a backlash, against rows whose directions are written the other way."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from controllers.test_printer_import import MEANT, REAL, config, down, written
from helpers.commands import ppmcal

from ppmcal import import_config
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.commands.inputs import load, read_data
from ppmcal.controllers.delta.importer import files
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.unknown_causes import UnknownCauses

BACKLASH = 0.034
QUIET = slice(80, 110)
"""Rows in which the backlash is another."""


def bed(folder: Path, there: float) -> None:
    """A bed of 11 by 11 touches, to and fro, with ``there`` times the backlash in some rows."""
    rng = np.random.default_rng(3)
    side = np.linspace(-80.0, 80.0, 11)
    x, y = np.meshgrid(side, side)
    x[1::2] = x[1::2, ::-1]
    way = np.repeat(np.where(np.arange(11) % 2, -1.0, 1.0), 11)
    size = np.full(way.size, BACKLASH)
    size[QUIET] *= there
    point = np.column_stack([x.ravel(), y.ravel(), rng.normal(0.0, 0.012, way.size)])
    rows = np.column_stack([np.zeros(way.size), down(REAL, point) + (way * size)[:, None], way])
    folder.mkdir()
    found = import_config("klipper", written(folder, config(MEANT)))
    texts = files(found.imported.printer, "fixed")
    (folder / "machine.yaml").write_text(texts["machine.yaml"])
    np.savetxt(folder / "bed.csv", rows, delimiter=",", comments="", fmt="%.6f",
               header="height,q_a,q_b,q_c,dir_x")
    (folder / "bed.yaml").write_text(texts["heights.yaml"].replace(
        "frame: known", "frame: unknown"))


@pytest.mark.long
@pytest.mark.parametrize("there", [0.0, -1.0])
def test_a_backlash_that_is_gone_or_turned_in_some_rows_is_no_misreading(tmp_path: Path,
                                                                         there: float) -> None:
    """Turned, it has no name: the file is not refused.

    Lines go to and fro, so that a function of y is each line's own way as well; a flat tells none
    of x or y but by its tilt.
    """
    bed(tmp_path / "b", there)
    run = ppmcal("diagnose", "machine.yaml", "bed.csv", cwd=tmp_path / "b")
    assert run.code in (0, 1), run.err
    if there < 0.0:
        said = " ".join(run.out.split())
        assert re.search(r"Without a name: a function of (y acting on z|the way from the row "
                         r"before acting on a b c)", said)


def test_touches_hold_no_part_of_a_way_in_height(tmp_path: Path) -> None:
    """A touch is as high as the flat: its way from the last is what errors make of it."""
    bed(tmp_path / "b", 1.0)
    machine = load(tmp_path / "b" / "machine.yaml")
    problem = Problem(machine, read_data(machine, tmp_path / "b" / "bed.csv"), machine.free)
    fit = identify(with_whole_rows(problem))
    system = build(fit.problem, fit.state, fit.keep)
    parts = [c for c in UnknownCauses(system, [p.setting for p in system.firsts]).causes
             if c.label.startswith("readings that include part of the move")]
    assert [c.width for c in parts] == [2, 4, 2, 4]
    assert {(c.low, c.high) for c in parts} == {(0.0, 1.0)}
