"""The diagnosis as data for plots: errors by actuator, against inputs, and by model.

No inference here; every number comes from a finished :class:`Diagnosis`. SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, least_squares, prior_weights
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.linearisation import Linearisation
from ppmcal.diagnosis.residual_profiles import ProfileErrors, gather
from ppmcal.diagnosis.residual_series import OfUnit, Series, all_series
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.units import Quantity

ITERATIONS = 60
SixDigits = Annotated[float, Quantity(digits=6)]
"""A bare number of a plot."""
MANY_OUT = 0.05
"""If a larger fraction of rows is left out, they probably show the missing effect: plot them."""


@dataclass(frozen=True)
class ActuatorError:
    """Rms of one joint's error without and with the effects, and of noise alone, in ``unit``."""

    name: str
    unit: str
    rms_before: OfUnit
    rms_after: OfUnit
    noise: OfUnit


@dataclass(frozen=True)
class SelectionStep:
    """One model, from the machine as given to the last effect: rms over the noise.

    ``what``: start, geometry, or the added effect (``kind``, ``on``).
    """

    what: str
    kind: str = ""
    on: tuple[str, ...] = ()
    rms_ratio: SixDigits = np.nan


@dataclass(frozen=True)
class PlotData:
    """The data of all plots, each number with its unit.

    ``left_out_rows``: rows that the fit left out as outliers but that ``actuators`` and ``series``
    include.
    """

    actuators: tuple[ActuatorError, ...] = ()
    series: tuple[Series, ...] = ()
    steps: tuple[SelectionStep, ...] = ()
    left_out_rows: int = 0


def plot_data(result: Diagnosis) -> PlotData:
    """Return the data for a diagnosis's plots."""
    fit = _explained(result)
    rows, left_out = _rows(result)
    before, after, inputs, row = gather(result.before, fit, rows)
    return PlotData(_actuators(result, before, after),
                 all_series(result, before, after, inputs, row), _steps(result), left_out)


def _rows(result: Diagnosis) -> tuple[list[Bools], int]:
    """Return the rows to draw, and how many of them the fit has left out.

    A robust fit rejects unexplained rows as outliers; without them a plot would show nothing.
    """
    fit = _explained(result)
    everything = [finite_rows(p) for p in fit.state.poses]
    out = sum(int((e & ~k).sum()) for e, k in zip(everything, fit.keep, strict=True))
    if result.verdict not in ("unnamed", "weak") or out <= MANY_OUT * sum(k.size for k in fit.keep):
        return list(fit.keep), 0
    return everything, out


def _explained(result: Diagnosis) -> Fit:
    """Return the fit with the named effects; learned terms have their own plots."""
    return result.learned.without if result.learned else result.identification.fit


def _actuators(
    result: Diagnosis, before: ProfileErrors, after: ProfileErrors
) -> tuple[ActuatorError, ...]:
    mechanism = result.identification.mechanism
    stage = result.found.last
    left = max(stage.freedom, 1) / stage.system.count
    noise = np.sqrt(left * np.nanmean(after.sigma**2, axis=0)) * result.remainder.reference

    def rms(values: Array) -> Array:
        return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))

    table = zip(mechanism.actuators, mechanism.actuator_quantity, rms(before.joint).tolist(),
                rms(after.joint).tolist(), noise.tolist(), strict=True)
    return tuple(ActuatorError(*entry) for entry in table)


def _steps(result: Diagnosis) -> tuple[SelectionStep, ...]:
    """Return residuals step by step, from the machine as given to the last effect."""
    stage = result.found.last
    out = []
    given = _as_given(result.found.first, result.start.reference)
    if given is not None:
        out.append(SelectionStep("start", rms_ratio=given))
    out.append(SelectionStep("geometry", rms_ratio=result.start.ratio))
    order = _by_gain(stage) if result.effects else []
    for count, _ in enumerate(order, 1):
        ratio = result.remainder.ratio if count == len(order) else _ratio(
            stage, order[:count], result.remainder.reference)
        hypothesis = stage.hypotheses[order[count - 1]]
        out.append(SelectionStep("effect", hypothesis.family,
                                 () if hypothesis.slot else hypothesis.on, ratio))
    return tuple(out)


def _by_gain(stage: Linearisation) -> list[int]:
    """Return the named hypotheses in greedy order, each the one that then explains most."""
    left, order = list(stage.chosen), list[int]()
    while left:
        best = min(left, key=lambda i: float(np.sum(stage.left([*order, i]) ** 2)))
        order.append(best)
        left.remove(best)
    return order


def _ratio(stage: Linearisation, hypotheses: Sequence[int], reference: float) -> float:
    """Return rms over the noise with geometry and some effects, to first order."""
    freedom = max(stage.system.count - stage.explained(hypotheses).shape[1], 1)
    return float(np.sqrt(np.sum(stage.left(hypotheses) ** 2) / freedom)) / reference


def _as_given(stage: Linearisation, reference: float) -> float | None:
    """Return rms over the noise of the machine as in its file, fitting only frames.

    None if it cannot be computed: no pose at the rows' joint values.
    """
    system = stage.system
    problem: Problem = replace(system.problem, free=())
    try:
        state = problem.start()
        keep = []
        for i, pose in enumerate(state.poses):
            mine = np.zeros(len(problem.datasets[i]), dtype=bool)
            mine[system.row[system.dataset == i]] = True
            keep.append(mine & finite_rows(pose))
        if problem.columns:
            state = least_squares(problem, state, keep, prior_weights(problem, "prior"),
                                 ITERATIONS).state
        fitted = build(problem, state, keep)
    except PpmcalError:
        return None
    white = stage.noise.apply(fitted.residual[..., None], fitted)
    freedom = max(fitted.count - len(problem.columns), 1)
    ratio = float(np.sqrt(np.sum(white**2) / freedom)) / reference
    return ratio if np.isfinite(ratio) else None
