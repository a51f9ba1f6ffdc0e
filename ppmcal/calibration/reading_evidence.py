"""One score of a way to read files: how well a machine within its tolerances explains them then.

A short robust fit of few rows leaves ``s`` times the noise, half of the rows being farther, and a
geometry some tolerances from nominal. What is left may be an effect that nobody listed, which is
one smooth course and not one value for each number: so all values of a file count as
:data:`~ppmcal.inference.priors.COURSE`. The logarithm of the evidence of a reading is then

    -COURSE log s + log p(s) + COURSE log J - G - F log(COURSE) / 2 + parts log(MISREAD)

``log p(s)``: mostly the noise is as stated, else anything; ``J``: factor of the measured columns
by which the reading changes their values, its mean over the columns (in a unit that makes
everything small little is left, and nothing explained); ``G``: what the geometry has to be off, or
another machine's;
``F``: freedoms that are opened; ``parts``: how many things are read otherwise. The way that has
most of it is told, where all in which nothing is misread have less than a twentieth beside it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.gauss_newton import least_squares
from ppmcal.calibration.gross_rows import explained_distances, gross_errors, toleranced
from ppmcal.calibration.least_squares import prior_weights
from ppmcal.calibration.mistakes import Misreading, Mistake, other_sigma, read_block
from ppmcal.calibration.observation import coordinates
from ppmcal.calibration.outliers import distances, huber_weights
from ppmcal.calibration.problem import Problem, State
from ppmcal.calibration.readings import FileReading
from ppmcal.errors import NoResult, PpmcalError
from ppmcal.inference.priors import (
    BELIEVED,
    COURSE,
    MISREAD,
    NONE_MISREAD,
    SISTER,
    STATED,
    UNKNOWN,
)
from ppmcal.linalg import Array, Bools, finite_rows, subsample

FAR_FROM_NOISE = 10.0
"""What leaves half of the rows so many times beyond the noise explains nothing."""
TRIAL_ROWS, TRIAL_ITERATIONS = 48, 10
"""Rows of a short fit, and its steps."""
LOST = 0.5
"""Of a machine that is this one more rows than this part have a pose."""
SMALLEST = 1e-3
"""Beyond that residuals are round-off."""
OFFSET = "offset"


def evidence(times: float, parts: float) -> float:
    """Return the score of what is left in any unit if so many things are read otherwise."""
    return -float(COURSE) * float(np.log(times)) + parts * float(np.log(float(MISREAD)))


@dataclass(frozen=True, eq=False)
class Way:
    """A way in which files may have been meant.

    ``problem``: with the files read so; ``mistakes``: what is wrong then, none where nothing is
    misread; ``reading``: of the data set in question; ``parts``: how many things are read
    otherwise; ``volume``: log J; ``freedoms``: that were opened.
    """

    problem: Problem
    mistakes: tuple[Mistake, ...] = ()
    reading: FileReading | None = None
    parts: float = 0.0
    volume: float = 0.0
    freedoms: int = 0

    @property
    def most(self) -> float:
        """The score that it has where everything fits."""
        return (evidence(1.0, self.parts) + float(COURSE) * self.volume
                - 0.5 * self.freedoms * float(np.log(float(COURSE))))


@dataclass(frozen=True)
class Left:
    """What a way leaves.

    ``times``: of what noise and tolerances explain, nominal machine; ``nominal``, ``fitted``:
    median misses of positions, m, and rotations, rad; ``noise``: after a short fit, times the
    stated one; ``size``: of the geometry's errors then, tolerances (RMS).
    """

    times: float
    nominal: tuple[float, float] = (np.nan, np.nan)
    noise: float = np.inf
    fitted: tuple[float, float] = (np.nan, np.nan)
    size: float = 0.0
    score: float = -np.inf


@dataclass(frozen=True, eq=False)
class AtNominal:
    """Few rows with the nominal machine, before a fit.

    ``times``: of what noise and tolerances explain; ``misses``: median ones of positions, m, and
    rotations, rad.
    """

    problem: Problem
    state: State
    keep: Sequence[Bools]
    times: float
    misses: tuple[float, float]

    @classmethod
    def of(cls, problem: Problem) -> AtNominal:
        """Return it.

        Raises:
            BadInput: as :meth:`ppmcal.calibration.problem.Problem.start`. NoResult: most rows have
                no pose.
        """
        few = few_rows(toleranced(problem))
        state = few.start()
        keep = [finite_rows(p) for p in state.poses]
        if sum(int((~k).sum()) for k in keep) > LOST * sum(k.size for k in keep):
            raise NoResult("most rows have no pose", ", ".join(
                d.source for d in problem.datasets))
        times = explained_distances(few, state).times(keep)
        return cls(few, state, keep, times, medians(few, state))

    def fitted(self, most: float = 0.0) -> Left:
        """Return what a short fit leaves; ``most``: the score where everything fits."""
        few = self.problem
        # values typed wrong are no sign of how a file is to be read
        used = [k & ~g for k, g in zip(self.keep, gross_errors(few, self.state, self.keep),
                                       strict=True)]
        end = after_short_fit(few, self.state, used)
        noise, away = distances(few, end).times(used), [*away_from_nominal(few, end).values()]
        return Left(self.times, self.misses, noise, medians(few, end), rms(away),
                    most + of_noise(noise) - _of_geometry(away))


def leaves(problem: Problem) -> Left:
    """Return what files leave as they are read.

    Raises:
        BadInput, NoResult: as :meth:`AtNominal.of`.
    """
    return AtNominal.of(problem).fitted()


def of_noise(times: float) -> float:
    """Return the part of a score that residuals of so many times the noise have."""
    s = float(np.log(max(times, SMALLEST)))
    at_noise = np.log(1.0 - float(UNKNOWN)) - 0.5 * (s / float(STATED))**2
    hidden = np.log(float(UNKNOWN) / -np.log(SMALLEST))
    return -float(COURSE) * s + float(np.logaddexp(at_noise, hidden))


def _of_geometry(away: Sequence[float]) -> float:
    """Return what errors in tolerances cost beyond those that every machine has.

    Whatever way the files are read, the machine may be another one: then every parameter is free.
    """
    square = float(np.sum(np.square(away)))
    own = 0.5 * max(0.0, square / float(BELIEVED)**2 - len(away))
    other = (0.5 * square / float(SISTER)**2 + 0.5 * len(away) * np.log(float(COURSE))
             - np.log(float(MISREAD)))
    return -float(np.logaddexp(-own, -other))


def away_from_nominal(problem: Problem, state: State) -> dict[str, float]:
    """Return by how many tolerances the geometry is from nominal, zeros of drives left out."""
    out = {}
    for i in problem.free:
        parameter = problem.mechanism.parameters[i]
        tau = parameter.prior_sigma
        if tau and parameter.tolerance_class and parameter.tolerance_class != OFFSET:
            out[parameter.name] = abs(float(state.g[i]) - parameter.nominal) / tau
    return out


def rms(values: Sequence[float]) -> float:
    """Return the root mean square, 0 of nothing."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else 0.0


def best_way(ways: Iterable[Way], as_read: float, times: float) -> tuple[Way, Left] | None:
    """Return the way that is told, None where nothing is surely misread.

    Args:
        ways: of which the one that is likelier before its fit is fitted first.
        as_read: score of the files as they are read.
        times: what they leave with the nominal machine, of what noise and tolerances explain. A
            way that leaves more is not worth a fit, unless the tolerances may be that far off.
    """
    worth = min(max(times, float(BELIEVED)), FAR_FROM_NOISE)
    promising: list[tuple[float, int, Way, AtNominal]] = []
    for n, way in enumerate(ways):
        with suppress(PpmcalError):
            at = AtNominal.of(way.problem)
            if at.times > worth:
                continue
            # a machine off by twice its tolerances is that far off, and no more is to be had
            most = way.most + of_noise(max(at.times / float(BELIEVED), 1.0))
            promising.append((-most, n, way, at))
    right, found = [as_read], list[tuple[Way, Left]]()
    for less, _, way, at in sorted(promising, key=lambda p: p[:2]):
        if -less < max([*right, *(left.score for _, left in found)]):
            break
        with suppress(PpmcalError):
            left = at.fitted(way.most)
            if way.mistakes:
                found.append((way, left))
            else:
                right.append(left.score)
    if not found:
        return None
    told = max(found, key=lambda f: f[1].score)
    odds = np.logaddexp.reduce(right) - told[1].score
    return told if odds < np.log(float(NONE_MISREAD)) else None


def misreading(way: Way, problem: Problem, index: int, before: tuple[float, float],
               after: tuple[float, float], left: Left) -> Misreading:
    """Return a way in words.

    Args:
        way: that is told.
        problem: machine and data as they were read.
        index: of the data set.
        before: median misses of positions, m, and rotations, rad, as it was read.
        after: in this way.
        left: what it leaves.
    """
    data = problem.datasets[index]
    block = None if way.reading is None else read_block(way.reading, problem.mechanism, data)
    sigma = {} if way.reading is None else other_sigma(way.reading, data, left.fitted)
    return Misreading(data.source, way.mistakes, block, *_telling(before, after), left.noise, sigma)


def _telling(before: tuple[float, float], after: tuple[float, float]) -> tuple[str, float, float]:
    """Return the quantity whose miss falls most, of positions and rotations, before and after."""
    falls = [b / max(a, 1e-300) for b, a in zip(before, after, strict=True)]
    turned = falls[1] > 2.0 * falls[0] or not np.isfinite(after[0])
    return "angle" if turned else "length", before[turned], after[turned]


def few_rows(problem: Problem) -> Problem:
    """Return a problem of at most so many rows as a short fit has."""
    keep = subsample([np.ones(len(d), dtype=bool) for d in problem.datasets], TRIAL_ROWS)
    datasets = tuple(d.take(np.flatnonzero(k)) if k.any() else d
                     for d, k in zip(problem.datasets, keep, strict=True))
    return replace(problem, datasets=datasets, given=None, earlier=None)


def medians(problem: Problem, state: State) -> tuple[float, float]:
    """Return the median miss of positions, m, and rotations, rad; nan where not measured."""
    out: dict[bool, list[float]] = {False: [], True: []}
    for rows in problem.rows(state, False):
        places = np.array(coordinates(problem.datasets[rows.dataset], problem.mechanism.motion))
        for turn in out:
            raw = np.where(rows.observed, rows.raw, 0.0)[:, (places >= 3) == turn]
            if raw.shape[1]:
                out[turn] += np.linalg.norm(raw, axis=1).tolist()
    position, rotation = (float(np.median(v)) if v else float("nan") for v in out.values())
    return position, rotation


def after_short_fit(problem: Problem, state: State, keep: Sequence[Bools]) -> State:
    """Return where a short robust fit ends."""
    prior = prior_weights(problem, "prior")

    def weigh(at: State) -> Sequence[Array]:
        return huber_weights(problem, at, keep)

    return least_squares(problem, state, keep, prior, TRIAL_ITERATIONS, weigh).state
