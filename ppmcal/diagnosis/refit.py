"""Fits that start from the result of a fit of the same measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ppmcal.calibration.fit import Fit, FitOptions, Problem, State, bounded, identify
from ppmcal.linalg import Bools, finite_rows
from ppmcal.model.mechanism import Mechanism

NEAR = 30
"""Maximum iterations of a fit that starts from the result of a fit of the same measurements."""
MOST_STEPS = 300
"""Steps that all fits of such a refit may take together, including those that leave rows out."""


def with_mechanism(fit: Fit, mechanism: Mechanism, options: FitOptions) -> Fit:
    """Fit a machine with further effects, or slots freed, to the rows of ``fit``.

    A constant that leaves its meaningful range is held at its start until the others are found; if
    it leaves the range again from there, it is not identifiable and stays held.

    Args:
        fit: of the machine without them.
        mechanism: with them, starting at their estimates; its first parameters are those of the
            fitted machine.
        options: of the fit.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.fit.identify`.
    """
    problem, start = started(fit, mechanism)
    found = near(problem, start, options)
    held = set[int]()
    while gone := _lost(found):
        g = found.state.g.copy()
        g[gone] = start.g[gone]
        without = near(_holding(found.problem, gone), replace(found.state, g=g), options)
        again = without if held & set(gone) else near(found.problem, without.state, options)
        found = without if _lost(again) else again
        held.update(gone)
    return found


def _holding(problem: Problem, held: Sequence[int]) -> Problem:
    """Return a problem in which some parameters are held."""
    parameters = list(problem.mechanism.parameters)
    for p in held:
        parameters[p] = replace(parameters[p], free=False)
    free = tuple(p for p in problem.free if p not in held)
    mechanism = replace(problem.mechanism, parameters=tuple(parameters), free=free)
    return replace(problem, mechanism=mechanism, free=free)


def outside(problem: Problem, state: State) -> list[int]:
    """Return the free parameters of effects that are outside their physical range."""
    mechanism = problem.mechanism
    return [p for e in mechanism.effects for spec in e.kind.parameters(mechanism.motion)
            if (p := e.parameters[spec.name]) in problem.free
            and not spec.low <= state.g[p] <= spec.high]


def _lost(fit: Fit) -> list[int]:
    """Return those that are meaningless outside: constants, not sizes."""
    return [p for p in outside(fit.problem, fit.state)
            if fit.problem.mechanism.parameters[p].nonlinear]


def started(fit: Fit, mechanism: Mechanism) -> tuple[Problem, State]:
    """Return the problem of such a machine and the start of its fit, with the poses of ``fit``."""
    problem = replace(fit.problem, mechanism=mechanism, free=mechanism.free)
    old = fit.problem.mechanism
    g = mechanism.values.copy()
    kept = [p for p, name in enumerate(old.names)
            if mechanism.names[p] == name and mechanism.parameters[p].value
            == old.parameters[p].value]
    g[kept] = fit.state.g[kept]
    return problem, State(g, fit.state.registrations, fit.state.poses)


def of_rows(fit: Fit, rows: Sequence[Bools], options: FitOptions) -> Fit:
    """Fit the same machine to some rows (N,) of each data set."""
    problem = fit.problem.changed(datasets=tuple(
        d.take(r) for d, r in zip(fit.problem.datasets, rows, strict=True)))
    poses = tuple(p[r] for p, r in zip(fit.state.poses, rows, strict=True))
    return near(problem, replace(fit.state, poses=poses), options)


def near(problem: Problem, state: State, options: FitOptions) -> Fit:
    """Fit from a nearby state, or from scratch if rows get lost on the way.

    A fit that has not converged after :data:`NEAR` iterations drifts along a valley; it is stopped
    at the state reached, and the findings say so.
    """
    options = replace(options, iterations=min(options.most, NEAR))
    start = problem.solve(state)
    lost = any((finite_rows(old) & ~finite_rows(new)).any()
               for old, new in zip(state.poses, start.poses, strict=True))
    with bounded(MOST_STEPS):
        if lost:
            return identify(replace(problem, pivots=None), options)
        return identify(problem, options, start=start, near=True)
