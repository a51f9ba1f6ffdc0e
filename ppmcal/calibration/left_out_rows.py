"""Rows that were left out: more of them than gross errors explain, or with a pattern.

A gross error hits any row. If the rows that the fit has thrown out are nearly all the first at
their pose, or all came from one side, it was no gross error that they have in common.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.special import bdtrc, gammaln

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.problem import Problem
from ppmcal.calibration.validation import Residuals
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted
from ppmcal.wording.progress import stage

GROSS_SHARE = 0.1
"""Gross errors may be this part of the rows; more is a finding,"""
LEVEL = 0.01
"""where chance would give as many, or as clear a pattern over all that are tried, this rarely."""
FEWEST = 4
"""Fewer rows have no pattern."""
THIRDS = 3
FOR_STRETCHES = 0.2
"""Stretches of travel are many: they have this part of the level, all others the rest."""
STRETCHES = 8
"""Parts of a joint's travel, which overlap: what is worn in one of them hits the rows there."""


@dataclass(frozen=True)
class LeftOut:
    """Rows that a fit left out as outliers.

    Attributes:
        count, rows: how many, and of how many.
        too_many: whether gross errors do not explain so many.
        follows: what they have in common, "" if nothing; ``share`` of them have it.
        p_value: chance of as clear a pattern, over all that were tried.
        stretch: the stretch of a joint's travel that they have in common: its index, and both
            ends, SI; None: something else, or nothing.
    """

    count: int
    rows: int
    too_many: bool
    follows: str
    share: float
    p_value: float
    stretch: tuple[int, float, float] | None = None

    @property
    def of_travel(self) -> bool:
        """Whether what they have in common is a stretch of a joint's travel."""
        return self.stretch is not None

    @property
    def suspicious(self) -> bool:
        """Whether these were not gross errors only."""
        return self.too_many or bool(self.follows)

    @property
    def sentence(self) -> str:
        """What there is to say of them, "" if nothing."""
        rows = f"{counted(self.count, 'row')} of {self.rows} left out as outliers"
        if self.follows:
            return (f"{rows}: {self.share:.0%} of them {self.follows} (p = {self.p_value:.1g}); "
                    "gross errors have no such pattern, so the model misses something there")
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
    """Return what the rows that a fit left out have in common."""
    gone = fit.outliers
    used = [k | g for k, g in zip(fit.keep, gone, strict=True)]
    count, rows = (sum(int(m.sum()) for m in masks) for masks in (gone, used))
    too_many = count > 0 and bool(bdtrc(count - 1, rows, GROSS_SHARE) < LEVEL)
    found: list[tuple[float, float, _Pattern]] = []
    for of_travel, level in ((False, 1.0 - FOR_STRETCHES), (True, FOR_STRETCHES)):
        tests = []
        for pattern in _patterns(fit.problem, of_travel) if FEWEST <= count < rows else ():
            inside = sum(int((m & u).sum()) for m, u in zip(pattern.rows, used, strict=True))
            hits = sum(int((m & g).sum()) for m, g in zip(pattern.rows, gone, strict=True))
            if 0 < inside < rows:
                tests.append((_as_many(hits, rows, inside, count), hits / count, pattern))
        found += [(min(1.0, p * len(tests) / level), share, pattern) for p, share, pattern in tests]
    best, share, pattern = min(found, default=(1.0, 0.0, _Pattern("", [])), key=lambda f: f[:2])
    if best >= LEVEL:
        return LeftOut(count, rows, too_many, "", share, best)
    return LeftOut(count, rows, too_many, pattern.words, share, best, pattern.stretch)


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


def _as_many(hits: int, rows: int, inside: int, count: int) -> float:
    """Return the chance of at least ``hits`` of ``count`` rows among ``inside`` of all.

    The hypergeometric tail; scipy.stats, which has it, takes half a second to load.
    """
    def log_choices(n: int, k: Array) -> Array:
        return np.asarray(gammaln(n + 1.0) - gammaln(k + 1.0) - gammaln(n - k + 1.0))

    k = np.arange(max(hits, count - (rows - inside), 0), min(inside, count) + 1.0)
    parts = (log_choices(inside, k) + log_choices(rows - inside, count - k)
             - log_choices(rows, np.array([float(count)])))
    return min(1.0, float(np.sum(np.exp(parts))))


def _patterns(problem: Problem, of_travel: bool) -> Iterator[_Pattern]:
    """Yield what rows may have in common.

    ``of_travel``: stretches of the joints' travel, else all other patterns.
    """
    many = len(problem.datasets) > 1
    for i, data in enumerate(problem.datasets):
        where = f" in {data.name}" if many else ""
        found = (_stretches(problem.mechanism, data) if of_travel else (
            (words, mask, None) for words, mask in
            _of_one(problem.mechanism, data, problem.environments[i])))
        for words, mask, stretch in found:
            masks = [np.zeros(len(d), dtype=bool) for d in problem.datasets]
            masks[i] = mask
            yield _Pattern(words + where, masks, stretch)
        if many and not of_travel:
            yield _Pattern(f"are in {data.name}",
                           [np.full(len(d), d is data) for d in problem.datasets])


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


def _stretches(mechanism: Mechanism, data: Dataset
               ) -> Iterator[tuple[str, Bools, tuple[int, float, float]]]:
    for a, name in enumerate(mechanism.actuators):
        factor, unit = mechanism.joint_units[a]
        fine = parts_of(data.q[:, a], 2 * STRETCHES)
        for mask in (x | y for x, y in pairwise(fine)):
            if mask.any():
                low, high = (float(f(data.q[mask, a])) for f in (np.min, np.max))
                yield (f"have {name} between {low / factor:.6g} and {high / factor:.6g} "
                       f"{unit}".rstrip(), mask, (a, low, high))


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
