"""Descriptions of learned terms, in words and as data for plots; no inference."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.equation_forms import Equation
from ppmcal.diagnosis.learning import Term
from ppmcal.diagnosis.linearisation import Linearisation
from ppmcal.diagnosis.result import LearnedTerms
from ppmcal.diagnosis.term_candidates import Visible, columns_of
from ppmcal.linalg import Array
from ppmcal.model.effects.learned import JOINT, LearnedCurve
from ppmcal.model.effects.setting import PLACE

RARE = 0.1
"""A second input is shown at the quantiles with this fraction of the rows beyond, at either end."""
POINTS = 121
"""Points of a plotted curve."""
MOSTLY = 0.9
"""A curve looks even, odd or repeating if this fraction of its mean square is."""
KINK = 4.0
"""A curve looks kinked if its largest bend exceeds this multiple of the rms bend."""
LEAST_PERIODS, MOST_PERIODS = 1.5, 10.0
NEAR, FEW = 0.8, 3
"""Smallest cosine of kinds of effect reported as similar, and their largest number."""


@dataclass(frozen=True, eq=False)
class LearnedShape:
    """One learned term in readable form, SI.

    Attributes:
        curve: the function; on: joints, empty for the machine.
        rms: over the rows.
        looks: even, odd, kinked, repeating, hysteretic; period in units of the input or None.
        near: label of a kind of effect -> cosine between both beyond the geometry.
        x, value, sigma: the curve and its standard deviation, over the range; with two inputs, at
            the second one's ``ends[1]``.
        at, partial: input and partial residual of rows.
        ends: the second input's 10 % and 90 % quantiles in the rows; empty without one.
        other: the curve at ``ends[0]``; empty without a second input.
        equation: a short one that predicts equally well, or None.
    """

    curve: LearnedCurve
    on: tuple[str, ...]
    rms: float
    looks: tuple[str, ...]
    period: float | None
    near: tuple[tuple[str, float], ...]
    x: Array
    value: Array
    sigma: Array
    at: Array
    partial: Array
    ends: tuple[float, ...] = ()
    other: Array = field(default_factory=lambda: np.zeros(0))
    equation: Equation | None = None


def shapes(found: LearnedTerms, stage: Linearisation) -> tuple[LearnedShape, ...]:
    """Return descriptions of the learned terms.

    Args:
        found: the terms.
        stage: linearisation with the library to compare them with.
    """
    known = found.equations or (None,) * len(found.learned.terms)
    return tuple(replace(_shape(found.seen, t, c, stage), equation=e) for t, c, e in zip(
        found.learned.terms, found.learned.curves, known, strict=True))


def _shape(seen: Visible, term: Term, curve: LearnedCurve, stage: Linearisation) -> LearnedShape:
    x = np.linspace(curve.nodes[0], curve.nodes[-1], POINTS)
    ends = _ends(seen, curve, term.on)
    by: list[Array | None] = [np.full(x.shape, e) for e in ends] or [None]
    basis = curve.basis(x, by[-1])
    value = basis @ curve.values
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, curve.covariance, basis), 0.0))
    at, own, partial = _partial(seen, term, curve)
    looks, period = _looks(curve, x, value)
    names = seen.system.problem.mechanism.actuators
    on = tuple(a for a, used in zip(names, term.on, strict=True) if used)
    return LearnedShape(curve, on if curve.acts == JOINT else (),
                        float(np.sqrt(np.mean(own**2))), looks, period,
                        _near(stage, curve, term.on), x, value, sigma, at, partial,
                        ends, curve.at(x, by[0]) if ends else np.zeros(0))


def _ends(seen: Visible, curve: LearnedCurve, on: Sequence[bool]) -> tuple[float, ...]:
    """Return low and high quantiles of a second input in the rows; empty without one."""
    if not curve.by:
        return ()
    rows = [curve.seen(p.setting)[1] for p in seen.system.parts]
    there = np.concatenate([r.ravel() if r.ndim == 1 else r[:, np.array(on)].ravel()
                            for r in rows])
    low, high = np.quantile(there, [RARE, 1.0 - RARE])
    return float(low), float(high)


def _partial(seen: Visible, term: Term, curve: LearnedCurve) -> tuple[Array, Array, Array]:
    """Return inputs, the term, and partial residuals: the term plus what is left along it."""
    terms = term.free @ curve.values
    shape = seen.system.residual.shape
    rest = seen.left - terms
    at, term_there, partial = [], [], []
    joints = [a for a, used in enumerate(term.on) if used]
    for a in joints if curve.acts == JOINT else [0]:
        for i, part in enumerate(seen.system.parts):
            unit = (seen.by_joint[i][..., a] if curve.acts == JOINT
                    else seen.by_place[i][..., PLACE[curve.acts]])
            x = [i if i.ndim == 1 else i[:, a] for i in curve.seen(part.setting)]
            own = curve.at(*x)
            if curve.signed:
                unit = unit * part.setting.approach[:, [a]]
            whole = np.zeros((*shape, 1))
            whole[part.at, :unit.shape[1], 0] = unit
            white = seen.noise.apply(whole, seen.system).reshape(shape)[part.at]
            mine = rest.reshape(shape)[part.at]
            length = np.maximum(np.sum(white**2, axis=1), 1e-300)
            at.append(x[0])
            term_there.append(own)
            partial.append(own + np.sum(white * mine, axis=1) / length)
    return np.concatenate(at), np.concatenate(term_there), np.concatenate(partial)


def _looks(curve: LearnedCurve, x: Array, value: Array) -> tuple[tuple[str, ...], float | None]:
    """Return words for a curve, and its period or None."""
    words = ["hysteretic"] if curve.signed else []
    low, high = curve.nodes[0], curve.nodes[-1]
    middle = 0.0 if low < 0.0 < high and curve.input != "travel" else 0.5 * (low + high)
    reach = min(high - middle, middle - low)
    t = np.linspace(0.0, reach, POINTS // 2)
    up, down = (np.interp(middle + way * t, x, value) for way in (1.0, -1.0))
    mean = 0.5 * float(np.mean(up + down))
    even, odd = 0.5 * (up + down) - mean, 0.5 * (up - down)
    total = float(np.mean(even**2) + np.mean(odd**2)) or 1.0
    if np.mean(even**2) > MOSTLY * total:
        words.append("even")
    if np.mean(odd**2) > MOSTLY * total:
        words.append("odd")
    period = _period(x, value)
    if period is not None:
        words.append("repeating")
    bend = np.abs(np.diff(value, 2))
    if period is None and bend.max() > KINK * np.sqrt(np.mean(bend**2)):
        words.append("kinked")
    return tuple(words), period


def _period(x: Array, value: Array) -> float | None:
    """Return the period of a curve that is mostly one sine wave, otherwise None."""
    away = value - value.mean()
    total = float(np.sum(away**2)) or 1.0
    best, found = 0.0, None
    for turns in np.arange(LEAST_PERIODS, MOST_PERIODS, 0.1):
        w = 2.0 * np.pi * turns * (x - x[0]) / (x[-1] - x[0])
        columns = np.stack([np.ones_like(w), np.cos(w), np.sin(w)], axis=-1)
        fitted = columns @ linalg.lstsq(columns, away, rcond=None)[0]
        part = float(np.sum(fitted**2)) / total
        if part > best:
            best, found = part, float((x[-1] - x[0]) / turns)
    return found if best > MOSTLY else None


def _near(stage: Linearisation, curve: LearnedCurve, on: Sequence[bool]) -> tuple[tuple[str, float],
                                                                                  ...]:
    """Return the kinds of effect that act nearly like a curve, most similar first."""
    seen = Visible(stage.system, stage.noise, stage.basis, stage.residual)
    columns = columns_of(seen, curve, on)
    if not np.isfinite(columns).all():
        return ()
    whole = columns @ curve.values
    free = whole - stage.basis @ (stage.basis.T @ whole)
    square = max(float(free @ free), 1e-300)
    best: dict[str, float] = {}
    for h in stage.hypotheses:
        if not (h.anonymous or h.slot or (h.effect and h.effect.onset)):
            along = stage.plane(h.columns).T @ free
            cosine = float(np.sqrt(along @ along / square))
            best[h.label] = max(best.get(h.label, 0.0), cosine)
    ranked = sorted(best.items(), key=lambda pair: -pair[1])
    return tuple((label, c) for label, c in ranked[:FEW] if c >= NEAR)

