"""The diagnosis as data for pictures: what is where, what follows what, what is how likely.

Nothing is decided here; every number is taken from a finished :class:`Diagnosis`. SI.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from ppmcal.calibration.fit import Fit, Problem, least_squares, prior_weights
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.residual_profiles import ProfileErrors, gather
from ppmcal.diagnosis.residual_series import OfUnit, Series, all_series
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.diagnosis.search import columns_of
from ppmcal.diagnosis.selection import own_log_p
from ppmcal.diagnosis.stage import Stage, named_only
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.units import Quantity

MOST_RANKED, OF_ONE_KIND = 14, 2
"""Hypotheses shown, and how many of one kind besides those named and their alternatives."""
ITERATIONS = 60
LN10 = np.log(10.0)
SixDigits = Annotated[float, Quantity(digits=6)]
"""A bare number of a picture."""
MANY_OUT = 0.05
"""More rows left out than this part are likely what is missing itself, and are plotted."""


@dataclass(frozen=True)
class ActuatorError:
    """Rms of one joint's error without and with the effects, and what noise gives, in ``unit``."""

    name: str
    unit: str
    rms_before: OfUnit
    rms_after: OfUnit
    noise: OfUnit


@dataclass(frozen=True)
class Ranked:
    """A hypothesis by strength of evidence: log10 of its p-value, and of that alone.

    The two differ for what is named: its p-value is given the others that are named.
    ``form``: ``one value`` or ``one each`` where it acts on several actuators.
    """

    kind: str
    on: tuple[str, ...]
    form: str
    log10_p: SixDigits
    log10_p_alone: SixDigits
    status: str


@dataclass(frozen=True)
class SelectionStep:
    """One model, from the machine as given to the last effect: rms over the noise.

    ``what``: start, geometry, or the effect that was added (``kind``, ``on``).
    """

    what: str
    kind: str = ""
    on: tuple[str, ...] = ()
    rms_ratio: SixDigits = np.nan


@dataclass(frozen=True)
class PlotData:
    """All pictures' data, every number with its unit beside it.

    ``left_out_rows``: rows that the fit left out as outliers and that are in ``actuators`` and
    ``series`` all the same.
    """

    actuators: tuple[ActuatorError, ...] = ()
    series: tuple[Series, ...] = ()
    ranking: tuple[Ranked, ...] = ()
    steps: tuple[SelectionStep, ...] = ()
    left_out_rows: int = 0


def plot_data(result: Diagnosis) -> PlotData:
    """Return the data of a diagnosis's pictures."""
    fit = _explained(result)
    rows, left_out = _rows(result)
    before, after, inputs, row = gather(result.before, fit, rows)
    return PlotData(_actuators(result, before, after),
                 all_series(result, before, after, inputs, row), _ranking(result),
                 _steps(result), left_out)


def _rows(result: Diagnosis) -> tuple[list[Bools], int]:
    """Return the rows to draw, and how many of them the fit has left out.

    A robust fit takes what nothing explains for outliers; without them nothing is to be seen.
    """
    fit = _explained(result)
    everything = [finite_rows(p) for p in fit.state.poses]
    out = sum(int((e & ~k).sum()) for e, k in zip(everything, fit.keep, strict=True))
    if result.verdict not in ("unnamed", "weak") or out <= MANY_OUT * sum(k.size for k in fit.keep):
        return list(fit.keep), 0
    return everything, out


def _explained(result: Diagnosis) -> Fit:
    """Return the fit with what is named; what was learned has pictures of its own."""
    return result.learned.without if result.learned else result.identification.fit


def _actuators(
    result: Diagnosis, before: ProfileErrors, after: ProfileErrors
) -> tuple[ActuatorError, ...]:
    mechanism = result.identification.mechanism
    stage = result.found.last
    left = max(stage.system.count - stage.basis.shape[1], 1) / stage.system.count
    noise = np.sqrt(left * np.nanmean(after.sigma**2, axis=0)) * result.remainder.reference

    def rms(values: Array) -> Array:
        return np.asarray(np.sqrt(np.nanmean(values**2, axis=0)))

    table = zip(mechanism.actuators, mechanism.actuator_quantity, rms(before.joint).tolist(),
                rms(after.joint).tolist(), noise.tolist(), strict=True)
    return tuple(ActuatorError(*entry) for entry in table)


def _ranking(result: Diagnosis) -> tuple[Ranked, ...]:
    """Return the best hypotheses, those that were named first of all."""
    if not math.isnan(result.nothing):
        return ()    # probabilities are in effects.csv
    stage, told = result.found.last, result.found.first.search.over_all
    out = []
    if result.effects:
        alone = stage.search.values()
        out = [
            _ranked(
                stage.hypotheses[i],
                told(own_log_p(stage.search, stage.chosen, i)),
                told(float(alone[i])),
                "named",
            )
            for i in named_only(stage)
        ]
    rest = [_ranked(c.hypothesis, c.log_p, c.log_p_alone, c.status) for c in result.candidates
            if c.status not in ("not testable", "named")]
    rest = _one_alternative_each(result, sorted(rest, key=lambda r: r.log10_p))
    first = [r for r in rest if r.status == "alternative"]
    others = _few_of_each([r for r in rest if r.status != "alternative"])
    room = max(MOST_RANKED - len(out) - len(first), 0)
    return tuple(sorted([*out, *first, *others[:room]], key=lambda r: r.log10_p_alone))


def _few_of_each(ranked: Sequence[Ranked]) -> list[Ranked]:
    """Keep the first few of each kind, so that one on many actuators does not crowd out others."""
    kinds = [r.kind for r in ranked]
    return [r for n, r in enumerate(ranked) if kinds[:n].count(r.kind) < OF_ONE_KIND]


def _one_alternative_each(result: Diagnosis, ranked: Sequence[Ranked]) -> list[Ranked]:
    """Keep one hypothesis of each alternative as such; the others of it show the same thing."""
    wanted = {a for e in result.effects for a in e.alternatives}
    search = result.found.first.search
    name = search.over_all(search.name) / LN10
    out = []
    for r in ranked:
        label = f"{r.kind} on {', '.join(r.on)}" if r.on else r.kind
        if label in wanted:
            wanted.discard(label)
            r = replace(r, status="alternative")
        elif r.status == "alternative":
            r = replace(r, status="explained" if r.log10_p < name else "not needed")
        out.append(r)
    return out


def _ranked(hypothesis: Hypothesis, log_p: float, alone: float, status: str) -> Ranked:
    several = "" if len(hypothesis.on) < 2 else "one value" if hypothesis.shared else "one each"
    on = () if hypothesis.slot else hypothesis.on
    return Ranked(hypothesis.family, on, several, log_p / LN10, alone / LN10, status)


def _steps(result: Diagnosis) -> tuple[SelectionStep, ...]:
    """Return residuals from the machine as it was given to the last effect."""
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


def _by_gain(stage: Stage) -> list[int]:
    """Return the named hypotheses, each time the one that then explains most."""
    left, order = list(named_only(stage)), list[int]()
    while left:
        best = min(left, key=lambda i: stage.search.test.left(
            columns_of(stage.search, [*order, i])))
        order.append(best)
        left.remove(best)
    return order


def _ratio(stage: Stage, hypotheses: Sequence[int], reference: float) -> float:
    """Return rms over the noise with geometry and some effects, to first order."""
    columns = columns_of(stage.search, hypotheses)
    test = stage.search.test
    freedom = max(test.freedom - len(columns), 1)
    return float(np.sqrt(max(test.left(columns), 0.0) / freedom)) / reference


def _as_given(stage: Stage, reference: float) -> float | None:
    """Return rms over the noise of the machine as its file has it, only frames fitted.

    None where it cannot be had: no pose at the rows' joint values.
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
