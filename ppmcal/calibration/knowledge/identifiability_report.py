"""What the data determine of a machine: its scale, and which kinds of parameter are collinear."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import Annotated

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit import (
    Z95,
    Fit,
    Problem,
    directions,
    posterior,
    prediction_root,
    unfitted,
)
from ppmcal.calibration.knowledge.intervals import coverage
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import is_joint_component
from ppmcal.units import Finite, Key, OfUnit, OrNull
from ppmcal.wording.progress import stage

SHARE = 0.7
"""The prior dominates a distance if it leaves less than this part of the data's uncertainty."""
MATTERS = 1e-5
"""And if the distance is known no better than this part of it."""
LOOSE, LOST = 1e-3, 0.02
"""Without tolerances the scale is open if a distance is known no better than the first part of it,
and unobservable, so that a fit would run off, if no better than the second."""
ONE = 0.95
"""Two kinds of parameter are collinear from this correlation on, tolerances aside."""
OPEN = 0.3
"""And if each of the two keeps more than this part of its tolerance."""
WEAK = 0.01
"""Weight of the tolerances in the correlations of the data."""
CALIPER = 5e-5
"""Standard uncertainty of a distance measured by caliper, m."""
POSITIONS = 300


@dataclass(frozen=True)
class Scale:
    """How well a distance between two measured positions is known, m.

    ``length``: the longest such distance; ``sigma``: its standard uncertainty with the tolerances,
    ``sigma_data`` by the data alone (inf if they leave it open); ``open``: whether the data leave
    scale to the prior (``prior_dominated``), or to nothing, by an amount that matters;
    ``needed``: length of a distance that, measured to ``measure_to`` (one sigma), halves the
    uncertainty; ``times``: half width of a 95 % interval over each sigma, bare.
    """

    length: Annotated[OfUnit[Finite], Key("distance")]
    sigma: OfUnit[Finite]
    sigma_data: OfUnit[Finite]
    open: bool = field(init=False, default=False)
    prior_dominated: bool = field(init=False, default=False)
    needed: Annotated[OfUnit[OrNull[Finite]], Key("measure_at_least")] = field(
        init=False, default=0.0)
    measure_to: OfUnit[OrNull[Finite]] = field(init=False, default=CALIPER)
    unit: str = field(init=False, default="length")
    times: Finite = Z95

    def __post_init__(self) -> None:
        """Derive the judgements."""
        held = self.sigma < SHARE * self.sigma_data
        self.__dict__.update(
            prior_dominated=held, open=self.sigma > (MATTERS if held else LOOSE) * self.length,
            needed=float(np.sqrt(3.0) * CALIPER * self.length / self.sigma) if self.sigma else 0.0)

    @property
    def unobservable(self) -> bool:
        """Whether neither data nor prior constrain the machine's size."""
        return not self.prior_dominated and self.sigma > LOST * self.length


@dataclass(frozen=True)
class CollinearParameters:
    """Two exactly correlated kinds of slot (bare); ``each``: limb by limb, not only together."""

    one: Annotated[str, Key("a")]
    other: Annotated[str, Key("b")]
    correlation: Finite
    each: Annotated[bool, Key("limb_by_limb")]


@dataclass(frozen=True)
class Identifiability:
    """What the data cannot identify; ``scale`` is None if it could not be judged."""

    scale: Scale | None
    collinear: tuple[CollinearParameters, ...]


def predict_identifiability(problem: Problem, method: str) -> Identifiability:
    """Return what a fit of a problem would leave open, judged at the machine's present values."""
    return identifiability(unfitted(problem, method=method))


@stage("what the data leave open")
def identifiability(fit: Fit, times: float = Z95) -> Identifiability:
    """Return what the rows and priors of a fit (or of a machine before it) leave open.

    Args:
        fit: with its noise.
        times: half width of a 95 % interval over sigma; before a fit the noise is taken as
            known.
    """
    if not fit.problem.free:
        return Identifiability(None, ())
    return Identifiability(
        _scale(fit, times), tuple(sorted(_collinear(fit), key=lambda t: -abs(t.correlation)))
    )


def with_held(fit: Fit, held: Iterable[int]) -> Identifiability:
    """Return what is left open, including parameters that a fit held though the file frees them.

    They were held to improve predictions, and are known no better than their tolerances say.

    Args:
        fit: of the others.
        held: indices of these parameters.
    """
    wide = fit.problem.changed(free=tuple(sorted({*fit.problem.free, *held})))
    return identifiability(unfitted(wide, fit.state, fit.keep), coverage(fit))


def _scale(fit: Fit, times: float) -> Scale | None:
    """Judge the distance between the two farthest measured points of one data set."""
    found = [s for i in range(len(fit.problem.datasets)) if (s := _farthest(fit, i)) is not None]
    if not found:
        return None
    length, slope = max(found, key=lambda s: s[0])
    sigma, by_data = (float(np.linalg.norm(prediction_root(fit, slope, prior)))
                      for prior in (fit.prior, fit.stated))
    return Scale(length, sigma, by_data, times)


def _farthest(fit: Fit, i: int) -> tuple[float, Array] | None:
    """Return the longest distance between measured points of a data set, and its slope (C,)."""
    problem, state = fit.problem, fit.state
    rows = np.flatnonzero(fit.keep[i])
    count = rows.size * (1 if problem.datasets[i].to_q is None else 2)
    if count < 2:
        return None
    some = np.linspace(0, count - 1, min(POSITIONS, count)).astype(int)
    ends = problem.ends(i, state, rows[some % rows.size])
    first = (some < rows.size)[:, None]
    q, pose = (np.where(first, ends[0][part], ends[-1][part]) for part in (0, 1))
    target, turn = state.registrations[i].target, cga.rotation_matrix(pose)
    at = cga.translation(pose) + turn @ target
    away = np.linalg.norm(at[:, None] - at[None], axis=-1)
    two = [int(n) for n in np.unravel_index(int(np.argmax(away)), away.shape)]
    length = float(away[two[0], two[1]])
    if length < 1e-3 * problem.mechanism.length_scale:
        return None
    closure = Model(problem.mechanism, state.g).closure(q[two], problem.free)
    twist = np.zeros((2, 6, len(problem.free)))
    twist[:, list(problem.mechanism.dof)] = -linalg.pinv(
        closure.pose_matrix(pose[two])) @ closure.error_matrix(pose[two], problem.free)
    # the point moves with the platform's origin, and turns about it
    moves = twist[:, :3] - cross_matrix(turn[two] @ target) @ twist[:, 3:]
    along = (at[two[0]] - at[two[1]]) / length
    slope = np.zeros(len(problem.columns))
    slope[:len(problem.free)] = along @ (moves[0] - moves[1])
    open_ = problem.opens[i]
    slope[open_.target] = (along @ (turn[two[0]] - turn[two[1]]))[list(open_.target_parts)][
        :open_.target.stop - open_.target.start]
    return length, slope


def _collinear(fit: Fit) -> Iterator[CollinearParameters]:
    """Yield kinds of slot whose common values the data see only in combination."""
    count, scale = len(fit.problem.free), fit.scale[:len(fit.problem.free)]
    after = posterior(fit)[:count, :count] / np.outer(scale, scale)
    if not np.isfinite(after).all():
        return
    s, vt, seen = directions(fit, fit.stated + WEAK * (fit.prior - fit.stated))
    half = vt[seen][:, :count].T / s[seen]
    weight = np.where(fit.prior[:count] > 0.0, fit.prior[:count] * scale, 1.0)
    kinds = kinds_of(fit.problem.mechanism, fit.problem.free)

    def correlated(one: Sequence[int], other: Sequence[int]) -> float:
        """Correlation of two sums of columns; 0 where either is known well."""
        a, b = (np.isin(np.arange(count), c).astype(float) for c in (one, other))
        if min(float(e @ after @ e) / float(np.sum((e / weight) ** 2)) for e in (a, b)) < OPEN**2:
            return 0.0
        va, vb = a @ half, b @ half
        return float(va @ vb) / float(np.linalg.norm(va) * np.linalg.norm(vb))

    for one, other in combinations(kinds, 2):
        r = correlated(list(kinds[one].values()), list(kinds[other].values()))
        both = [limb for limb in kinds[one] if kinds[other].get(limb, kinds[one][limb])
                != kinds[one][limb]]
        each = [correlated([kinds[one][limb]], [kinds[other][limb]]) for limb in both]
        alike = len(each) > 1 and all(abs(e) > ONE for e in each)
        if abs(r) > ONE or alike:
            yield CollinearParameters(one, other, r if abs(r) > ONE else each[0], alike)


def kinds_of(mechanism: Mechanism, free: tuple[int, ...]) -> dict[str, dict[str, int]]:
    """Return slot -> limb -> column among ``free``, without frame error components."""
    column = {p: c for c, p in enumerate(free)}
    out: dict[str, dict[str, int]] = {}
    for limb in mechanism.limbs:
        polar = [(f"{x.rpartition('.')[0]}.{name}", p) for x, _, radius, angle in limb.slots.polar
                 for name, p in (("radius", radius), ("angle", angle))]
        for slot, p in (*limb.slots.direct, *polar):
            if p in column and not is_joint_component(mechanism.names[p]):
                out.setdefault(slot, {})[limb.name] = column[p]
    return out
