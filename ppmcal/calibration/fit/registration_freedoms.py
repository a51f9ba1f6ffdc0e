"""Registration freedoms beyond those that the files open, and whether the data need them.

An instrument that was moved, a body that was redefined, a machine that was homed again between
files: what the sidecars keep closed is opened, the most probable first, as long as something surely
has to be open and the error falls by enough to matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit.added_columns import Group, added_columns
from ppmcal.calibration.fit.fit_result import Fit, values_fitted
from ppmcal.calibration.fit.gauss_newton import least_squares, linearised
from ppmcal.calibration.fit.linearisation import prior_weights
from ppmcal.calibration.fit.observation import coordinates
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.inference.blocks import Block, batches
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.evidence import BatchOdds, total
from ppmcal.inference.given import Conditioned
from ppmcal.inference.priors import MOVED, SURE, SURE_ODDS
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import REGISTERED
from ppmcal.notes import Note
from ppmcal.wording.progress import stage

FIELDS = {"frame": "frame", "target": "target", "rotation": "target_rotation"}
REMEDIES = {"frame": "frame: unknown", "target": "target: unknown",
            "rotation": "target_rotation: unknown", "homing": "homing: per-file",
            "sessions": "frame: unknown"}
WORTH = 0.05
"""Freedoms beyond those in the files are fitted if the error falls by this part."""
SESSIONS = "sessions"
FEWEST = 4
"""Fewest rows of a session that may have a frame of its own."""
ITERATIONS = 15
MOST_HINTS = 3
MANY_OUT = 0.02
"""If more than this part of a file's rows was left out, they count again: the fit may have rejected
exactly those with another registration."""


@dataclass(frozen=True, eq=False)
class RegistrationHint:
    """Something closed that the data need open.

    ``dataset``: its index; ``what``: of :data:`REGISTERED`, or ``sessions``; ``before``,
    ``after``: rms of the data set's white residuals; ``position``: rms of its positions before
    and after, m; ``square``, ``count``, ``fitted``: sum of white squares of all rows, number of
    values, and number of these that the fit absorbs, with it open; ``keep``: the rows behind
    these; ``opened``: the problem with it open; ``instead``: the alternatives (data set and part)
    that with it make up 95 % of the probability.
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
    instead: tuple[tuple[int, str], ...] = ()

    @property
    def remedy(self) -> str:
        """What to write into the sidecar."""
        return REMEDIES[self.what]


def is_open(data: Dataset, what: str) -> bool:
    """Whether a data set's registration already fits ``what`` of :data:`REGISTERED`."""
    return data.homing != "shared" if what == "homing" else bool(
        getattr(data, FIELDS[what]).fitted)


def opened(data: Dataset, what: Sequence[str], only: bool = False) -> Dataset:
    """Return a data set whose registration fits ``what``, with ``only`` nothing else."""
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


def significant_improvement(before: float, after: float) -> float:
    """Return the part by which the error falls between two sums of squares, 0 if too little."""
    part = 1.0 - float(np.sqrt(max(after, 0.0) / before)) if before > 0.0 else 0.0
    return part if part > WORTH else 0.0


def surely(log_odds: float | Array) -> bool:
    """Whether an effect, or one of several, is present, by the odds against none."""
    return bool(linalg.logsumexp(log_odds) > np.log(SURE_ODDS))


def odds_of_opening(problem: Problem, state: State, keep: Sequence[Bools], prior: Array,
                    feasible: Sequence[tuple[int, str]]) -> Array:
    """Return the log odds (P,) of opening each candidate against opening nothing, with prior.

    Args:
        problem: with everything that is open anyway.
        state: of its fit.
        keep: rows in use.
        prior: weight of each of its columns (C,).
        feasible: candidates: data set and part, of :data:`REGISTERED` or ``sessions``.
    """
    words = [["frame" if w == SESSIONS else w for j, w in feasible if j == i]
             for i in range(len(problem.datasets))]
    wide = problem.changed(datasets=tuple(
        opened(d, w) for d, w in zip(problem.datasets, words, strict=True)))
    groups, columns, end = list[Group](), list[tuple[int, ...]](), 0
    for i, what in feasible:
        at = getattr(wide.opens[i], {SESSIONS: "frame", **FIELDS}.get(what, what))
        masks = _sessions_of(problem.datasets[i])[1:] if what == SESSIONS else [
            np.ones(len(problem.datasets[i]), dtype=bool)]
        groups += [{i: (at, mask)} for mask in masks]
        columns.append(tuple(range(end, end := end + len(masks) * (at.stop - at.start))))
    rows = added_columns(problem, state, keep, prior, wide, groups)
    given = Conditioned.nothing(MatrixColumns(rows.added), rows.values, rows.count).taking(
        rows.geometry)
    blocks = [Block(what, what, own, 0.0) for (_, what), own in zip(feasible, columns, strict=True)]
    out = np.full(len(blocks), np.log(float(MOVED)))
    for batch in batches(blocks, given.columns, given.count):
        out[batch.which] += total(BatchOdds.of(given, batch).free)
    return out


@stage("trying other registrations")
def registration_hints(fit: Fit) -> tuple[RegistrationHint, ...]:
    """Return what files keep closed and the data need open, best first.

    A score test with the geometry free decides what is worth a fit; that fit decides what is
    reported. Each hint is judged with the previous ones open: of two files that disagree, one
    is enough.
    """
    keep, problem = _with_outliers(fit), fit.problem
    same = all((k == own).all() for k, own in zip(keep, fit.keep, strict=True))
    state = fit.state if same else _refitted(problem, fit.state, keep, fit.prior)
    hints = list[RegistrationHint]()
    while state is not None and len(hints) < MOST_HINTS:
        best = _hint(fit, problem, state, keep)
        if best is None:
            break
        hints.append(best[0])
        problem, state = best[0].opened, best[1]
        if best[0].what == SESSIONS:
            break
    return tuple(hints)


def _hint(fit: Fit, problem: Problem, state: State, keep: Sequence[Bools]
          ) -> tuple[RegistrationHint, State] | None:
    """Return the candidate most likely open and the state with it; None if none surely is."""
    prior, feasible = _padded(problem, fit), _possible(problem, keep)
    odds = odds_of_opening(problem, state, keep, prior, feasible)
    if not feasible or not surely(odds):
        return None
    order = np.argsort(-odds, kind="stable")
    more = np.cumsum(np.exp(odds[order] - linalg.logsumexp(odds))) < float(SURE)
    (i, what), *instead = [feasible[n] for n in order[:int(more.sum()) + 1].tolist()]
    wider, there, rows = _opened(problem, state, keep, i, what)
    prior = _padded(wider, fit)
    after = _refitted(wider, there, rows, prior)
    if after is None:
        return None
    square, own = _squares(problem, state, keep), _squares(wider, after, rows)
    total, values = own.sum(axis=0)[:2].tolist()
    if not significant_improvement(float(square[:, 0].sum()), total):
        return None
    ends = np.stack([square[i], own[i:i + len(own) - len(square) + 1].sum(axis=0)])
    white, place = np.sqrt(ends[:, ::2] / np.maximum(ends[:, 1::2], 1.0)).T.tolist()
    now = linearised(wider, after, rows, prior)
    fitted = values_fitted(*now.small.seen(), prior)
    return RegistrationHint(i, what, white[0], white[1], (place[0], place[1]), total, values,
                            fitted, tuple(keep), wider, tuple(instead)), after


def _with_outliers(fit: Fit) -> list[Bools]:
    out = []
    for keep, gone in zip(fit.keep, fit.outliers, strict=True):
        many = gone.sum() > MANY_OUT * max(int((keep | gone).sum()), 1)
        out.append(keep | gone if many else keep.copy())
    return out


def _padded(problem: Problem, fit: Fit) -> Array:
    """Return the fit's prior for the columns (C,) of a problem with more open."""
    prior, count = prior_weights(problem, "prior"), len(problem.free)
    prior[:count] = fit.prior[:count]
    return prior


def _possible(problem: Problem, keep: Sequence[Bools]) -> list[tuple[int, str]]:
    """Return the candidates for opening: data set and part."""
    out = list[tuple[int, str]]()
    for i, data in enumerate(problem.datasets):
        if data.kind.scalar or not data.kind.of_poses:
            continue
        shared = data.frame.same_as is not None
        turns = data.kind.sees_rotation and problem.mechanism.motion.turns
        # the first file's zeros are the reference for the others
        able = {"frame": True, "target": True, "rotation": turns, "homing": i > 0}
        out += [(i, w) for w in REGISTERED if able[w] and (
            not is_open(data, w) or (w == "frame" and shared))]
        sizes = [int((m & keep[i]).sum()) for m in _sessions_of(data)]
        if len(sizes) > 1 and min(sizes) >= FEWEST:
            out.append((i, SESSIONS))
    return out


def _opened(problem: Problem, state: State, keep: Sequence[Bools], i: int, what: str
            ) -> tuple[Problem, State, list[Bools]]:
    """Return the problem with ``what`` of a data set open, its state and its rows."""
    if what == SESSIONS:
        return _by_session(problem, state, keep, i)
    datasets = tuple(opened(d, [what]) if j == i else d for j, d in enumerate(problem.datasets))
    return problem.changed(datasets=datasets), state, list(keep)


def _sessions_of(data: Dataset) -> list[Bools]:
    """Return the rows (N,) of each session of a file that names sessions."""
    return [np.array([s == label for s in data.sessions or ()])
            for label in dict.fromkeys(data.sessions or ())]


def _by_session(problem: Problem, state: State, keep: Sequence[Bools], i: int
                ) -> tuple[Problem, State, list[Bools]]:
    """Return the problem with a separate frame for each session of a file."""
    data = problem.datasets[i]
    labels, masks = list(dict.fromkeys(data.sessions or ())), _sessions_of(data)
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


def _refitted(problem: Problem, state: State, keep: Sequence[Bools], prior: Array
              ) -> State | None:
    """Return where a fit of these rows ends; None if it fails."""
    there = problem.solve(state)
    if any((k & ~finite_rows(p)).any() for k, p in zip(keep, there.poses, strict=True)):
        return None
    return least_squares(problem, there, keep, prior, ITERATIONS).state


def _squares(problem: Problem, state: State, keep: Sequence[Bools]) -> Array:
    """Return by data set (D, 4): white squares, number of values; position squares, m^2, rows."""
    out = np.zeros((len(problem.datasets), 4))
    for c in problem.rows(state, False, keep):
        data = problem.datasets[c.dataset]
        place = [j for j, k in enumerate(coordinates(data, problem.mechanism.motion)) if k < 3]
        raw = np.nan_to_num(c.measured)[:, place]
        out[c.dataset] += (*c.squares(), float(np.sum(raw**2)), len(raw))
    return out


CAUSES = {"frame": "the instrument was moved", "target": "the target was moved",
          "rotation": "the measured body was redefined", "homing": "the machine was homed again",
          SESSIONS: "the instrument was moved between sessions"}


def hint_words(fit: Fit, hint: RegistrationHint) -> str:
    """Return the remedy and where it goes: ``frame: unknown in day2.yaml``."""
    return _words(fit, hint.dataset, hint.what)


def _words(fit: Fit, dataset: int, what: str) -> str:
    place = Path(fit.problem.datasets[dataset].source).with_suffix(".yaml").name
    return f"{REMEDIES[what]} in " + (f"each session's own {place}" if what == SESSIONS else place)


def hint_sentences(fit: Fit, hints: Sequence[RegistrationHint]) -> list[Note]:
    """Return a note for each hint, with figures and remedy."""
    units, out = fit.problem.mechanism.units, []
    for h in hints:
        data = fit.problem.datasets[h.dataset]
        was, now = (v / units.factor("length") for v in h.position)
        also = "".join(f", or `{_words(fit, *other)}`" for other in h.instead)
        fall = f"{h.before:.3g} to {h.after:.3g} times the noise"
        # joint values alone, and tilts, have no positions
        whole = (f"its error from {was:.3g} to {now:.3g} {units.length} rms ({fall})" if was > 0.0
                 else f"its residuals from {fall}")
        out.append(Note(f"{data.name}: `{hint_words(fit, h)}` reduces {whole}: perhaps "
                        f"{CAUSES[h.what]}{also}", topic="registration"))
    return out
