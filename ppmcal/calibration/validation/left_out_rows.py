"""Rows that were left out: more of them than gross errors explain, or with a pattern.

A gross error hits any row. If the rows that the fit has thrown out are nearly all the first at
their pose, or all came from one side, or lie in one corner of the workspace, it was no gross error
that they have in common.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, pairwise, product

import numpy as np

from ppmcal.calibration.fit import Fit, rows_with_outliers
from ppmcal.calibration.validation.residual_vectors import Residuals
from ppmcal.inference.priors import sure
from ppmcal.inference.shares import everywhere, in_a_part
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.wording import counted
from ppmcal.wording.progress import stage

THIRDS = 3
STRETCHES = 8
"""Parts of a joint's travel, which overlap: what is worn in one of them hits the rows there."""


@dataclass(frozen=True)
class LeftOut:
    """Rows that a fit left out as outliers.

    Attributes:
        count, rows: how many, and of how many.
        too_many: whether gross errors surely do not explain so many.
        follows: what they surely have in common, "" if nothing; ``share`` of them have it.
        probability: that they have something in common.
        stretch: the stretch of a joint's travel that they have in common: its index, and both
            ends, SI; None: something else, or nothing.
    """

    count: int
    rows: int
    too_many: bool
    follows: str
    share: float
    probability: float
    stretch: tuple[int, float, float] | None = None

    @property
    def sentence(self) -> str:
        """What there is to say of them, "" if nothing."""
        rows = f"{counted(self.count, 'row')} of {self.rows} left out as outliers"
        if self.follows:
            return (f"{rows}: {self.share:.0%} of them {self.follows}; gross errors have no "
                    "such pattern, so the model misses something there")
        return f"{rows}: more than gross errors explain" if self.too_many else ""


@dataclass(frozen=True)
class DoubtfulStretch:
    """A stretch of a joint's travel, SI, in which rows were left out that the model misses.

    ``position``, ``rotation``: rms by which it does, m and rad.
    """

    actuator: str
    low: float
    high: float
    position: float
    rotation: float

    def holds(self, joint: Array) -> Bools:
        """Return which values of the joint (N,) are in the stretch."""
        return np.asarray((joint >= self.low) & (joint <= self.high))


def left_out(fit: Fit) -> LeftOut:
    """Return what the rows that a fit left out have in common.

    Rows are left out as often as gross errors come, or more often, each row as often as any other,
    or those with a pattern; patterns of circumstances, of stretches and of places are as likely,
    and so are all of a kind.
    """
    gone, datasets = fit.outliers, fit.problem.datasets
    used = rows_with_outliers(fit)
    count, rows = (sum(int(m.sum()) for m in masks) for masks in (gone, used))
    # what hits a pose hits all its rows: what they have in common they have once
    poses = _one_of_each(used, gone, [d.groups for d in datasets])
    found: list[tuple[float, float, _Pattern]] = []
    for patterns in KINDS:
        some = [_Hit.of(p, poses if _of_poses(fit, p) else used, gone)
                for p in _patterns(fit, patterns)]
        some = [h for h in some if 0 < h.inside < h.total and 0 < h.count < h.total]
        found += [(in_a_part(h.hits, h.inside, h.count, h.total) / len(KINDS) / len(some),
                   h.hits / h.count, h.pattern) for h in some]
    odds = sum(f[0] for f in found)
    _, share, pattern = max(found, default=(0.0, 0.0, _Pattern("", [])), key=lambda f: f[:2])
    follows, stretch = (pattern.words, pattern.stretch) if sure(odds) else ("", None)
    return LeftOut(count, rows, sure(everywhere(count, rows)), follows, share, odds / (1.0 + odds),
                   stretch)


def _rows_in(one: Sequence[Bools], other: Sequence[Bools]) -> int:
    return sum(int((a & b).sum()) for a, b in zip(one, other, strict=True))


def _one_of_each(used: Sequence[Bools], gone: Sequence[Bools], labels: Sequence[Ints]
                 ) -> list[Bools]:
    """Return one of the ``used`` rows (N,) of each label (N,), one that is ``gone`` if any."""
    out = []
    for label, u, g in zip(labels, used, gone, strict=True):
        rows = np.flatnonzero(u)
        rows = rows[np.argsort(~g[rows], kind="stable")]
        mask = np.zeros_like(u)
        mask[rows[np.unique(label[rows], return_index=True)[1]]] = True
        out.append(mask)
    return out


@dataclass(frozen=True)
class _Pattern:
    """What rows may have in common, in words, and which have it, by data set (N,).

    ``stretch``: of a joint's travel, as in :class:`LeftOut`.
    """

    words: str
    rows: list[Bools]
    stretch: tuple[int, float, float] | None = None


@stage("where the machine is another")
def doubtful_stretches(fit: Fit, after: Residuals, out: LeftOut) -> tuple[DoubtfulStretch, ...]:
    """Return the stretch that the rows which were left out have in common, if they do.

    ``after``: the errors of all rows at the fit.
    """
    if out.stretch is None:
        return ()
    joint, low, high = out.stretch
    rows = [o & (d.q[:, joint] >= low) & (d.q[:, joint] <= high)
            for o, d in zip(fit.outliers, fit.problem.datasets, strict=True)]
    missed = after.figures(rows)
    position, rotation = (missed.get(kind, {}).get("rms", 0.0) for kind in ("position", "rotation"))
    return (DoubtfulStretch(fit.problem.mechanism.actuators[joint], low, high, position, rotation),)


Found = tuple[str, Bools, tuple[int, float, float] | None]
"""Words, rows (N,) and stretch of a pattern in one data set."""


def _patterns(fit: Fit, of_one: Callable[[Fit, int], Iterator[Found]]) -> Iterator[_Pattern]:
    """Yield what rows may have in common, of one kind; ``of_one`` data set."""
    datasets = fit.problem.datasets
    many = len(datasets) > 1
    for i, data in enumerate(datasets):
        where = f" in {data.name}" if many else ""
        for words, mask, stretch in of_one(fit, i):
            masks = [np.zeros(len(d), dtype=bool) for d in datasets]
            masks[i] = mask
            yield _Pattern(words + where, masks, stretch)
        if many and of_one is _circumstances:
            yield _Pattern(f"are in {data.name}", [np.full(len(d), d is data) for d in datasets])


def _circumstances(fit: Fit, index: int) -> Iterator[Found]:
    """Yield the order, the approach and what was recorded besides."""
    problem = fit.problem
    for words, mask in _of_one(problem.mechanism, problem.datasets[index],
                               problem.environments[index]):
        yield words, mask, None


def _places(fit: Fit, index: int) -> Iterator[Found]:
    """Yield thirds of each coordinate of the platform and of each joint, and corners.

    The platform's pose is that of the joints: what was measured there may be wrong itself.
    """
    mechanism, data = fit.problem.mechanism, fit.problem.datasets[index]
    # of a distance between two positions the first is where it is
    pose = pose_vector(fit.state.poses[index][:, :8])
    low = ("lowest", "middle", "highest")
    for what, values, joint in (
            *((POSE_COORDINATES[c], pose[:, c], None) for c in mechanism.dof),
            *((name, data.q[:, a], a) for a, name in enumerate(mechanism.actuators))):
        for mask, part in zip(thirds(values), low, strict=True):
            if mask.any():
                travel = None if joint is None else (
                    joint, float(values[mask].min()), float(values[mask].max()))
                yield f"are in the {part} third by {what}", mask, travel
    length = mechanism.units.factor("length")
    halves = []
    for c in (c for c in mechanism.dof if c < 3):
        lower, upper = parts_of(pose[:, c], 2)
        if lower.any() and upper.any():
            edge = f"{float(pose[lower, c].max()) / length:.6g} {mechanism.units.length}"
            halves.append(((f"{POSE_COORDINATES[c]} up to {edge}", lower),
                           (f"{POSE_COORDINATES[c]} above {edge}", upper)))
    for size in range(2, len(halves) + 1):
        for some in combinations(halves, size):
            for corner in product(*some):
                yield (f"have {' and '.join(words for words, _ in corner)}",
                       np.all([mask for _, mask in corner], axis=0), None)


def _of_one(mechanism: Mechanism, data: Dataset, rows: Environment) -> Iterator[tuple[str, Bools]]:
    n = len(data)
    first = np.concatenate([[True], data.groups[1:] != data.groups[:-1]])
    yield "are the first row at their pose", first
    for a, name in enumerate(mechanism.actuators):
        for sign, word in ((1.0, "+"), (-1.0, "-")):
            yield f"were approached with {name} moving {word}", rows.approach[:, a] == sign
    move = np.abs(np.diff(data.q, axis=0, prepend=data.q[:1]))
    move[move == 0.0] = np.nan  # a row at rest comes after no move
    for a, name in enumerate(mechanism.actuators):
        yield f"come after the longest moves of {name}", thirds(move[:, a])[-1]
    order = np.arange(n, dtype=float)
    low = ("lowest", "middle", "highest")
    for values, what, parts in (
            (order, "of the rows, in their order", ("first", "middle", "last")),
            (rows.temperature, "by temperature", low),
            (np.linalg.norm(rows.wrench, axis=1), "by load", low)):
        masks = [m for m in thirds(values) if m.any()]
        size = "third" if len(masks) == THIRDS else "part"
        # of two levels one is the lowest, the other the highest
        for mask, part in zip(masks, (*parts[:len(masks) - 1], parts[-1]), strict=False):
            yield f"are in the {part} {size} {what}", mask


def _stretches(fit: Fit, index: int) -> Iterator[Found]:
    """Yield stretches of the joints' travel."""
    mechanism, data = fit.problem.mechanism, fit.problem.datasets[index]
    for a, name in enumerate(mechanism.actuators):
        factor, unit = mechanism.joint_units[a]
        fine = parts_of(data.q[:, a], 2 * STRETCHES)
        for mask in (x | y for x, y in pairwise(fine)):
            if mask.any():
                low, high = (float(f(data.q[mask, a])) for f in (np.min, np.max))
                yield (f"have {name} between {low / factor:.6g} and {high / factor:.6g} "
                       f"{unit}".rstrip(), mask, (a, low, high))


@dataclass(frozen=True)
class _Hit:
    """Rows with a pattern, ``hits`` of ``inside`` left out, and ``count`` of ``total``."""

    pattern: _Pattern
    hits: int
    inside: int
    count: int
    total: int

    @classmethod
    def of(cls, pattern: _Pattern, mine: Sequence[Bools], gone: Sequence[Bools]) -> _Hit:
        """Return it of ``mine`` of the rows."""
        both = [m & g for m, g in zip(pattern.rows, gone, strict=True)]
        return cls(pattern, *(_rows_in(mine, some) for some in (both, pattern.rows, gone, mine)))


def _of_poses(fit: Fit, pattern: _Pattern) -> bool:
    """Return whether at most poses all rows have the pattern, or none."""
    poses, mixed = 0, 0
    for data, mask in zip(fit.problem.datasets, pattern.rows, strict=True):
        labels = np.unique(data.groups)
        poses += labels.size
        mixed += np.unique(np.stack([data.groups, mask]), axis=1).shape[1] - labels.size
    return 2 * mixed < poses


KINDS = (_circumstances, _stretches, _places)
"""Kinds of patterns."""


def thirds(values: Array) -> list[Bools]:
    """Return which rows are in each third of the values (N,); nobody where they are unknown."""
    return parts_of(values, THIRDS)


def parts_of(values: Array, count: int) -> list[Bools]:
    """Return the same of so many parts, equal in rows."""
    known = np.isfinite(values)
    if not known.any():
        return [np.zeros(values.size, dtype=bool)] * count
    edges = np.quantile(values[known], np.linspace(0.0, 1.0, count + 1)[1:-1])
    place = np.searchsorted(edges, np.where(known, values, np.nan), side="left")
    return [known & (place == k) for k in range(count)]
