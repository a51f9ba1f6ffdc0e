"""A sample-split test: one half of the poses chooses, the other says whether it is there.

As a localised sparse discovery of discrepancy confirms its terms (Wang, arXiv 2606.23215): first
readings that a fit of the other half predicts otherwise are put aside, then the term that helps
most in one half is tested in the other, geometry fitted with it, by an F-test of one hypothesis
that needs no correction for the search.
"""

from __future__ import annotations

import numpy as np
from scipy.stats import f as fisher
from scipy.stats import t as student

from labelled.linear import Candidate, LinearProblem, gains, span, without
from labelled.score import Name
from ppmcal.linalg import Array, Bools

LEVEL = 0.01
"""Chance of a false confirmation in each test."""
MOST = 6


def names(problem: LinearProblem, seed: int) -> tuple[tuple[Name, ...], float]:
    """Return gross readings and confirmed terms. It has no word for the unknown."""
    first = halves(problem, seed)
    gone = gross(problem, first)
    stay = ~np.isin(problem.reading, gone)
    problem, first = problem.take(stay), first[stay]
    found: list[Candidate] = []
    while len(found) < MOST:
        best = _chosen(problem, first, found)
        if best is None or _p_value(problem, ~first, found, best) > LEVEL:
            break
        found.append(best)
    rows = tuple(Name("row", rows=(k + 1,)) for k in gone)
    return (*rows, *(c.name() for c in found)), 0.0


def halves(problem: LinearProblem, seed: int) -> Bools:
    """Return which values are of the half that chooses (n,): whole poses, by the seed."""
    order = np.random.default_rng(seed).permutation(np.unique(problem.group))
    return np.isin(problem.group, order[::2])


def gross(problem: LinearProblem, first: Bools) -> list[int]:
    """Return readings, from 0 on, that the other half predicts otherwise, one at a time."""
    gone: list[int] = []
    while len(gone) < np.unique(problem.reading).size // 4:
        stay = ~np.isin(problem.reading, gone)
        worst = [w for half in (first & stay, ~first & stay)
                 if (w := _worst(problem, half, stay & ~half)) is not None]
        if not worst or min(worst)[0] > LEVEL:
            break
        gone.append(min(worst)[1])
    return gone


def _worst(problem: LinearProblem, fit: Bools, test: Bools) -> tuple[float, int] | None:
    """Return chance and number of the reading of one half that the other predicts worst."""
    u, s, v = np.linalg.svd(_scaled(problem.geometry)[fit], full_matrices=False)
    kept = s > 1e-9 * s[:1].max(initial=0.0)
    u, s, v = u[:, kept], s[kept], v[kept]
    free = int(fit.sum()) - s.size
    if free < 2 or not test.any():
        return None
    own = problem.residual[fit]
    along = u.T @ own
    noise = float(np.sqrt(max(own @ own - along @ along, np.finfo(float).tiny) / free))
    carried = _scaled(problem.geometry)[test] @ v.T / s
    away = (problem.residual[test] - carried @ along) / (
        noise * np.sqrt(1.0 + np.sum(carried**2, axis=1)))
    at = int(np.argmax(np.abs(away)))
    chance = 2.0 * student.sf(abs(away[at]), free) * away.size
    return float(chance), int(problem.reading[test][at])


def _scaled(geometry: Array) -> Array:
    length = np.linalg.norm(geometry, axis=0)
    return geometry / np.where(length > 0.0, length, 1.0)


def _chosen(problem: LinearProblem, half: Bools, found: list[Candidate]) -> Candidate | None:
    """Return the candidate that lowers the sum of squares of one half most, by its F."""
    own = problem.take(half)
    basis = _model(own, found)
    rest = without(own.residual, basis)
    matrix = without(own.matrix, basis)
    square, left = float(rest @ rest), own.residual.size - basis.shape[1]
    sizes = np.array([len(c.columns) for c in own.candidates])
    if not sizes.size or not (left - sizes > 1).any():
        return None
    gain = np.where(left - sizes > 1, gains(matrix, rest, own.candidates), 0.0)
    if not gain.any():
        return None
    ratio = gain / sizes / np.maximum(square - gain, 1e-12 * square) * np.maximum(left - sizes, 1)
    chance = fisher.logsf(ratio, sizes, np.maximum(left - sizes, 1))
    return own.candidates[int(np.argmin(chance))]


def _p_value(problem: LinearProblem, half: Bools, found: list[Candidate], one: Candidate) -> float:
    """Return the chance of what one candidate explains in the other half, if it is not there."""
    own = problem.take(half)
    basis, more = _model(own, found), _model(own, [*found, one])
    before, after = without(own.residual, basis), without(own.residual, more)
    size, left = more.shape[1] - basis.shape[1], own.residual.size - more.shape[1]
    if size < 1 or left < 1:
        return 1.0
    square = max(float(after @ after), np.finfo(float).tiny)
    return float(fisher.sf((float(before @ before) - square) / size / (square / left), size, left))


def _model(problem: LinearProblem, found: list[Candidate]) -> Array:
    columns = list(dict.fromkeys(c for one in found for c in one.columns))
    whole = np.concatenate([problem.geometry, problem.matrix[:, columns]], axis=1)
    return span(whole) if whole.shape[1] else np.zeros((problem.residual.size, 0))
