"""How well a file fits its machine under some reading: one number, from few rows.

The rows are registered as well as possible and compared with the nominal machine, relative to what
the stated noise *and* the tolerances explain: V = I + J T^2 J^T in units of the noise, T the
tolerances. Unless that is hopeless, a short robust fit, with the tolerances as prior, gives the
noise it leaves and how far it bends the geometry; both together are the score. Before the fit half
of the rows decide, which is enough for a start; the residuals of the fit count in all of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.special import chdtri

from ppmcal.calibration.fit import (
    Distances,
    Problem,
    State,
    column_scale,
    coordinates,
    distances,
    explained_distances,
    gross_mask,
    huber_weights,
    least_squares,
    prior_weights,
    toleranced,
)
from ppmcal.calibration.interpretation.interpretation_error import Interpretation
from ppmcal.calibration.interpretation.limits import ALLOWED, HARDLY_LESS, LANDS, MOST, WORST
from ppmcal.calibration.interpretation.readings import ColumnInterpretation
from ppmcal.errors import PpmcalError
from ppmcal.inference.priors import MOST_GROSS
from ppmcal.linalg import Array, Bools, Ints, finite_rows, range_basis, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.units import Units

ROWS, ITERATIONS = 48, 10
PARTS = 3
"""The first or the last of so many parts of the rows is examined alone if nothing explains all."""
OFFSET = "offset"


@dataclass(frozen=True)
class Score:
    """Score of a reading of a file.

    Attributes:
        nominal: distance without a fit over what noise and tolerances explain; half of the rows
            are farther off.
        miss: the same for positions, m, and rotations, rad; nan where not measured.
        lost: rows without a pose, of ``rows``; gross: part of them that are gross errors.
        before, noise: residuals of all rows over the noise (:func:`all_rows`), before and after a
            short fit; geometry: by how many tolerances that moves it, RMS; farthest: the most
            of one parameter.
        left: as ``miss``, after the fit.
        readings: how the files should be read instead, if that explains everything.
    """

    nominal: float = np.inf
    miss: tuple[float, float] = (np.nan, np.nan)
    lost: int = 0
    rows: int = 0
    gross: float = 0.0
    before: float = np.inf
    noise: float = np.inf
    geometry: float = np.nan
    farthest: float = np.nan
    left: tuple[float, float] = (np.nan, np.nan)
    readings: tuple[Interpretation, ...] = ()

    @property
    def total(self) -> float:
        """Score relative to that of the right machine, read rightly; 1 at best."""
        if self.lost > MOST * self.rows:
            return np.inf
        if np.isfinite(self.noise):
            return max(1.0, self.noise) * max(1.0, self.geometry / ALLOWED)
        return max(1.0, self.nominal)

    @property
    def doubted(self) -> bool:
        """Whether so much is wrong that a fit of all rows may go astray."""
        return self.nominal > LANDS or self.gross > float(MOST_GROSS)

    @property
    def misread(self) -> bool:
        """Whether neither tolerances nor, in a short fit, another geometry explain the rows."""
        hopeless = max(WORST**0.5, HARDLY_LESS * self.before) < self.noise < np.inf
        return bool(self.readings) or hopeless

    def sentence(self, units: Units) -> str:
        """Return the disagreement with a machine, in file units."""
        parts = [f"{value / units.factor(quantity):.3g} {units.name(quantity)}"
                 for value, quantity in zip(self.miss, ("length", "angle"), strict=True)
                 if np.isfinite(value)]
        lost = f"; {self.lost} of {self.rows} rows have no pose at all" if self.lost else ""
        far = f"{self.nominal:.3g} times what tolerances and noise explain"
        rows = ("measurements do not fit this machine: with the best registration half of the "
                f"rows are off by more than {' and '.join(parts)}, {far}" if parts else
                "joint values do not fit this machine: half of the rows are off by more than "
                f"{far}")
        return (f"the {rows}{lost}; fitting the machine's dimensions still leaves "
                f"{self.noise:.3g} times the noise")


@dataclass(frozen=True, eq=False)
class Look:
    """A few rows of a problem, with every parameter free that has a tolerance.

    Raises:
        BadInput: see :meth:`ppmcal.calibration.fit.Problem.start`.
    """

    problem: Problem
    state: State

    @classmethod
    def at(cls, problem: Problem) -> Look:
        """Return a few rows of a problem."""
        problem = toleranced(problem)
        keep = subsample([np.ones(len(d), dtype=bool) for d in problem.datasets], ROWS)
        few = replace(problem, earlier=None, datasets=tuple(
            d.take(np.flatnonzero(k)) if k.any() else d
            for d, k in zip(problem.datasets, keep, strict=True)))
        return cls(few, few.start())

    @cached_property
    def posed(self) -> list[Bools]:
        """Which rows have a pose, by data set (N,)."""
        return [finite_rows(p) for p in self.state.poses]

    @cached_property
    def explained(self) -> Distances:
        """Distances of rows from the nominal machine, less what tolerances explain."""
        return explained_distances(self.problem, self.state)

    def times(self, index: int) -> float:
        """Return the distance of one data set as :attr:`Score.nominal` has it of all; 0 without."""
        return self.explained.times([k & (i == index) for i, k in enumerate(self.posed)])

    @cached_property
    def gross(self) -> list[Bools]:
        """The rows with gross errors."""
        return gross_mask(self.explained, self.posed)

    @property
    def sound(self) -> list[Bools]:
        """The other rows: a few mistyped values say nothing about how a file is read."""
        gross, posed = (sum(int(k.sum()) for k in keep) for keep in (self.gross, self.posed))
        if gross > float(MOST_GROSS) * posed:
            return self.posed
        return [k & ~g for k, g in zip(self.posed, self.gross, strict=True)]

    def fitted(self) -> State:
        """Return where a short robust fit ends."""
        sound = self.sound

        def weigh(at: State) -> Sequence[Array]:
            return huber_weights(self.problem, at, sound)

        return least_squares(self.problem, self.state, sound,
                             prior_weights(self.problem, "prior"), ITERATIONS, weigh).state

    def _noise(self, state: State) -> float:
        found = distances(self.problem, state)
        return float(all_rows(*(np.concatenate([v[k] for v, k in zip(
            values, self.posed, strict=True)]) for values in (found.square, found.size))))

    def score(self, lands: float = LANDS) -> Score:
        """Return the score, without a fit if the nominal machine is farther off than ``lands``."""
        lost, gross = (sum(int(k.sum()) for k in rows)
                       for rows in ([~k for k in self.posed], self.gross))
        rows = sum(k.size for k in self.posed)
        found = Score(self.explained.times(self.posed), medians(self.problem, self.state),
                      lost, rows, gross / max(rows, 1))
        if not found.nominal <= lands:
            return found
        end = self.fitted()
        away = tolerances_away(self.problem, end)
        return replace(found, before=self._noise(self.state), noise=self._noise(end),
                       geometry=rms(away), farthest=max(away.values(), default=0.0),
                       left=medians(self.problem, end))


def all_rows(square: Array, size: Array) -> Array:
    """Return residuals of all rows over the noise (...): the exponential of their mean log.

    That is the likelihood if each row has noise of its own size, the stated one or any larger.
    Single rows may be far off; but a reading that is right for only half of the rows leaves the
    others, which a median would miss: poses visited twice would fit with a shift by one row.

    Args:
        square: squared distances over the noise (..., n), nan without one.
        size: number of coordinates behind them (..., n).
    """
    away = np.maximum(1.0, square / chdtri(np.maximum(size, 1.0), 0.5))
    judged = np.isfinite(square) & (size > 0)
    total = np.sum(np.log(np.where(judged, away, 1.0)), axis=-1)
    return np.asarray(np.exp(0.5 * total / np.maximum(judged.sum(axis=-1), 1)))


def score(problem: Problem, lands: float = LANDS) -> Score:
    """Return the score of a problem; an infinite one if it cannot be computed."""
    with suppress(PpmcalError):
        return Look.at(problem).score(lands)
    return Score()


def medians(problem: Problem, state: State) -> tuple[float, float]:
    """Return the median errors of positions, m, and rotations, rad; nan where not measured."""
    out: dict[bool, list[float]] = {False: [], True: []}
    for rows in problem.rows(state, False):
        places = np.array(coordinates(problem.datasets[rows.dataset], problem.mechanism.motion))
        for turn in out:
            raw = np.nan_to_num(rows.measured)[:, (places >= 3) == turn]
            if raw.shape[1]:
                out[turn] += np.linalg.norm(raw, axis=1).tolist()
    position, rotation = (float(np.median(v)) if v else float("nan") for v in out.values())
    return position, rotation


def tolerances_away(problem: Problem, state: State) -> dict[str, float]:
    """Return by how many tolerances the geometry is from nominal, without zeros of drives."""
    out = {}
    for i in problem.free:
        parameter = problem.mechanism.parameters[i]
        tau = parameter.prior_sigma
        if tau and parameter.tolerance_class and parameter.tolerance_class != OFFSET:
            out[parameter.name] = abs(float(state.g[i]) - parameter.nominal) / tau
    return out


def rms(away: dict[str, float]) -> float:
    """Return the root mean square of distances, 0 without any."""
    return float(np.sqrt(np.mean(np.square([*away.values()])))) if away else 0.0


def end_parts(problem: Problem, lands: float) -> Iterator[tuple[Dataset, Ints, Score]]:
    """Yield each data set with its first and its last rows, and the score of these alone."""
    for data in problem.datasets:
        for part in np.array_split(np.arange(len(data)), PARTS)[::PARTS - 1]:
            yield data, part, score(problem.alone(data.take(part)), lands)


def right_parts(problem: Problem) -> Iterator[tuple[Dataset, Ints]]:
    """Yield data sets and their first or last rows that fit alone: something happened in between.

    A misreading would affect all rows, from the first to the last.
    """
    return ((data, part) for data, part, alone in end_parts(problem, 0.0) if alone.total <= LANDS)


# --- many readings at once, to first order --------------------------------------------------------

def read_in_ways(data: Dataset, rows: Ints, readings: Sequence[ColumnInterpretation]) -> Dataset:
    """Return some rows of a data set in every reading, one after another (R n,).

    A shift takes the measurement of other rows of the file, which have to exist.
    """
    own = data.take(rows)
    read = [replace(r, shift=0).of(replace(own, position=data.position[rows + r.shift],
                                           rotation=data.rotation[rows + r.shift]))
            for r in readings]
    return replace(data.take(np.tile(rows, len(read))), q=np.concatenate([d.q for d in read]),
                   position=np.concatenate([d.position for d in read]),
                   rotation=np.concatenate([d.rotation for d in read]), whole=None, place=None)


def first_order_scores(problem: Problem, readings: Sequence[ColumnInterpretation]) -> Array:
    """Return the scores (R,) of one data set under other readings of its measured columns.

    The machine is linearised: the part of the residuals that a fit with the tolerances as
    prior cannot explain, and how far it would move. Infinite if too few rows are usable.

    Args:
        problem: of one data set.
        readings: without other joint columns; the first is the present one.

    Raises:
        BadInput: see :meth:`ppmcal.calibration.fit.Problem.start`.
    """
    look, (data,), count = Look.at(problem), problem.datasets, len(readings)
    few, state, edge = look.problem, look.state, max(abs(r.shift) for r in readings)
    here = np.flatnonzero(subsample([np.ones(len(data), dtype=bool)], ROWS)[0])    # the look's
    keep = look.sound[0] & (here >= edge) & (here < len(data) - edge)
    each = np.tile(np.flatnonzero(keep), count)
    many = replace(few, datasets=(read_in_ways(data, here[keep], readings),),
                   pivots=(few.opens[0].about,), given=(few.environments[0].take(each),))
    parts = [*many.rows(replace(state, poses=(state.poses[0][each],)), False)]
    if keep.sum() < 2 * edge or sum(len(p.residual) for p in parts) != len(each):
        return np.full(count, np.inf)
    residual, seen = (np.concatenate(v).reshape(count, int(keep.sum()), -1) for v in zip(
        *((p.residual, p.observed) for p in parts), strict=True))
    weight = prior_weights(few, "prior")
    jacobian = np.concatenate([p.jacobian for p in few.rows(state, True, [keep])])
    whole = np.vstack([jacobian.reshape(-1, len(weight)), np.diag(weight)]) * column_scale(few)
    basis = range_basis(whole, 1e-9)
    flat = np.hstack([residual.reshape(count, -1), np.zeros((count, len(weight)))])
    rest = flat - (flat @ basis) @ basis.T
    square = np.sum(rest[:, :-len(weight)].reshape(residual.shape)**2, axis=2)
    size = seen.sum(axis=2)
    moved = rest[:, -len(weight):][:, weight > 0.0]
    away = np.sqrt(np.mean(moved**2, axis=1)) if moved.size else np.zeros(count)
    out = all_rows(square, size) * np.maximum(1.0, away / ALLOWED)
    return np.asarray(np.where(size.sum(axis=1) < size[0].sum(), np.inf, out))
