"""Two marks whose columns are exchanged in some of the rows."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from helpers.bodies import machine, measured, wide

import ppmcal as package
from ppmcal.calibration.fit import Problem
from ppmcal.calibration.interpretation import InterpretationError, refuse_before_fit
from ppmcal.calibration.interpretation.exchanged_targets import exchanged_in_part


def campaign(folder: Path, begin: int, end: int) -> Problem:
    """Return a campaign whose marks T1 and T2 are exchanged in rows, counted from 0."""
    seen = measured(3)
    marks = {name: at.copy() for name, at in seen.marks.items()}
    for name, other in (("T1", "T2"), ("T2", "T1")):
        marks[name][begin:end] = seen.marks[other][begin:end]
    machine(folder)
    wide(folder, replace(seen, marks=marks))
    bench = package.load(folder / "bench.yaml")
    return Problem(bench, tuple(package.read_data(bench, folder / "wide.csv")), bench.free)


def test_marks_exchanged_from_a_row_on_are_named(tmp_path: Path) -> None:
    (found,) = exchanged_in_part(campaign(tmp_path, 24, 40))
    assert found.mistakes[0].text.startswith("rows 25 to 40: targets T1 and T2 are exchanged")
    assert found.mistakes[0].rows == tuple(range(25, 41))


def test_marks_in_order_are_not(tmp_path: Path) -> None:
    assert exchanged_in_part(campaign(tmp_path, 0, 0)) == ()


@pytest.mark.slow
@pytest.mark.parametrize(("begin", "end"), [(24, 40), (12, 22)])
def test_such_a_file_is_refused_with_the_rows(tmp_path: Path, begin: int, end: int) -> None:
    with pytest.raises(InterpretationError) as told:
        refuse_before_fit(campaign(tmp_path, begin, end))
    assert f"rows {begin + 1} to {end}: targets T1 and T2" in told.value.what
    assert "exchange the two targets in those rows" in told.value.hint
