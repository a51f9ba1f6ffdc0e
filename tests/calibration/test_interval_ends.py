"""Every interval of a noise that was estimated comes from one place."""

from __future__ import annotations

import ast
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.sessions import two_sessions
from helpers.sources import nodes_of

import ppmcal
from ppmcal.calibration.fit.coverage import Z95, coverage_of, variances
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.intervals import coverage, in_words
from ppmcal.calibration.validation.summary import report
from ppmcal.codec import in_units
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_wording import scale_sentence
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

PACKAGE = Path(ppmcal.__file__).parent
KNOWN = {
    "calibration/fit/coverage.py": "the one place",
    "calibration/knowledge/session_variance.py":
        "a tolerance, which is stated; the default of no noise",
    "calibration/knowledge/parameter_estimates.py": "the sigma that is as wide as an interval",
    "calibration/knowledge/identifiability_report.py": "before a fit the noise is as stated",
    "report/diagnosis_figures.py": "files that do not say",
    "controllers/delta/files.py": "printed parts, of which an interval is known, no noise",
    "controllers/number_intervals.py": "parameters whose interval no file says; and back to sigmas",
    "diagnosis/result.py": "the default of no noise",
    "io/measurement_columns.py": "what an instrument lists, which is stated",
    "diagnosis/residual_series.py": "a standard normal of the same chance, no interval",
}


def fitted(mechanism: Mechanism, data: Dataset) -> Fit:
    """Return a fit to twelve rows, six of each session, of noise stated twice too small."""
    few = data.take(np.arange(60) >= 48).noisier(0.5)
    return identify(Problem(mechanism, (few,), mechanism.free), FitOptions(robust=False))


@pytest.mark.long
def test_no_module_has_an_interval_of_its_own() -> None:
    """Where 1.96 is used, the size of the noise, or of a tolerance, is known."""
    using = {str(p.relative_to(PACKAGE)) for p in PACKAGE.rglob("*.py") if any(
        (isinstance(n, ast.Name) and n.id == "Z95")
        or (isinstance(n, ast.Constant) and isinstance(n.value, float)
            and re.match(r"1\.9(6|59)", str(n.value)))
        for n in nodes_of(p))}
    assert using == set(KNOWN)


@pytest.mark.slow
def test_scale_and_sessions_have_the_interval_of_the_fit_s_noise() -> None:
    mechanism, data = two_sessions(2, 3e-4, 6)
    found = report(fitted(mechanism, data),
                   FitOptions(robust=False), 0.0, 0)
    scale = found.identifiability.scale
    assert scale.times == coverage(found.fit) > 1.01 * Z95
    said = replace(scale, sigma=0.01 * scale.length, sigma_data=0.02 * scale.length)
    entry = in_units(said, mechanism.units)
    half = float(re.search(r"\+- (\S+)", scale_sentence(entry))[1])
    assert half == pytest.approx(coverage(found.fit) * entry.sigma, rel=5e-3)
    assert found.sessions.coverage > 1.01 * Z95
    record = IdentificationRecord.of(found, {}, "prior")
    for p in record.parameters:
        assert all(s.half == pytest.approx(found.sessions.coverage * s.sigma) for s in p.sessions)
    free = [e for e in found.estimates if e.status != "fixed"]
    assert [p.by_noise for p in record.parameters if p.status != "fixed"] == pytest.approx(
        [e.by_noise / mechanism.units.factor(e.quantity) for e in free])


@pytest.mark.slow
def test_parameters_by_session_are_told_with_that_interval() -> None:
    mechanism, data = two_sessions(2, 3e-3, 6)
    found = report(fitted(mechanism, data),
                   FitOptions(robust=False), 0.0, 0)
    first = np.arange(len(found.fit.problem.free)) == 0
    sure = replace(found.sessions, p_value=np.where(first, 1e-9, 1.0), apart=first.astype(float))
    (said,) = in_words(found.fit, sure, np.ones(len(found.fit.problem.free)))
    factor = mechanism.units.factor(mechanism.parameters[found.fit.problem.free[0]].quantity)
    halves = [float(h) for h in re.findall(r"\+- (\S+) in", said)]
    assert halves == pytest.approx(sure.coverage * sure.own_sigma[:, 0] / factor, rel=0.05)


def test_known_noise_makes_the_normal_interval() -> None:
    """Of very many redundant values nothing is left to integrate out."""
    assert coverage_of(variances(1e7, 10**7)) == pytest.approx(Z95, rel=1e-3)
