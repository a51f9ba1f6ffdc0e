"""Do measurements and machine belong together at all? Asked before anything is fitted.

Every row is compared with the nominal machine through the best registration, against what
the stated noise *and* the tolerances explain: V = I + J T^2 J^T in units of the noise, T the
tolerances of the free geometry. A single row far beyond that is a gross error (a value typed
wrong) and must not lead the fit. If half of the rows are, the file is read wrongly, or the
mechanism file is of another machine: then a short fit of few rows decides, and where that
does not come near the noise either, a calibration would only bend the geometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from ppmcal.calibration.least_squares import least_squares, parameter_scale, prior_weights
from ppmcal.calibration.observation import coordinates
from ppmcal.calibration.outliers import Distances, distances, huber_weights
from ppmcal.calibration.problem import Problem, State
from ppmcal.errors import NoResult
from ppmcal.linalg import Array, Bools, finite_rows, subsample
from ppmcal.units import Units

GROSS = 5.0
"""A gross error: a row so many times beyond what noise and tolerances explain."""
MOST_GROSS = 1.0 / 3.0
"""If more rows than this part are gross, it is not rows that are wrong."""
DOUBTED = 5.0
"""Half of the rows are so many times beyond what noise and tolerances explain: try a fit."""
FAR_FROM_NOISE = 10.0
"""A short fit that leaves half of the rows so many times beyond the noise explains nothing,"""
HARDLY_LESS = 0.05
"""and is not on its way either if that is more than this part of what it began with."""
TRIAL_ROWS, TRIAL_ITERATIONS = 48, 10
LOST = 0.5
"""More rows than this part without a pose are doubted too."""
MEND = ("Check the order and signs of the q columns, their units, and how the rotation is written "
        "(rotation vector rx, ry, rz; quaternion x, y, z, w; from platform to base). If the "
        "machine really is that far from its nominal geometry, give larger tolerances")


@dataclass(frozen=True)
class Misfit:
    """How far measurements are from a machine, half of the rows being farther.

    Attributes:
        times: of what noise and tolerances explain, nominal machine, best registration.
        position, rotation: of the measured point, m, and of the body, rad; nan where not
            measured. A height or a distance counts as a position.
        before, after: times the noise, without and with a short fit; nan where none was needed.
        lost: rows without a pose, of ``rows``.
    """

    times: float
    position: float
    rotation: float
    before: float
    after: float
    lost: int
    rows: int

    @property
    def misread(self) -> bool:
        """Whether neither tolerances nor another geometry explain the measurements."""
        return self.after > max(FAR_FROM_NOISE, HARDLY_LESS * self.before)

    def sentence(self, units: Units) -> str:
        """Return what was seen, in file units."""
        parts = [f"{value / units.factor(quantity):.3g} {units.name(quantity)}"
                 for value, quantity in ((self.position, "length"), (self.rotation, "angle"))
                 if np.isfinite(value)]
        lost = f"; {self.lost} of {self.rows} rows have no pose at all" if self.lost else ""
        return ("the measurements do not fit this machine: registered as well as can be, half of "
                f"the rows miss by more than {' and '.join(parts)}, {self.times:.3g} times what "
                f"tolerances and noise explain{lost}; other dimensions of the machine still leave "
                f"{self.after:.3g} times the noise")


def explained_distances(problem: Problem, state: State) -> Distances:
    """Return every row's distance from the machine, freed of what the tolerances explain."""
    problem = _toleranced(problem)
    scale = np.zeros(len(problem.columns))
    scale[:len(problem.free)] = parameter_scale(problem)
    nobody = [np.zeros(len(d), dtype=bool) for d in problem.datasets]
    return distances(problem, state, np.diag(scale**2), nobody)


def _toleranced(problem: Problem) -> Problem:
    """Return the problem with every parameter free that has a tolerance: all that may be wrong."""
    own = {i for i, p in enumerate(problem.mechanism.parameters) if p.prior_sigma and not p.fixed}
    return replace(problem, free=tuple(sorted(own | set(problem.free))))


def gross_errors(problem: Problem, state: State, keep: Sequence[Bools]) -> list[Bools]:
    """Return which of the rows ``keep`` are gross errors, by data set (N,).

    None where there are too many of them to be single mistakes.
    """
    found = explained_distances(problem, state)
    limit = GROSS * max(1.0, found.times(keep))
    out = [k & (away > limit) for k, away in zip(keep, _away(found), strict=True)]
    total = sum(int(k.sum()) for k in keep)
    if sum(int(o.sum()) for o in out) > MOST_GROSS * total:
        return [np.zeros_like(o) for o in out]
    return out


def misfit(problem: Problem) -> Misfit:
    """Return how far the measurements are from the machine as its file has it.

    Args:
        problem: machine and data; where there are many rows, some of them are looked at.

    Raises:
        BadInput: as :meth:`ppmcal.calibration.problem.Problem.start`.
    """
    few = _few(_toleranced(problem))
    state = few.start()
    keep = [finite_rows(p) for p in state.poses]
    rows, lost = sum(k.size for k in keep), sum(int((~k).sum()) for k in keep)
    times = explained_distances(few, state).times(keep)
    position, rotation = _medians(few, state)
    before = after = float("nan")
    if times > DOUBTED or lost > LOST * rows:
        before = distances(few, state).times(keep)
        after = _after_trial(few, state, keep)
    return Misfit(times, position, rotation, before, after, lost, rows)


def refuse_misread(problem: Problem) -> Misfit:
    """Refuse measurements that are not of this machine as the files are read.

    Args:
        problem: machine and data.

    Raises:
        NoResult: neither tolerances nor another geometry explain them.
    """
    found = misfit(problem)
    if not found.misread:
        return found
    raise NoResult(found.sentence(problem.mechanism.units),
                   ", ".join(d.source for d in problem.datasets), MEND)


def _few(problem: Problem) -> Problem:
    keep = subsample([np.ones(len(d), dtype=bool) for d in problem.datasets], TRIAL_ROWS)
    datasets = tuple(d.take(np.flatnonzero(k)) if k.any() else d
                     for d, k in zip(problem.datasets, keep, strict=True))
    return replace(problem, datasets=datasets, earlier=None)


def _away(found: Distances) -> list[Array]:
    """Return each row's distance over the median of noise, by data set (N,); 0 where unknown."""
    return [np.sqrt(np.where(np.isnan(d) | (m == 0), 0.0, d) / chdtri(np.maximum(m, 1.0), 0.5))
            for d, m in zip(found.square, found.size, strict=True)]


def _medians(problem: Problem, state: State) -> tuple[float, float]:
    """Return the median miss of positions, m, and rotations, rad."""
    out: dict[bool, list[float]] = {False: [], True: []}
    for rows in problem.rows(state, False):
        places = np.array(coordinates(problem.datasets[rows.dataset], problem.mechanism.motion))
        for turn in out:
            raw = np.where(rows.observed, rows.raw, 0.0)[:, (places >= 3) == turn]
            if raw.shape[1]:
                out[turn] += np.linalg.norm(raw, axis=1).tolist()
    position, rotation = (float(np.median(v)) if v else float("nan") for v in out.values())
    return position, rotation


def _after_trial(problem: Problem, state: State, keep: Sequence[Bools]) -> float:
    """Return how many times the noise a short robust fit leaves."""
    prior = prior_weights(problem, "prior")

    def weigh(at: State) -> Sequence[Array]:
        return huber_weights(problem, at, keep)

    end = least_squares(problem, state, keep, prior, TRIAL_ITERATIONS, weigh)[0]
    return distances(problem, end).times(keep)
