"""Stepwise selection by the Bayesian information criterion: forward, then backward.

Schwarz, Annals of Statistics 6 (1978); noise unknown. Readings that do not belong are put aside
before by a test of their own: the criterion, which takes no account of how many candidates there
were, would call some reading of every campaign one.
"""

from __future__ import annotations

import numpy as np

from labelled.linear import Candidate, LinearProblem, gains, gross_readings, span, without
from labelled.score import Name
from ppmcal.linalg import Array

MOST = 6
"""Candidates in a model, as many as the tool's own search names."""
LEAST = 1e-12
"""A sum of squares is not below this part of that of the residuals: round-off."""


def names(problem: LinearProblem, seed: int) -> tuple[tuple[Name, ...], float]:
    """Return what the criterion chooses. It has no word for the unknown."""
    problem, gone = gross_readings(problem)
    return (*gone, *(c.name() for c in chosen(problem))), 0.0


def chosen(problem: LinearProblem) -> list[Candidate]:
    """Return the candidates in the model of the lowest criterion that steps come to."""
    every = problem.candidates
    matrix = without(problem.matrix, problem.basis)
    residual = without(problem.residual, problem.basis)
    free = residual.size - problem.basis.shape[1]
    floor = LEAST * float(residual @ residual)
    model: list[Candidate] = []
    best = _criterion(float(residual @ residual), free, 0, floor)
    while len(model) < MOST:
        taken = span(matrix[:, _columns(model)]) if model else np.zeros((residual.size, 0))
        rest = without(residual, taken)
        left = gains(without(matrix, taken), rest, every)
        size = taken.shape[1]
        scores = np.array([
            _criterion(float(rest @ rest) - gain, free, size + len(c.columns), floor)
            for gain, c in zip(left, every, strict=True)])
        at = int(np.argmin(scores)) if scores.size else -1
        if at < 0 or scores[at] >= best:
            break
        model.append(every[at])
        best = float(scores[at])
    return _pruned(matrix, residual, free, model, floor)


def _pruned(matrix: Array, residual: Array, free: int, model: list[Candidate], floor: float
            ) -> list[Candidate]:
    """Return the model without what no longer lowers the criterion."""
    def criterion(some: list[Candidate]) -> float:
        taken = span(matrix[:, _columns(some)]) if some else np.zeros((residual.size, 0))
        rest = without(residual, taken)
        return _criterion(float(rest @ rest), free, taken.shape[1], floor)

    while model:
        now = criterion(model)
        fewer = [[c for c in model if c is not one] for one in model]
        best = min(fewer, key=criterion)
        if criterion(best) >= now:
            break
        model = best
    return model


def _columns(model: list[Candidate]) -> list[int]:
    return list(dict.fromkeys(c for one in model for c in one.columns))


def _criterion(square: float, free: int, size: int, floor: float) -> float:
    """Return n log(RSS/n) + k log n over the values that geometry leaves; inf with none left."""
    if free - size < 2:
        return np.inf
    return free * float(np.log(max(square, floor, np.finfo(float).tiny) / free)) + size * float(
        np.log(free))
