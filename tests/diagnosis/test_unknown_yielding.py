"""An elastic response to the load that the library does not contain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from helpers.rounds import last_round
from hidden import Options, hide

from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.recorded import with_whole_rows

YIELDS = "an elastic response to the load"


def found(answers: np.ndarray) -> Round:
    """Return what is found where joints answer all joints' loads, m/N (3, 3)."""
    hidden = hide("3-RPR", 7, [], 1.0, Options(poses=60), None)
    plain = identify(with_whole_rows(Problem(hidden.mechanism, (hidden.dataset,),
                                             hidden.mechanism.free)), FitOptions())
    load = np.concatenate([p.setting.load for p in build(plain.problem, plain.state,
                                                         plain.keep).parts])
    data = replace(hidden.dataset, q=hidden.dataset.q - load @ answers.T)
    return last_round(hidden.mechanism, data)


@pytest.mark.long
def test_what_yields_as_one_piece_is_no_compliance_of_joints() -> None:
    """A hinge in a platform: each load turns it, and it moves all three joints."""
    lever = np.array([1.0, -0.6, 0.3])
    told = found(1e-6 * np.outer(lever, lever))
    place, = told.places
    assert place.label == YIELDS
    assert not place.named


@pytest.mark.long
def test_joints_that_yield_alike_have_their_name() -> None:
    assert [p.label.split(" ")[0] for p in found(1e-6 * np.eye(3)).places] == ["compliance"]
