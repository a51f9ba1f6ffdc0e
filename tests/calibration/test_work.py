"""The bound on the work of a search: in steps, shared by its fits, and said where it is met."""

from __future__ import annotations

import pytest

import ppmcal
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.work import another_step, bounded
from ppmcal.diagnosis import diagnose as diagnosis
from ppmcal.diagnosis import refit
from ppmcal.diagnosis.diagnose import DiagnosisOptions


def campaign():
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    run = ppmcal.simulate(machine, ppmcal.shipped("3-RPR", scenario=True), seed=4)
    return Problem(machine, tuple(run.data), machine.free)


def test_all_fits_inside_share_the_steps():
    with bounded(3) as work:
        assert [another_step() for _ in range(4)] == [True, True, True, False]
        assert work.ended
    assert another_step()


def test_a_bound_inside_of_another_one_takes_of_its_steps():
    with bounded(5) as whole:
        with bounded(3) as part:
            assert [another_step() for _ in range(4)] == [True, True, True, False]
        assert part.ended and not whole.ended and (whole.left, whole.cut) == (2, 1)
        with bounded(3) as part:
            assert [another_step() for _ in range(3)] == [True, True, False]
        assert whole.ended and not part.ended


@pytest.fixture(scope="module")
def findings():
    """What the diagnosis says that is given all the steps it takes."""
    return diagnosis.diagnose(campaign(), DiagnosisOptions()).findings


@pytest.mark.slow
def test_a_refit_that_wanders_is_given_up_and_the_diagnosis_says_so(findings, monkeypatch):
    problem = campaign()
    options = DiagnosisOptions()
    assert not any("did not converge within" in f for f in findings)
    monkeypatch.setattr(refit, "MOST_STEPS", 0)
    cut = diagnosis.diagnose(problem, options).findings
    assert any("did not converge within" in f for f in cut)


@pytest.mark.slow
def test_a_fit_without_a_step_left_ends_where_it_is():
    problem = campaign()
    whole = identify(problem, FitOptions())
    with bounded(1) as work:
        short = identify(problem, FitOptions())
    assert work.ended and not short.converged and whole.converged
    assert short.information.square > whole.information.square


@pytest.mark.slow
def test_a_search_that_runs_out_of_steps_ends_with_a_result_that_says_so(
        findings, monkeypatch):
    problem = campaign()
    options = DiagnosisOptions()
    assert diagnosis.ENDED not in findings
    with bounded(10**6) as work:
        diagnosis._diagnosed(problem, options)
    needed = work.most - work.left
    monkeypatch.setattr(diagnosis, "MOST_STEPS", max(needed - 1, 1))
    found = diagnosis.diagnose(problem, options)
    assert diagnosis.ENDED in found.findings
