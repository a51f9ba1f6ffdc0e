"""A file of another machine among others: it is told, left out, and no cause is made of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden import Options, hide

from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.explanation import explained
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.wrong_files import REASON, wrong_files


def of_two(other: int) -> Problem:
    """Return 40 poses of a machine, and 15 of one that was made like it, with its own errors."""
    mine, its = (hide("3-RPR", seed, [], 1.0, Options(poses=40), "all") for seed in (7, other))
    more = replace(its.dataset.take(np.arange(15)), name="more")
    return Problem(mine.mechanism, (mine.dataset, more), mine.mechanism.free)


@pytest.mark.long_cases("8-gone0")
@pytest.mark.parametrize(("other", "gone"), [(8, frozenset({"more"})), (7, frozenset())])
@pytest.mark.slow
def test_a_file_of_another_machine_is_told(other: int, gone: frozenset[str]) -> None:
    fit = identify(with_whole_rows(of_two(other)), FitOptions())
    assert wrong_files(explained(fit, FitOptions())[-1]) == gone


@pytest.mark.long
def test_nothing_is_named_because_of_it() -> None:
    found = diagnose(of_two(8), DiagnosisOptions())
    fit = found.identification.fit
    assert found.verdict == "none"
    assert [bool(d.usable.any()) for d in fit.problem.datasets] == [True, False]
    assert set(fit.reasons[1].values()) == {REASON} and len(fit.reasons[1]) == 15
    assert any("more: 15 of 15 rows left out" in f for f in found.findings)
