"""A campaign as a linear regression: what any method of model selection needs, as plain arrays.

The nominal fit of the machine's geometry to all readings, without any prior or robust weights;
what it leaves; and what every effect that the machine could have would add there, from the tool's
own derivatives. Values n, geometry r, columns T; everything over the stated noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.stats import f as fisher

import ppmcal
from labelled.score import Name
from labelled.sources import Files
from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import System, build, range_basis
from ppmcal.diagnosis.recorded import with_whole_rows
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset

VISIBLE = 1e-3
"""Effects of which geometry leaves less than this part are not asked for."""
RIDGE = 1e-9
GROSS = 0.01
"""Chance that any reading of a campaign that is in order is called one that does not belong."""


@dataclass(frozen=True)
class Candidate:
    """One cause that could be named, and its columns (k,) in the problem's matrix."""

    kind: str
    columns: tuple[int, ...]
    on: tuple[str, ...] = ()
    slot: str = ""
    rows: tuple[int, ...] = ()

    def name(self, probability: float = 1.0) -> Name:
        """Return it as a name of an answer."""
        return Name(self.kind, self.on, self.slot, self.rows, probability)


@dataclass(frozen=True, eq=False)
class LinearProblem:
    """Residuals of a nominal fit and what could be in them.

    Attributes:
        residual: (n,). geometry: derivatives of what is fitted (n, c).
        matrix: columns of all candidates (n, T); candidates.
        reading: which of the campaign's readings a value belongs to, from 0 on (n,).
        group: the commanded pose of each value (n,): repeats belong together.
        inputs: joint values, place, direction of travel, time, temperature, order, by name (n,).
        coordinate: which of a reading's coordinates a value is (n,).
    """

    residual: Array
    geometry: Array
    matrix: Array
    candidates: tuple[Candidate, ...]
    reading: Ints
    group: Ints
    inputs: Mapping[str, Array]
    coordinate: Ints

    @cached_property
    def basis(self) -> Array:
        """What the geometry takes (n, r), orthonormal."""
        return span(self.geometry)

    def rows(self) -> tuple[Array, tuple[Candidate, ...]]:
        """Return unit columns (n, n) and a candidate for each reading that does not belong."""
        return np.eye(self.residual.size), tuple(
            Candidate("row", tuple(np.flatnonzero(self.reading == k).tolist()), rows=(int(k) + 1,))
            for k in np.unique(self.reading))

    def take(self, keep: Array) -> LinearProblem:
        """Return the problem of some values (n,) only."""
        return LinearProblem(
            self.residual[keep], self.geometry[keep], self.matrix[keep], self.candidates,
            self.reading[keep], self.group[keep], {k: v[keep] for k, v in self.inputs.items()},
            self.coordinate[keep])


def span(matrix: Array) -> Array:
    """Return an orthonormal basis (n, r) of a matrix's columns, whatever their units."""
    length = np.linalg.norm(matrix, axis=0)
    return range_basis(matrix[:, length > 0.0] / length[length > 0.0])


def without(values: Array, basis: Array) -> Array:
    """Return values (n, ...) without what an orthonormal basis spans."""
    return values - basis @ (basis.T @ values)


def gains(matrix: Array, residual: Array, candidates: Sequence[Candidate]) -> Array:
    """Return by how much each candidate lowers the sum of squares (G,).

    ``matrix`` (n, T) and ``residual`` (n,) are without what is in the model already.
    """
    inner = matrix.T @ residual
    out = np.zeros(len(candidates))
    for size in {len(c.columns) for c in candidates}:
        some = [g for g, c in enumerate(candidates) if len(c.columns) == size]
        at = np.array([candidates[g].columns for g in some])
        if size == 1:
            square = np.einsum("nt,nt->t", matrix, matrix)[at[:, 0]]
            out[some] = np.where(square > VISIBLE**2, inner[at[:, 0]] ** 2
                                 / np.maximum(square, VISIBLE**2), 0.0)
            continue
        gram = np.array([matrix[:, a].T @ matrix[:, a] for a in at])
        gram += (RIDGE + VISIBLE**2) * np.eye(size)
        out[some] = np.einsum("gk,gk->g", inner[at], np.linalg.solve(
            gram, inner[at][..., None])[..., 0])
    return out


def gross_readings(problem: LinearProblem) -> tuple[LinearProblem, tuple[Name, ...]]:
    """Return the problem without readings that do not belong, and these as names.

    The deletion test of outliers, one at a time: a reading has columns of its own, its F-test at
    :data:`GROSS` over all readings (Cook, Weisberg, Residuals and Influence in Regression, 1982).
    """
    gone: list[Name] = []
    most = np.unique(problem.reading).size // 4
    while len(gone) < most:
        units, rows = problem.rows()
        residual = without(problem.residual, problem.basis)
        gain = gains(without(units, problem.basis), residual, rows)
        size = np.array([len(r.columns) for r in rows])
        left = residual.size - problem.basis.shape[1] - size
        square = float(residual @ residual)
        chance = np.ones(len(rows))
        able = (left > 1) & (gain > 0.0)
        ratio = gain / size / np.maximum(square - gain, 1e-15 * square) * left
        chance[able] = fisher.sf(ratio[able], size[able], left[able])
        worst = int(np.argmin(chance))
        if chance[worst] * len(rows) > GROSS:
            break
        gone.append(rows[worst].name())
        problem = problem.take(problem.reading != rows[worst].rows[0] - 1)
    return problem, tuple(gone)


def linear_problem(files: Files) -> LinearProblem:
    """Return the linear problem of a case's files.

    Raises:
        BadInput, NoResult: as the fit of the geometry.
    """
    machine = ppmcal.load(files.mechanism)
    found = ppmcal.read_data(machine, *files.tables)
    data = tuple(found) if isinstance(found, list | tuple) else (found,)
    problem = with_whole_rows(Problem(machine, data, machine.free))
    fit = identify(problem, FitOptions(method="flat", robust=False))
    system = build(fit.problem, fit.state, fit.keep)
    seen = system.observed.reshape(-1)
    tried = library(system)
    matrix = tried.columns.reshape(seen.size, -1)[seen]
    jacobian = system.jacobian.reshape(seen.size, -1)[seen]
    width = system.observed.shape[1]
    reading = np.repeat(_numbers(system, data), width)[seen]
    basis = span(jacobian)
    length = np.linalg.norm(matrix, axis=0)
    matrix = without(matrix / np.where(length > 0.0, length, 1.0), basis)
    candidates = tuple(_candidate(h) for h in tried.hypotheses if not h.anonymous
                       and np.linalg.norm(matrix[:, list(h.columns)]) > VISIBLE)
    return LinearProblem(
        without(system.residual.reshape(-1)[seen], basis), jacobian, matrix, candidates, reading,
        np.repeat(system.group, width)[seen],
        {k: np.repeat(v, width)[seen] for k, v in _inputs(system).items()},
        np.tile(np.arange(width), len(system.residual))[seen])


def _candidate(h: Hypothesis) -> Candidate:
    start = [int(v) for n, v in h.constants.items() if n == "from_row"]
    return Candidate(h.kind, h.columns, h.on, h.slot, tuple(start))


def _numbers(system: System, data: Sequence[Dataset]) -> Ints:
    """Return the reading of each row, counted through all files (N,)."""
    begin = np.cumsum([0, *(len(d) for d in data)])
    return np.asarray(begin[system.dataset] + system.row)


def _inputs(system: System) -> dict[str, Array]:
    """Return what residuals may go with, row by row: constant and unrecorded ones left out."""
    parts = system.firsts
    mechanism = system.problem.mechanism
    rows = [p.response.rows for p in parts]
    out = {f"joint {a}": np.concatenate([p.setting.travel[:, i] for p in parts])
           for i, a in enumerate(mechanism.actuators)}
    place = np.concatenate([p.response.seen.points[p.response.end] for p in parts])
    out |= {f"place {n}": place[:, i] for i, n in enumerate("xyz")}
    out |= {f"direction {a}": np.concatenate([r.approach[:, i] for r in rows])
            for i, a in enumerate(mechanism.actuators)}
    out |= {name: np.concatenate([getattr(r, name) for r in rows])
            for name in ("time", "temperature")}
    out["order"] = np.concatenate([r.row for r in rows]).astype(float)
    return {k: v for k, v in out.items()
            if np.isfinite(v).all() and np.ptp(v) > 1e-9 * np.abs(v).max()}
