"""What a registration may fit beyond what the files say, and whether data ask for it.

An instrument that was moved, a body that was defined anew, a machine that was homed anew between
files: what the sidecars keep closed is opened, one thing at a time, and counts where the error
falls by more than chance explains and by enough to matter.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import chdtrc

from ppmcal.calibration.fit.fit_result import Fit, values_fitted
from ppmcal.calibration.fit.gauss_newton import least_squares, linearised, prior_square
from ppmcal.calibration.fit.linearisation import prior_weights
from ppmcal.calibration.fit.observation import coordinates
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import SCALARS
from ppmcal.wording.progress import stage

OPEN = ("frame", "target", "rotation", "homing")
"""What a registration may fit, simplest first."""
OPENED = {"position": ("frame", "target", "homing"), "plane": ("frame",), "distance": ()}
"""What of it the data of an instrument can demand: of a flat its height and tilt say the rest."""
FIELDS = {"frame": "frame", "target": "target", "rotation": "target_rotation"}
MENDS = {"frame": "frame: unknown", "target": "target: unknown",
         "rotation": "target_rotation: unknown", "homing": "homing: per-file",
         "sessions": "frame: unknown"}
DEMANDED = 1e-3
"""More than a file leaves open is fitted where chance would gain as much this rarely,"""
WORTH = 0.05
"""and the error falls by this part."""
SESSIONS = "sessions"
FEWEST = 4
"""Rows of the shortest session that may have a frame of its own."""
ITERATIONS = 15
MOST_HINTS = 3
MANY_OUT = 0.02
"""Where more rows than this part of a file were left out they count again: the fit may have thrown
out just those that were registered otherwise."""


@dataclass(frozen=True, eq=False)
class RegistrationHint:
    """Something kept closed that the data ask to be open.

    ``dataset``: its index; ``what``: of :data:`OPEN`, or ``sessions``; ``before``, ``after``: rms
    of the data set's white residuals; ``position``: of its positions before and after, m;
    ``square``, ``count``, ``fitted``: sum of white squares of
    all rows, how many values they have and how many of these the fit takes, with it open; ``keep``:
    the rows behind these; ``opened``: the problem that has it open.
    """

    dataset: int
    what: str
    before: float
    after: float
    position: tuple[float, float]
    square: float
    count: float
    fitted: float
    keep: tuple[Bools, ...]
    opened: Problem

    @property
    def mend(self) -> str:
        """What to write into the sidecar."""
        return MENDS[self.what]


def is_open(data: Dataset, what: str) -> bool:
    """Whether a registration of a data set fits ``what`` of :data:`OPEN` already."""
    return data.homing != "shared" if what == "homing" else bool(
        getattr(data, FIELDS[what]).fitted)


def opened(data: Dataset, what: Sequence[str], only: bool = False) -> Dataset:
    """Return a data set of which the registration fits ``what``, and with ``only`` nothing else."""
    new = {}
    for word, name in FIELDS.items():
        unknown = getattr(data, name)
        if word in what and (not unknown.fitted or unknown.same_as):
            new[name] = replace(unknown, fitted=True, same_as=None)
        elif only and word not in what and unknown.fitted:
            new[name] = replace(unknown, fitted=False, same_as=None)
    homing = "alone" if "homing" in what else "shared" if only or data.homing == "shared" else (
        "alone")
    return replace(data, homing=homing, **new)


def fall(before: float, after: float, count: float, fitted: float, more: float) -> float:
    """Return by which part an error falls, 0 where that is too little or may be chance.

    Args:
        before: sum of white squares.
        after: the same with more open.
        count: values behind them.
        fitted: how many of them the fit takes after.
        more: by how many these are more than before.
    """
    freedom = count - fitted
    if more <= 0 or freedom <= 0 or before <= 0.0:
        return 0.0
    part = 1.0 - float(np.sqrt(max(after, 0.0) / before))
    scale = max(after / freedom, 1.0)
    chance = float(chdtrc(more, max(before - after, 0.0) / scale))
    return part if part > WORTH and chance < DEMANDED else 0.0


@stage("trying other registrations")
def registration_hints(fit: Fit) -> tuple[RegistrationHint, ...]:
    """Return what files keep closed and the data ask to be open, best first.

    A score test with the geometry free decides what is worth a fit; that fit, what is told. Each
    is judged with those before it open: of two files that disagree one is enough.
    """
    keep, problem = _with_outliers(fit), fit.problem
    same = all((k == own).all() for k, own in zip(keep, fit.keep, strict=True))
    state = fit.state if same else _refitted(problem, fit.state, keep, fit.prior)
    hints = list[RegistrationHint]()
    while state is not None and len(hints) < MOST_HINTS:
        best = max(_hints(fit, problem, state, keep), key=lambda h: h[0], default=None)
        if best is None:
            break
        hints.append(best[1])
        problem, state = best[1].opened, best[2]
        if best[1].what == SESSIONS:
            break
    return tuple(hints)


def _hints(fit: Fit, problem: Problem, state: State, keep: Sequence[Bools]
           ) -> Iterator[tuple[float, RegistrationHint, State]]:
    """Yield by which part an error falls, what has to be open for it, and the state then."""
    square = _squares(problem, state, keep)
    before = sum(square, _Sum())
    now = before.white + prior_square(problem, state, _padded(problem, fit))
    for i, what, wider, there, rows in _variants(problem, state, keep):
        prior, more = _padded(wider, fit), len(wider.columns) - len(problem.columns)
        expected, fitted = _expected(wider, there, rows, prior)
        if not fall(now, expected, before.values, fitted, more):
            continue
        after = _refitted(wider, there, rows, prior)
        if after is None:
            continue
        own = _squares(wider, after, rows)
        total = sum(own, _Sum())
        part = fall(before.white, total.white, total.values, fitted, more)
        ends = square[i], sum(own[i:i + len(own) - len(square) + 1], _Sum())
        white, place = ([float(np.sqrt(a / max(b, 1))) for a, b in pairs] for pairs in (
            [(e.white, e.values) for e in ends], [(e.place, e.rows) for e in ends]))
        if part:
            yield part, RegistrationHint(
                i, what, white[0], white[1], (place[0], place[1]), total.white, total.values,
                fitted, tuple(keep), wider), after


def _with_outliers(fit: Fit) -> list[Bools]:
    out = []
    for keep, gone in zip(fit.keep, fit.outliers, strict=True):
        many = gone.sum() > MANY_OUT * max(int((keep | gone).sum()), 1)
        out.append(keep | gone if many else keep.copy())
    return out


def _padded(problem: Problem, fit: Fit) -> Array:
    """Return the fit's prior of the columns (C,) of a problem with more open."""
    prior, count = prior_weights(problem, "prior"), len(problem.free)
    prior[:count] = fit.prior[:count]
    return prior


def _variants(problem: Problem, state: State, keep: Sequence[Bools]
              ) -> Iterator[tuple[int, str, Problem, State, list[Bools]]]:
    """Yield data set, what is opened, and the problem with it open, its state and its rows."""
    # the first file's zeros are those that others differ from
    about = tuple(o.about for o in problem.opens)
    several = len(problem.datasets) > 1
    for i, data in enumerate(problem.datasets):
        if data.kind in SCALARS:
            continue
        for what in OPEN:
            shared = what == "frame" and data.frame.same_as is not None
            if (is_open(data, what) and not shared) or (what == "rotation" and (
                    data.kind != "pose" or problem.mechanism.motion == "translational")) or (
                    what == "homing" and (not several or i == 0)):
                continue
            datasets = tuple(opened(d, [what]) if j == i else d
                             for j, d in enumerate(problem.datasets))
            yield i, what, replace(problem, datasets=datasets, pivots=about), state, list(keep)
        split = _by_session(problem, state, keep, i)
        if split is not None:
            yield (i, SESSIONS, *split)


def _by_session(problem: Problem, state: State, keep: Sequence[Bools], i: int
                ) -> tuple[Problem, State, list[Bools]] | None:
    """Return the problem with a frame of its own for each session of a file, None without."""
    data = problem.datasets[i]
    labels = list(dict.fromkeys(data.sessions or ()))
    masks = [np.array([s == label for s in data.sessions or ()]) for label in labels]
    if len(masks) < 2 or min(int((m & keep[i]).sum()) for m in masks) < FEWEST:
        return None
    parts = tuple(replace(opened(data.take(m), ["frame"]),
                          name=data.name if n == 0 else f"{data.name} {label}")
                  for n, (m, label) in enumerate(zip(masks, labels, strict=True)))

    def spread(values: Sequence[Any], own: Sequence[Any]) -> tuple[Any, ...]:
        return (*values[:i], *own, *values[i + 1:])

    new = replace(problem, datasets=spread(problem.datasets, parts),
                  pivots=spread([o.about for o in problem.opens],
                                [problem.opens[i].about] * len(parts)),
                  given=spread(problem.environments, [problem.environments[i].take(m)
                                                      for m in masks]))
    at = State(state.g, spread(state.registrations, [state.registrations[i]] * len(parts)),
               spread(state.poses, [state.poses[i][m] for m in masks]))
    return new, at, list(spread(list(keep), [keep[i][m] for m in masks]))


def _expected(problem: Problem, state: State, keep: Sequence[Bools], prior: Array
              ) -> tuple[float, float]:
    """Return the sum of squares of data and prior at the minimum of the linear problem.

    With it how many values a fit takes there.
    """
    now = linearised(problem, state, keep, prior)
    return (now.square + prior_square(problem, state, prior) - now.small.step()[1],
            values_fitted(*now.small.seen(), prior))


def _refitted(problem: Problem, state: State, keep: Sequence[Bools], prior: Array
              ) -> State | None:
    """Return where a fit of these rows ends; None where it gets lost."""
    there = problem.solve(state)
    if any((k & ~finite_rows(p)).any() for k, p in zip(keep, there.poses, strict=True)):
        return None
    return least_squares(problem, there, keep, prior, ITERATIONS).state


@dataclass(frozen=True)
class _Sum:
    """Sums of squares over a data set: white, of how many values; of positions, m^2, and rows."""

    white: float = 0.0
    values: float = 0
    place: float = 0.0
    rows: int = 0

    def __add__(self, other: _Sum) -> _Sum:
        return _Sum(self.white + other.white, self.values + other.values,
                    self.place + other.place, self.rows + other.rows)


def _squares(problem: Problem, state: State, keep: Sequence[Bools]) -> list[_Sum]:
    """Return the sums of squares by data set."""
    out = [_Sum()] * len(problem.datasets)
    for c in problem.rows(state, False, keep):
        data = problem.datasets[c.dataset]
        place = [j for j, k in enumerate(coordinates(data, problem.mechanism.motion)) if k < 3]
        raw = np.where(c.observed, c.raw, 0.0)[:, place]
        out[c.dataset] += _Sum(*c.squares(), float(np.sum(raw**2)), len(raw))
    return out


CAUSES = {"frame": "the instrument was moved", "target": "the target was moved",
          "rotation": "the measured body was defined anew", "homing": "the machine was homed anew",
          SESSIONS: "the instrument was moved between sessions"}


def hint_words(fit: Fit, hint: RegistrationHint) -> str:
    """Return the mend and where it goes: ``frame: unknown in day2.yaml``."""
    place = Path(fit.problem.datasets[hint.dataset].source).with_suffix(".yaml").name
    return f"{hint.mend} in " + (f"each session's own {place}" if hint.what == SESSIONS else place)


def hint_sentences(fit: Fit, hints: Sequence[RegistrationHint]) -> list[str]:
    """Return what to say of each hint, with figures and mend."""
    units, out = fit.problem.mechanism.units, []
    for h in hints:
        data = fit.problem.datasets[h.dataset]
        was, now = (v / units.factor("length") for v in h.position)
        out.append(f"{data.name}: `{hint_words(fit, h)}` takes its error from {was:.3g} to "
                   f"{now:.3g} {units.length} rms ({h.before:.3g} to {h.after:.3g} times the "
                   f"noise): {CAUSES[h.what]}, perhaps")
    return out
