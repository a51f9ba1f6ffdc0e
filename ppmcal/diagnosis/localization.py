"""Localisation of residuals: by actuator, direction, load, temperature, region and time.

This describes, it does not name causes: dq = J_q^+ r attributes a row's residual to joints,
whatever its cause. Every figure is compared with noise alone through the same projections.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Problem, Response
from ppmcal.diagnosis.linearisation import Linearisation
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array, Bools

DRAWS = 400


@dataclass(frozen=True)
class Place:
    """One group of residuals: rms over that of noise, and the probability of more by noise.

    ``rms_ratio_after``: for the same group with the effects, None if none of its rows is used.
    """

    by: str
    value: str
    rms_ratio: float
    p_value: float
    rms_ratio_after: float | None = None


def localise(before: Linearisation, after: Linearisation, seed: int) -> tuple[Place, ...]:
    """Return the residuals' strength group by group, strongest first within each kind.

    Args:
        before: without the effects; it assigns rows to groups.
        after: with them, at another fit and possibly with other rows.
        seed: of the simulated noise.
    """
    table = recorded(before)
    where = groups(table, before.system.problem)
    first = _strength(before, where, seed)
    if after is before:
        return _sorted([replace(p, rms_ratio_after=p.rms_ratio) for p in first if p])
    now = recorded(after).as_in(table)
    last = _strength(after, [g.of(now) for g in where], seed)
    return _sorted([replace(p, rms_ratio_after=q.rms_ratio if q else None)
                    for p, q in zip(first, last, strict=True) if p])


def _sorted(places: list[Place]) -> tuple[Place, ...]:
    return tuple(sorted(places, key=lambda p: (p.by, -p.rms_ratio)))


def _strength(stage: Linearisation, where: Sequence[ResidualGroup],
              seed: int) -> list[Place | None]:
    """Return the places of actuators and groups, None for groups without rows."""
    rng = np.random.default_rng(seed)
    shape = stage.system.residual.shape
    noise = rng.normal(size=(stage.residual.size, DRAWS)) * stage.system.observed.reshape(-1, 1)
    both = np.concatenate([stage.residual[:, None], noise], axis=1)
    basis = stage.explained(stage.chosen)
    both -= basis @ (basis.T @ both)
    cleaned = both.reshape(*shape, -1)
    out: list[Place | None] = [*_by_actuator(stage, cleaned)]
    square = np.sum(cleaned**2, axis=1)
    for group in where:
        out.append(_place(group.by, group.value, square[group.rows].mean(axis=0))
                   if group.rows.any() else None)
    return out


def _place(by: str, value: str, figures: Array) -> Place:
    rms = np.sqrt(figures)
    p = float((np.sum(rms[1:] >= rms[0]) + 1) / rms.size)
    noise = float(np.sqrt(np.mean(rms[1:] ** 2)))
    # where geometry explains everything, noise leaves nothing either
    return Place(by, value, float(rms[0]) / noise if noise > 0.0 else 1.0, p)


def _by_actuator(stage: Linearisation, cleaned: Array) -> list[Place]:
    mechanism = stage.system.problem.mechanism
    k = len(mechanism.actuators)
    drive = np.zeros((*stage.system.residual.shape, k))
    for part in stage.system.parts:
        for i, limb in enumerate(mechanism.limbs):
            column = part.whitened(partial(Response.by_slot, limb=i, slot="offset"))
            drive[part.at, :column.shape[1], limb.actuator] += column
    white = stage.noise.apply(drive, stage.system).reshape(drive.shape)
    back = linalg.pinv(white, rcond=1e-6)
    errors = np.einsum("nkm,nmb->nkb", back, cleaned, optimize=True)
    sigma = np.sqrt(np.sum(back**2, axis=-1))[..., None]
    errors = errors / np.where(sigma > 0.0, sigma, 1.0)
    return [_place("actuator", name, np.mean(errors[:, a] ** 2, axis=0))
            for a, name in enumerate(mechanism.actuators)]


@dataclass(frozen=True, eq=False)
class Recorded:
    """Recorded values of N rows: (kind of group, name) -> values (N,), units of the file.

    ``at`` (N,): data set and row of origin.
    """

    values: Mapping[tuple[str, str], Array]
    at: tuple[tuple[int, int], ...]

    def as_in(self, other: Recorded) -> Recorded:
        """Return the same rows with the values of ``other`` if it has the row too.

        Poses depend on the fit, but a row must not change its group with the fit.
        """
        place = {key: n for n, key in enumerate(other.at)}
        mine = np.array([n for n, key in enumerate(self.at) if key in place], dtype=np.int64)
        theirs = [place[self.at[n]] for n in mine]
        out = {}
        for name, values in self.values.items():
            out[name] = values.copy()
            out[name][mine] = other.values[name][theirs]
        return replace(self, values=out)


@dataclass(frozen=True, eq=False)
class ResidualGroup:
    """Rows (N,) with ``low`` <= value < ``high``."""

    by: str
    value: str
    name: str
    low: float
    high: float
    rows: Bools

    def of(self, table: Recorded) -> ResidualGroup:
        """Return the same group in other rows."""
        return replace(self, rows=_between(table.values[self.by, self.name], self.low, self.high))


def recorded(stage: Linearisation) -> Recorded:
    """Return the values that define groups."""
    system = stage.system
    mechanism = system.problem.mechanism

    def stacked(name: str) -> Array:
        return np.concatenate([np.asarray(getattr(p.response.rows, name)).reshape(
            p.at.stop - p.at.start, -1) for p in system.firsts])

    approach = stacked("approach")
    out = {("direction", name): approach[:, a] for a, name in enumerate(mechanism.actuators)}
    out["load", ""] = np.linalg.norm(stacked("wrench")[:, :3], axis=1)
    out["temperature", ""] = stacked("temperature")[:, 0] + 20.0
    out["time", ""] = stacked("time")[:, 0]
    pose = pose_vector(np.concatenate([p.response.pose for p in system.firsts]))
    length = mechanism.units.factor("length")
    for c in (c for c in mechanism.dof if c < 3):
        out["region", "xyz"[c]] = pose[:, c] / length
    out["data set", ""] = system.dataset.astype(float)
    return Recorded(out, tuple(zip(system.dataset.tolist(), system.row.tolist(), strict=True)))


def groups(table: Recorded, problem: Problem) -> list[ResidualGroup]:
    """Return the groups for every recorded value that varies."""
    units = {"load": "N", "temperature": "deg C", "time": "s",
             "region": problem.mechanism.units.length}
    out: list[ResidualGroup] = []
    for (by, name), values in table.values.items():
        if by == "direction":
            out += [ResidualGroup(by, f"{name} {word}", name, sign - 0.5, sign + 0.5,
                          _between(values, sign - 0.5, sign + 0.5))
                    for sign, word in ((1.0, "+"), (-1.0, "-"))]
        elif by == "data set":
            out += [
                ResidualGroup(
                    by, d.name, name, i - 0.5, i + 0.5, _between(values, i - 0.5, i + 0.5)
                )
                for i, d in enumerate(problem.datasets)
            ]
        else:
            out += _bins(by, name, values, units[by])
    return [g for g in out if 3 <= g.rows.sum() < len(g.rows)]


BINS = {"load": 2, "temperature": 3, "time": 4, "region": 2}


def _bins(by: str, name: str, values: Array, unit: str) -> list[ResidualGroup]:
    """Split rows at the quantiles of a recorded value."""
    seen = np.isfinite(values)
    if not seen.any() or np.ptp(values[seen]) == 0.0:
        return []
    edges = np.unique(np.quantile(values[seen], np.linspace(0.0, 1.0, BINS[by] + 1)))
    shown = _distinct(edges)
    ends = [-np.inf, *edges[1:-1].tolist(), np.inf]
    return [
        ResidualGroup(
            by,
            f"{name} {shown[i]} to {shown[i + 1]} {unit}".lstrip(),
            name,
            low,
            high,
            _between(values, low, high),
        )
        for i, (low, high) in enumerate(pairwise(ends))
    ]


def _distinct(edges: Array) -> list[str]:
    """Return numbers as text with four digits, or as many as distinguish them."""
    for digits in range(4, 17):
        out = [f"{e:.{digits}g}" for e in edges]
        if len(set(out)) == len(out):
            break
    return out


def _between(values: Array, low: float, high: float) -> Bools:
    return np.isfinite(values) & (values >= low) & (values < high)
