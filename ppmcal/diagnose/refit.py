"""Fits that start where a fit of the same measurements ended."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ppmcal.calibration.fit import Fit, Options
from ppmcal.calibration.identify import identify
from ppmcal.calibration.problem import Problem, State
from ppmcal.linalg import Bools, known
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism


def with_mechanism(fit: Fit, mechanism: Mechanism, options: Options) -> Fit:
    """Fit a machine with further effects, or slots freed, to the rows of ``fit``.

    Args:
        fit: of the machine without them.
        mechanism: with them, started at their estimates; its parameters begin with those of
            the fitted machine.
        options: of the fit.

    Raises:
        BadInput, NoResult: as :func:`ppmcal.calibration.identify.identify`.
    """
    problem = replace(fit.problem, mechanism=mechanism, free=mechanism.free)
    old = fit.problem.mechanism
    g = mechanism.values.copy()
    kept = [p for p, name in enumerate(old.names)
            if mechanism.names[p] == name and mechanism.parameters[p].value
            == old.parameters[p].value]
    g[kept] = fit.state.g[kept]
    return _near(problem, State(g, fit.state.stations, fit.state.poses), options)


def of_rows(fit: Fit, rows: Sequence[Bools], options: Options) -> Fit:
    """Fit the same machine to some rows (N,) of each data set."""
    datasets: tuple[Dataset, ...] = tuple(
        d.take(r) for d, r in zip(fit.problem.datasets, rows, strict=True))
    about = tuple(o.about for o in fit.problem.opens)
    problem = replace(fit.problem, datasets=datasets, pivots=about)
    poses = tuple(p[r] for p, r in zip(fit.state.poses, rows, strict=True))
    return _near(problem, replace(fit.state, poses=poses), options)


def _near(problem: Problem, state: State, options: Options) -> Fit:
    """Fit from a state near by, or from scratch where rows get lost on the way."""
    start = problem.solve(state)
    lost = any((known(old) & ~known(new)).any()
               for old, new in zip(state.poses, start.poses, strict=True))
    if lost:
        return identify(replace(problem, pivots=None), options)
    return identify(problem, options, start=start, near=True)
