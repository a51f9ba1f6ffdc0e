"""The pattern of a residual with few degrees of freedom, and what would explain it.

With as many touches as parameters, or one more, a test has no power, but the residual lies in a
space of one, two or three directions. Any frozen slot or effect along the residual there explains
it, and these data cannot decide between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.linear_system import INVISIBLE, System, build, range_basis
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.wording import pluralize

FEW = 3
"""Most degrees of freedom for which the remaining directions are examined."""
VISIBLE = 0.02
"""A candidate with a smaller part than this in the remaining directions does not act along them."""
ALIKE = 0.98
"""Cosine with the residual above which a candidate explains it."""
MOSTLY = 0.6
"""A residual is a wave about the middle if that explains this part of its square."""
WAVES = range(2, 5)
SHOWN = 8
RESIDUAL = 3.0
"""Multiple of the noise above which it is reported."""


@dataclass(frozen=True)
class LeftOverPattern:
    """A residual in few directions.

    ``freedom``: their number; ``ratio``: rms over the noise there; ``wave``: waves about the
    middle, 0 if none; ``slots``: frozen parameters that act along it, ``kinds``: the same without
    their limbs, and effects, each sufficient to explain it.
    """

    freedom: int
    ratio: float
    wave: int
    slots: tuple[str, ...]
    kinds: tuple[str, ...]


def left_over_pattern(fit: Fit) -> LeftOverPattern | None:
    """Return the residual's pattern; None if freedom is ample, or nothing exceeds the noise."""
    system = build(fit.problem, fit.state, fit.keep)
    seen = system.observed.reshape(-1)
    basis = range_basis(fit.noise * _flat(system, system.jacobian)[seen], INVISIBLE)
    freedom = int(seen.sum()) - basis.shape[1]
    if not 0 < freedom <= FEW:
        return None
    rest = fit.noise * system.residual.reshape(-1)[seen]
    rest = rest - basis @ (basis.T @ rest)
    size = float(np.linalg.norm(rest))
    if size < RESIDUAL * np.sqrt(freedom):
        return None
    found = library(system)
    columns = _flat(system, found.columns)[seen]
    own = columns - basis @ (basis.T @ columns)
    slots, kinds = list[str](), dict[str, None]()
    for hypothesis in found.hypotheses:
        at = list(hypothesis.columns)
        some = own[:, at]
        # a step at some row would explain any single direction
        event = hypothesis.effect is not None and bool(hypothesis.effect.onset)
        if hypothesis.anonymous or event or len(at) > freedom or np.linalg.norm(some) < (
                VISIBLE * np.linalg.norm(columns[:, at])):
            continue
        if np.linalg.norm(range_basis(some, 1e-9).T @ rest) < ALIKE * size:
            continue
        if hypothesis.slot:
            slots.append(hypothesis.slot)
        kinds.setdefault(_kind(fit, hypothesis.slot) if hypothesis.slot else hypothesis.kind)
    whole = np.zeros(seen.size)
    whole[seen] = rest
    return LeftOverPattern(freedom, size / np.sqrt(freedom), _wave(fit, system, whole),
                           tuple(slots), tuple(kinds))


def _flat(system: System, values: Array) -> Array:
    return values.reshape(-1, values.shape[-1])


def _kind(fit: Fit, slot: str) -> str:
    """Return a slot without its limb, and without its component."""
    limb, _, rest = slot.partition(".")
    return rest if any(own.name == limb for own in fit.problem.mechanism.limbs) else slot


def _wave(fit: Fit, system: System, rest: Array) -> int:
    """Return the number of waves of a scalar residual (N,) about the middle of the poses."""
    if any(not d.kind.scalar for d in fit.problem.datasets) or rest.size != len(system.row):
        return 0
    place = pose_vector(np.concatenate([p.response.pose for p in system.firsts]))[:, :2]
    away = place - place.mean(axis=0)
    radius, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 1], away[:, 0])
    if not radius.max() > 0.0:
        return 0    # always the same place
    shares = {}
    for k in WAVES:
        wave = (radius / radius.max())[:, None] ** k * np.stack(
            [np.cos(k * angle), np.sin(k * angle)], axis=1)
        shares[k] = float(np.sum((range_basis(wave, 1e-6).T @ rest) ** 2) / np.sum(rest**2))
    best = max(shares, key=lambda k: shares[k])
    return best if shares[best] > MOSTLY else 0


def pattern_sentence(found: LeftOverPattern, more: int | None, touches: bool) -> str:
    """Return the sentence; ``more``: measurements that would decide, None if none are planned."""
    wave = f", the {found.wave}-theta pattern about the middle," if found.wave else ""
    names = [*found.kinds[:SHOWN], *(["..."] if len(found.kinds) > SHOWN else [])]
    text = (
        f"{pluralize(found.freedom, 'degree')} of freedom {'is' if found.freedom == 1 else 'are'}"
            f" left, and the residual{wave} is {found.ratio:.3g} times the noise: ")
    what = f"{', '.join(names)} would each explain it" if names else (
        "no frozen parameter and no effect explains it")
    if more is None or not names:
        return text + what
    return f"{text}{what}; {more} more {'touches' if touches else 'poses'} would decide"
