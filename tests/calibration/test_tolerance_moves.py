"""How tolerances move what is seen does not hang on what a fit had free."""

from __future__ import annotations

import numpy as np
import pytest

import ppmcal
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.consider_parameters import by_tolerances, uncertain


@pytest.mark.parametrize("kind", ["3-RPR", "delta-linear", "6-UPS"])
@pytest.mark.slow_cases("6-UPS")
def test_what_is_held_may_be_off_too(kind: str) -> None:
    """Of a fit with nothing free, with some free, and with all: tolerances times derivatives."""
    mechanism = ppmcal.load(ppmcal.shipped(kind))
    (day,) = ppmcal.simulate(mechanism, ppmcal.shipped(kind, scenario=True)).data
    whole, tolerance = uncertain(mechanism)
    problem = Problem(mechanism, (day,), whole)
    (rows,) = problem.rows(problem.start())
    wanted = rows.jacobian[..., :len(whole)] * tolerance
    for free in (whole, whole[::2], ()):
        problem = Problem(mechanism, (day,), free)
        (rows,) = problem.rows(problem.start())
        assert rows.response is not None
        found = rows.whitener @ by_tolerances(rows.response, mechanism)
        assert found == pytest.approx(wanted, abs=1e-9 * float(np.abs(wanted).max()))
