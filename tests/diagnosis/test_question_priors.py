"""What the causes of a question cost beforehand."""

from __future__ import annotations

import numpy as np
import pytest
from hidden import Options, hide

from ppmcal.calibration.fit import FitOptions
from ppmcal.calibration.identify import identify
from ppmcal.calibration.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.question import Asked, question
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.diagnosis.term_candidates import all_settings
from ppmcal.diagnosis.unknown_causes import UnknownCauses
from ppmcal.inference.priors import FAMILY, FURTHER_EVENT


def asked(machine: str, kinds: list[str], eta: float = 1.0, frozen: tuple[str, ...] = (),
          poses: int = 30) -> Asked:
    """Return the question of a campaign, slots frozen whose names end so."""
    found = hide(machine, 7, kinds, eta, Options(poses=poses), "all")
    mechanism = found.mechanism
    free = [i for i in mechanism.free if not mechanism.parameters[i].name.endswith(frozen)]
    fit = identify(with_whole_rows(Problem(mechanism, (found.dataset,), tuple(free))),
                   FitOptions())
    system = build(fit.problem, fit.state, fit.keep)
    return question(system, library(system), UnknownCauses(system, all_settings(fit)))


def test_frozen_slots_of_one_sort_share_a_prior_and_a_second_of_a_sort_costs_less() -> None:
    found = asked("3-RRR-1", [], frozen=(".proximal", "leg2.distal"))
    at = {b.family: i for i, b in enumerate(found.question.blocks) if b.family.startswith("geom")}
    first, second, other = (at[f"geometry {n}"] for n in ("leg1.proximal", "leg3.proximal",
                                                          "leg2.distal"))
    prior = found.question.log_prior
    assert prior([first]) == pytest.approx(np.log(float(FAMILY) / 3))
    assert prior([other]) == pytest.approx(np.log(float(FAMILY)))
    assert prior([first, second]) - prior([second]) == pytest.approx(
        np.log(float(FURTHER_EVENT) / 3))
    assert prior([first, other]) == pytest.approx(prior([first]) + prior([other]))
