"""What the data can tell apart: scaled, deterministic rank analysis.

All decisions are made on the small triangular factor R of the whitened Jacobian, with
columns scaled by the parameters' tolerances: one unit is one tolerance. Open frames and
targets are projected out first, so they cost rank only where they imitate geometry.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.fit import Fit, directions, posterior
from ppmcal.calibration.least_squares import column_scale, prior_weights, qr_factor
from ppmcal.calibration.problem import Problem
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array, finite_rows, range_basis, svd, unit_columns, without_range
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import is_joint_component
from ppmcal.wording.progress import stage

RANK_TOLERANCE = 1e-9
"""A column counts as dependent below this part of the largest column."""
TIE = 1e-6
"""Pivots closer than this (relative) are a tie: the first by name wins."""
TAKES_PART = 1e-6
"""A column takes part in a combination with more than this part of its strongest column."""
COORDINATE = re.compile(r"(\.point)\.(?:[xyz]|radius|angle)$|(\.direction|\.axis)\.r[xyz]$")
"""What a point or a direction has by coordinates depends on the frame that it is written in."""


@dataclass(frozen=True)
class Rank:
    """Rank of the geometry block.

    Attributes:
        kept: columns that are independent, in pivot order (r,).
        dropped: columns that the kept ones explain.
        combination: dropped ~ kept @ combination, in scaled units (r, len(dropped)).
        factor: triangular factor of the kept columns (r, r), nuisance projected out.
        singular: singular values of the whole projected block, descending.
    """

    kept: tuple[int, ...]
    dropped: tuple[int, ...]
    combination: Array
    factor: Array
    singular: Array


def analyse(triangle: Array, geometry: int, scale: Array, tolerance: float = RANK_TOLERANCE,
            names: Sequence[str] = ()) -> Rank:
    """Return the rank of the first ``geometry`` columns, the others projected out.

    Args:
        triangle: R of the whitened Jacobian (C, C) or taller.
        geometry: number of parameter columns F; the rest are open frames and targets.
        scale: one tolerance of each parameter (F,), SI.
        tolerance: columns below this part of the largest are dependent.
        names: of the columns (F,): they, not the order of the limbs in a file, decide ties.
    """
    block = triangle[:, :geometry] * scale
    nuisance = triangle[:, geometry:]
    if nuisance.shape[1]:
        block = without_range(block, range_basis(unit_columns(nuisance), tolerance))
    singular = np.zeros(0)
    if geometry:
        singular = svd(block)[1]
    kept, dropped, r = pivoted(block, tolerance, names)
    size = len(kept)
    combination = np.zeros((0, len(dropped)))
    if size:
        combination = linalg.solve(r[:size, :size], r[:size, size:])
    return Rank(tuple(kept), tuple(dropped), combination, r[:size, :size], singular)


def whole_rank(triangle: Array, geometry: int, scale: Array, tolerance: float = RANK_TOLERANCE,
               names: Sequence[str] = ()) -> tuple[Rank, list[int], list[int]]:
    """Return the geometry's rank, and of all columns those kept and those that others explain.

    What `check` foretells and `identify` tells of redundancy: open frames and targets add no rank
    where the geometry can imitate them, and are judged among themselves. Arguments as those of
    :func:`analyse`, but ``scale`` (C,) and ``names`` of all columns.
    """
    rank = analyse(triangle, geometry, scale[:geometry], tolerance, names[:geometry])
    kept, dropped = list(rank.kept), list(rank.dropped)
    if triangle.shape[1] > geometry:
        nuisance = triangle[:, geometry:]
        among = analyse(nuisance, nuisance.shape[1], scale[geometry:],
                        names=names[geometry:])
        kept += [geometry + c for c in among.kept]
        dropped += [geometry + c for c in among.dropped]
    return rank, kept, dropped


def pivoted(block: Array, tolerance: float, names: Sequence[str] = ()
            ) -> tuple[list[int], list[int], Array]:
    """Pivoted QR by Householder steps, ties broken by :func:`by_name`, without names by order.

    Returns:
        kept columns, dropped columns, and R (rows, F) with columns in that order.
    """
    work = np.array(block, dtype=float)
    rows, count = work.shape
    order = list(range(count))
    turn = by_name(names[:count]) if names else order
    largest = float(np.max(np.linalg.norm(work, axis=0))) if count and rows else 0.0
    size = 0
    while size < min(rows, count):
        norms = np.linalg.norm(work[size:, size:], axis=0)
        best = float(norms.max())
        if best <= tolerance * largest or best == 0.0:
            break
        ties = [j for j in range(norms.size) if norms[j] >= best * (1.0 - TIE)]
        pick = size + min(ties, key=lambda j: turn[order[size + j]])
        work[:, [size, pick]] = work[:, [pick, size]]
        order[size], order[pick] = order[pick], order[size]
        v = work[size:, size].copy()
        v[0] += np.copysign(np.linalg.norm(v), v[0])
        v /= np.linalg.norm(v)
        work[size:, size:] -= 2.0 * np.outer(v, v @ work[size:, size:])
        size += 1
    tail = sorted(range(size, count), key=lambda j: turn[order[j]])
    arranged = list(range(size)) + tail
    return order[:size], [order[j] for j in tail], work[:, arranged]


def by_name(names: Sequence[str]) -> list[int]:
    """Return the place of each name where limbs are sorted (leg2 before leg10), their slots not.

    >>> by_name(["leg10.offset", "leg2.offset", "leg2.length"])
    [2, 0, 1]
    """
    def limb(i: int) -> list[tuple[bool, int, str]]:
        # a word is no number, and comes behind
        return [(not part.isdigit(), int(part) if part.isdigit() else 0, part)
                for part in re.split(r"(\d+)", names[i].partition(".")[0])]

    place = [0] * len(names)
    for turn, i in enumerate(sorted(range(len(names)), key=limb)):
        place[i] = turn
    return place


@dataclass(frozen=True)
class Unidentifiable:
    """Parameters that the data see only together.

    Attributes:
        slots: paths without coordinates, such as ``leg1.base.point``, sorted by name.
        parameters: all columns of theirs that take part, sorted by name.
        combinations: how many combinations of them change nothing that was measured.
        unseen: whether nothing in these slots has any effect.
    """

    slots: tuple[str, ...]
    parameters: tuple[str, ...]
    combinations: int
    unseen: bool


def slot_of(name: str) -> str:
    """Return a parameter's path without the coordinate of a point or of a direction.

    >>> slot_of("leg1.base.point.x"), slot_of("leg1.joint1.rz")
    ('leg1.base.point', 'leg1.joint1.rz')
    """
    return COORDINATE.sub(lambda m: m[1] or m[2], name)


def unidentifiable(rank: Rank, names: Sequence[str]) -> tuple[Unidentifiable, ...]:
    """Return what the data cannot tell apart, as whole sets: the same from every side.

    Columns belong together that appear in one dependence. These sets, unlike the column that a
    pivoted QR happens to drop, depend neither on the order of limbs and columns nor on units:
    they are the connected components of the null space, whichever basis it is found in. Points
    and directions count as wholes, so that they do not depend on the base frame's axes either.

    Args:
        rank: of the geometry's columns.
        names: of these columns (F,).
    """
    parent: dict[str, str] = {}

    def root(slot: str) -> str:
        while parent.setdefault(slot, slot) != slot:
            slot = parent[slot]
        return slot

    used = set(rank.dropped)
    length = np.linalg.norm(rank.factor, axis=0)
    largest = float(length.max(initial=0.0))
    for d, share in zip(rank.dropped, (np.abs(rank.combination) * length[:, None]).T, strict=True):
        # a column without effect is round-off of all the others, and part of nothing
        strongest = max(float(share.max(initial=0.0)), 10.0 * RANK_TOLERANCE * largest / TAKES_PART)
        part = np.flatnonzero(share > TAKES_PART * strongest)
        for k in part.tolist():
            used.add(rank.kept[k])
            parent[root(slot_of(names[rank.kept[k]]))] = root(slot_of(names[d]))
    groups: dict[str, list[int]] = {}
    place = by_name(names)
    for c in sorted(used, key=lambda c: place[c]):
        groups.setdefault(root(slot_of(names[c])), []).append(c)
    out = []
    for group in groups.values():
        slots = tuple(dict.fromkeys(slot_of(names[c]) for c in group))
        count = sum(c in rank.dropped for c in group)
        whole = sum(slot_of(names[c]) in slots for c in (*rank.kept, *rank.dropped))
        out.append(Unidentifiable(slots, tuple(names[c] for c in group), count, count == whole))
    return tuple(out)


def observability(singular: Array, rank: int, poses: int) -> dict[str, float]:
    """Return the observability indices O1 to O5 of the identifiable part.

    O1 = (s1...sp)^(1/p)/sqrt(N) (Borm and Menq), O2 = sp/s1 (Driels and Pathre), O3 = sp
    (Nahvi et al.), O4 = sp^2/s1 (Nahvi and Hollerbach), O5 = 1/sum(1/s) (Sun and
    Hollerbach); s in tolerances per standard deviation.
    """
    s = singular[:rank]
    if not s.size:
        return {f"O{i}": 0.0 for i in range(1, 6)}
    return {"O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(max(poses, 1))),
            "O2": float(s[-1] / s[0]), "O3": float(s[-1]), "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1.0 / np.sum(1.0 / s))}


SHARE = 0.7
"""The prior dominates a distance where it leaves less than this part of what the data do."""
MATTERS = 1e-5
"""And where it is known no better than this part of it."""
LOOSE, LOST = 1e-3, 0.02
"""Without tolerances scale is open where a distance is known no better than this part of it, and
unobservable, so that a fit would run off, where no better than that."""
ONE = 0.95
"""Two kinds of parameter are collinear from this correlation on, tolerances aside."""
OPEN = 0.3
"""And where each of the two keeps more than this part of its tolerance."""
WEAK = 0.01
"""Tolerances count so little when it is asked what the data tell apart."""
CALIPER = 5e-5
"""What a caliper measures a distance to, m, one standard deviation."""
POSITIONS = 300


@dataclass(frozen=True)
class Scale:
    """How well a distance between two measured positions is known, m.

    ``length``: their distance; ``sigma``: its standard deviation with the tolerances,
    ``sigma_data`` by the data alone (inf where they leave it open).
    """

    length: float
    sigma: float
    sigma_data: float

    @property
    def needed(self) -> float:
        """Length of a distance that, measured to :data:`CALIPER`, halves the uncertainty, m."""
        return float(np.sqrt(3.0) * CALIPER * self.length / self.sigma) if self.sigma else 0.0

    @property
    def prior_dominated(self) -> bool:
        """Whether tolerances, more than the data, constrain the machine's size."""
        return self.sigma < SHARE * self.sigma_data

    @property
    def unobservable(self) -> bool:
        """Whether neither data nor prior constrain the machine's size."""
        return not self.prior_dominated and self.sigma > LOST * self.length

    @property
    def open(self) -> bool:
        """Whether these data leave scale to the prior, or to nothing, by an amount that matters."""
        least = MATTERS if self.prior_dominated else LOOSE
        return self.sigma > least * self.length


@dataclass(frozen=True)
class CollinearParameters:
    """Two kinds of slot exactly correlated; ``each``: limb by limb, not only all together."""

    one: str
    other: str
    correlation: float
    each: bool


@dataclass(frozen=True)
class Identifiability:
    """What the data cannot identify; ``scale`` None where it could not be judged."""

    scale: Scale | None
    collinear: tuple[CollinearParameters, ...]


def predict_identifiability(problem: Problem, method: str) -> Identifiability:
    """Return what a fit of a problem would leave open, judged at the machine as it stands."""
    state = problem.start()
    keep = tuple(finite_rows(pose) for pose in state.poses)
    return identifiability(Fit(problem, state, qr_factor(problem, state, keep),
                      prior_weights(problem, method), column_scale(problem), keep, 0, False))


@stage("what the data leave open")
def identifiability(fit: Fit) -> Identifiability:
    """Return what the rows and priors of a fit, or of a machine before it, leave open."""
    if not fit.problem.free:
        return Identifiability(None, ())
    return Identifiability(
        _scale(fit), tuple(sorted(_collinear(fit), key=lambda t: -abs(t.correlation)))
    )


def _scale(fit: Fit) -> Scale | None:
    """Judge the distance of the two measured points that lie farthest apart, in one data set."""
    found = [s for i in range(len(fit.problem.datasets)) if (s := _farthest(fit, i)) is not None]
    if not found:
        return None
    length, slope = max(found, key=lambda s: s[0])
    return Scale(
        length,
        _prediction_sigma(fit, slope, fit.prior),
        _prediction_sigma(fit, slope, 0.0 * fit.prior),
    )


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


def _prediction_sigma(fit: Fit, slope: Array, prior: Array) -> float:
    """Return the standard deviation of slope (C,) . columns with a prior (C,), inf where open."""
    s, vt, seen = directions(fit, prior)
    row = slope * fit.scale
    if np.linalg.norm(vt[~seen] @ row) > 1e-6 * np.linalg.norm(row):
        return float("inf")
    return float(np.linalg.norm((vt[seen] @ row) / s[seen]))


def _collinear(fit: Fit) -> Iterator[CollinearParameters]:
    """Yield kinds of slot whose common value the data see only together."""
    count, scale = len(fit.problem.free), fit.scale[:len(fit.problem.free)]
    after = posterior(fit)[:count, :count] / np.outer(scale, scale)
    if not np.isfinite(after).all():
        return
    s, vt, seen = directions(fit, WEAK * fit.prior)
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
    """Return slot -> limb -> column among ``free``, frame error components left out."""
    column = {p: c for c, p in enumerate(free)}
    out: dict[str, dict[str, int]] = {}
    for limb in mechanism.limbs:
        polar = [(f"{x.rpartition('.')[0]}.{name}", p) for x, _, radius, angle in limb.slots.polar
                 for name, p in (("radius", radius), ("angle", angle))]
        for slot, p in (*limb.slots.direct, *polar):
            if p in column and not is_joint_component(mechanism.names[p]):
                out.setdefault(slot, {})[limb.name] = column[p]
    return out
