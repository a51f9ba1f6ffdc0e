"""Rows that were left out: more of them than gross errors explain, or with a pattern.

A gross error hits any row. If the rows that the fit rejected are nearly all the first at their
pose, or were all approached from one side, or lie in one corner of the workspace, they have more in
common than gross errors. A file of which hardly any row is used is at fault as a whole: its rows
are not searched for patterns.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import combinations, pairwise, product

import numpy as np

from ppmcal.calibration.fit import OUTLIER, Fit, rows_with_outliers
from ppmcal.calibration.validation.residual_vectors import Residuals
from ppmcal.inference.priors import sure
from ppmcal.inference.shares import everywhere, in_a_part
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import Note, topic_of
from ppmcal.units import Angle, Finite, Length, OfUnit
from ppmcal.wording import pluralize
from ppmcal.wording.progress import stage

UNUSED = "unused data"
"""Topic of a data set of which hardly any row is used."""
HARDLY_ANY = 0.1
"""A result says nothing about a data set of which no more than this part of rows is in use."""
THIRDS = 3
STRETCHES = 8
"""Number of overlapping parts of a joint's travel: wear in one of them affects the rows there."""


@dataclass(frozen=True)
class LeftOut:
    """Rows that a fit left out as outliers.

    Attributes:
        count, rows: number of rows left out, and of all.
        too_many: whether gross errors surely do not explain so many.
        follows: what they surely have in common, "" if nothing; ``share``: part that has it.
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
    stretch: Stretch = None

    @property
    def sentence(self) -> str:
        """A statement about them, "" if there is none."""
        rows = f"{pluralize(self.count, 'row')} of {self.rows} left out as outliers"
        if self.follows:
            return (f"{rows}: {self.share:.0%} of them {self.follows}; gross errors have no "
                    "such pattern, so the model misses something there")
        return f"{rows}: more than gross errors explain" if self.too_many else ""


@dataclass(frozen=True)
class DoubtfulStretch:
    """A stretch of a joint's travel, SI, with left-out rows where the model is off.

    ``position``, ``rotation``: rms of its errors there, m and rad; ``unit``: the joint's, once it
    is set.
    """

    actuator: str
    low: OfUnit[Finite]
    high: OfUnit[Finite]
    unit: str = field(default="", kw_only=True)
    position: Length[Finite]
    rotation: Angle[Finite]

    def holds(self, joint: Array) -> Bools:
        """Return which values of the joint (N,) are in the stretch."""
        return np.asarray((joint >= self.low) & (joint <= self.high))


def left_out(fit: Fit) -> LeftOut:
    """Return what the rows that a fit left out have in common.

    Hypotheses: rows are left out at the rate of gross errors, or at a higher one, either
    independently or with a pattern; patterns of circumstances, of stretches and of places have
    equal prior probability, and so have all of a kind.
    """
    datasets, none = fit.problem.datasets, unused(fit)
    gone, used = ([m & (i not in none) for i, m in enumerate(masks)]
                  for masks in (fit.outliers, rows_with_outliers(fit)))
    # what affects a pose affects all its rows: their pattern counts once
    poses = [_one_of_each(u, g, d.groups) for u, g, d in zip(used, gone, datasets, strict=True)]
    every = [_counts(mine, gone) for mine in (used, poses)]
    several = sum(np.unique(d.groups).size for d in datasets)
    found: list[tuple[float, float, tuple[str, Stretch]]] = []
    for patterns in KINDS:
        some = []
        for i, data in enumerate(datasets):
            for words, mask, stretch in _named(fit, i, patterns):
                once = 2 * _mixed(data.groups, mask) < several
                hits, inside = _counts([mask & (poses if once else used)[i]], [gone[i]])
                some.append((hits, inside, *every[once], (words, stretch)))
        some = [h for h in some if 0 < h[1] < h[3] and 0 < h[2] < h[3]]
        found += [(in_a_part(*h[:4]) / len(KINDS) / len(some), h[0] / h[2], h[4]) for h in some]
    odds = sum(f[0] for f in found)
    _, share, told = max(found, default=(0.0, 0.0, ("", None)), key=lambda f: f[:2])
    follows, stretch = told if sure(odds) else ("", None)
    count, rows = every[0]
    return LeftOut(count, rows, sure(everywhere(count, rows)), follows, share, odds / (1.0 + odds),
                   stretch)


def unused(fit: Fit) -> list[int]:
    """Return the data sets of which a fit uses hardly any row, if it uses others."""
    hardly = [i for i, keep in enumerate(fit.keep)
              if keep.size and keep.mean() <= HARDLY_ANY]
    return hardly if len(hardly) < len(fit.keep) else []


def unused_sentences(fit: Fit) -> list[Note]:
    """Return notes on data sets of which hardly any row is used, why, and what to check."""
    out = []
    for i in unused(fit):
        data, count = fit.problem.datasets[i], int(fit.keep[i].sum())
        (reason, _), = Counter(fit.reasons[i].values()).most_common(1)
        if topic_of(reason) == OUTLIER:
            reason = "they contradict the other files, and no other reading explains them"
        rows = pluralize(len(data), "row")
        many = f"only {count} of {rows}" if count else f"none of {rows}"
        out.append(Note(f"{data.name}: {many} {'are' if count > 1 else 'is'} used ({reason}); "
                        "check what was measured there, and the units and signs of its columns",
                        topic=UNUSED))
    return out


def _counts(mine: Sequence[Bools], gone: Sequence[Bools]) -> tuple[int, int]:
    """Return how many of the rows ``mine`` are ``gone``, and how many there are."""
    return (sum(int((m & g).sum()) for m, g in zip(mine, gone, strict=True)),
            sum(int(m.sum()) for m in mine))


def _one_of_each(used: Bools, gone: Bools, label: Ints) -> Bools:
    """Return one of the ``used`` rows (N,) of each label (N,), one that is ``gone`` if any is."""
    rows = np.flatnonzero(used)
    rows = rows[np.argsort(~gone[rows], kind="stable")]
    mask = np.zeros_like(used)
    mask[rows[np.unique(label[rows], return_index=True)[1]]] = True
    return mask


def _mixed(groups: Ints, mask: Bools) -> int:
    """Return the number of poses of which some rows have a pattern and others do not."""
    inside, outside = (np.unique(groups[rows]) for rows in (mask, ~mask))
    return int(np.intersect1d(inside, outside, assume_unique=True).size)


@stage("where the machine is another")
def doubtful_stretches(fit: Fit, after: Residuals, out: LeftOut) -> tuple[DoubtfulStretch, ...]:
    """Return the stretch that the left-out rows have in common, if there is one.

    ``after``: the errors of all rows after the fit.
    """
    if out.stretch is None:
        return ()
    joint, low, high = out.stretch
    rows = [o & (d.q[:, joint] >= low) & (d.q[:, joint] <= high)
            for o, d in zip(fit.outliers, fit.problem.datasets, strict=True)]
    missed = after.figures(rows)
    position, rotation = (missed.get(kind, {}).get("rms", 0.0) for kind in ("position", "rotation"))
    return (DoubtfulStretch(fit.problem.mechanism.actuators[joint], low, high, position, rotation),)


Stretch = tuple[int, float, float] | None
Pattern = tuple[str, Bools, Stretch]
"""A property that rows of one data set may have in common, in words, the rows that have it (N,),
and the stretch of a joint's travel if it is one, as in :class:`LeftOut`."""


def _named(fit: Fit, index: int, patterns: Callable[[Fit, int], Iterator[Pattern]]
           ) -> Iterator[Pattern]:
    """Yield patterns of one data set, with its name if there are several; its name alone is one."""
    datasets = fit.problem.datasets
    where = f" in {datasets[index].name}" if len(datasets) > 1 else ""
    for words, mask, stretch in patterns(fit, index):
        yield words + where, mask, stretch
    if where and patterns is _circumstances:
        yield f"are{where}", np.ones(len(datasets[index]), dtype=bool), None


def _circumstances(fit: Fit, index: int) -> Iterator[Pattern]:
    """Yield order, approach and other recorded conditions."""
    problem = fit.problem
    for words, mask in _of_one(problem.mechanism, problem.datasets[index],
                               problem.environments[index]):
        yield words, mask, None


def _places(fit: Fit, index: int) -> Iterator[Pattern]:
    """Yield thirds of each coordinate of the platform and of each joint, and corners.

    The platform's pose is that of the joints, because the measurement there may be wrong itself.
    """
    mechanism, data = fit.problem.mechanism, fit.problem.datasets[index]
    # for a distance between two positions, the first one
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
    move[move == 0.0] = np.nan  # a row at rest follows no move
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
        # two levels are called the lowest and the highest
        for mask, part in zip(masks, (*parts[:len(masks) - 1], parts[-1]), strict=False):
            yield f"are in the {part} {size} {what}", mask


def _stretches(fit: Fit, index: int) -> Iterator[Pattern]:
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


KINDS = (_circumstances, _stretches, _places)
"""Kinds of patterns."""


def thirds(values: Array) -> list[Bools]:
    """Return which rows are in each third of the values (N,); none where they are unknown."""
    return parts_of(values, THIRDS)


def parts_of(values: Array, count: int) -> list[Bools]:
    """Return the same for so many parts, equal in rows."""
    known = np.isfinite(values)
    if not known.any():
        return [np.zeros(values.size, dtype=bool)] * count
    edges = np.quantile(values[known], np.linspace(0.0, 1.0, count + 1)[1:-1])
    place = np.searchsorted(edges, np.where(known, values, np.nan), side="left")
    return [known & (place == k) for k in range(count)]
