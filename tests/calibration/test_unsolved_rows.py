"""Rows without a pose where a fit began come back where the fitted machine has one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import yaml

import ppmcal
from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.unsolved_rows import NO_POSE, with_unsolved
from ppmcal.commands.inputs import load, shipped
from ppmcal.linalg import Bools
from ppmcal.model.dataset import Dataset

LOST = (3, 11, 20)


def refit(fit: Fit, keep: Sequence[Bools], reasons: Sequence[dict[int, str]]) -> Fit:
    return replace(fit, keep=tuple(keep), reasons=tuple(reasons))


def without_poses(wrong: int | None = None) -> Fit:
    """A fit of which three rows had no pose at the start; one is measured wrongly too."""
    machine = load(shipped("3-RPR"))
    text = yaml.safe_load(shipped("3-RPR", True).read_text(encoding="utf-8"))
    data: Dataset = ppmcal.simulate(machine, text).data[0]
    fit = identify(Problem(machine, (data,), machine.free))
    keep, pose = fit.keep[0].copy(), fit.state.poses[0].copy()
    keep[list(LOST)], pose[list(LOST)] = False, np.nan
    if wrong is not None:
        data.position[wrong] += 0.02
    return replace(fit, keep=(keep,), state=replace(fit.state, poses=(pose,)),
                   reasons=(dict.fromkeys(LOST, NO_POSE),))


def test_those_that_belong_are_taken_back() -> None:
    fit = with_unsolved(without_poses(), refit)
    assert fit.taken_back == len(LOST)
    assert fit.keep[0].all()
    assert fit.reasons == ({},)


def test_one_that_does_not_belong_stays_out_with_both_reasons() -> None:
    fit = with_unsolved(without_poses(wrong=LOST[1]), refit)
    assert fit.taken_back == len(LOST) - 1
    assert np.flatnonzero(~fit.keep[0]).tolist() == [LOST[1]]
    assert "no pose at the start" in fit.reasons[0][LOST[1]]


def test_nothing_lost_changes_nothing() -> None:
    fit = replace(without_poses(), reasons=({},))
    assert with_unsolved(fit, refit) is fit
