"""What the causes of a question cost beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import Cause, Options, hide

from ppmcal.calibration.fit import FitOptions
from ppmcal.calibration.identify import identify
from ppmcal.calibration.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.question import Asked, question
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.unknown_causes import UnknownCauses
from ppmcal.inference.priors import FAMILY, FURTHER_EVENT


def asked(machine: str, causes: list[Cause], poses: int = 30) -> Asked:
    """Return the question of a campaign of which causes freeze slots."""
    found = hide(machine, 7, causes, 1.0, Options(poses=poses))
    fit = identify(with_whole_rows(Problem(found.mechanism, (found.dataset,),
                                           found.mechanism.free)), FitOptions())
    system = build(fit.problem, fit.state, fit.keep)
    return question(system, library(system), UnknownCauses(system, ()))


def test_frozen_slots_of_one_sort_share_a_prior_and_a_second_of_a_sort_costs_less() -> None:
    sizes = {f"leg{i}.proximal": 1e-4 * (i == 1) for i in (1, 2, 3)} | {"leg2.distal": 1e-4}
    found = asked("3-RRR-1", [Cause("geometry", (), sizes, 7)])
    at = {b.family: i for i, b in enumerate(found.question.blocks) if b.family.startswith("geom")}
    first, second, other = (at[f"geometry {n}"] for n in ("leg1.proximal", "leg3.proximal",
                                                          "leg2.distal"))
    prior = found.question.log_prior
    assert prior([first]) == pytest.approx(np.log(float(FAMILY) / 3))
    assert prior([other]) == pytest.approx(np.log(float(FAMILY)))
    assert prior([first, second]) - prior([second]) == pytest.approx(
        np.log(float(FURTHER_EVENT) / 3))
    assert prior([first, other]) == pytest.approx(prior([first]) + prior([other]))
