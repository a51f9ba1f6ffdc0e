"""Where the residuals are: by actuator, direction, load, temperature, region and time.

Description, not naming: dq = J_q^+ r attributes a row's residual to joints, whatever its
cause. Every figure stands beside what noise alone gives through the same projections.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnose.stage import Stage, explained
from ppmcal.targets import pose_vector

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
DRAWS = 400


@dataclass(frozen=True)
class Place:
    """One group of residuals: rms over what noise gives, and how rarely noise gives more."""

    by: str
    value: str
    rms_ratio: float
    p_value: float


def localise(stage: Stage, seed: int) -> tuple[Place, ...]:
    """Return the residuals' strength group by group, strongest first within each kind."""
    rng = np.random.default_rng(seed)
    shape = stage.system.residual.shape
    noise = rng.normal(size=(stage.residual.size, DRAWS)) * stage.system.observed.reshape(-1, 1)
    both = np.concatenate([stage.residual[:, None], noise], axis=1)
    basis, _ = explained(stage)
    both -= basis @ (basis.T @ both)
    cleaned = both.reshape(*shape, -1)
    out = _by_actuator(stage, cleaned)
    square = np.sum(cleaned**2, axis=1)
    for by, value, rows in groups(stage):
        out.append(_place(by, value, square[rows].mean(axis=0)))
    return tuple(sorted(out, key=lambda p: (p.by, -p.rms_ratio)))


def _place(by: str, value: str, figures: Array) -> Place:
    rms = np.sqrt(figures)
    p = float((np.sum(rms[1:] >= rms[0]) + 1) / rms.size)
    return Place(by, value, float(rms[0] / np.sqrt(np.mean(rms[1:] ** 2))), p)


def _by_actuator(stage: Stage, cleaned: Array) -> list[Place]:
    mechanism = stage.system.problem.mechanism
    k = len(mechanism.actuators)
    drive = np.zeros((*stage.system.residual.shape, k))
    for part in stage.system.parts:
        for i, limb in enumerate(mechanism.limbs):
            raw = np.where(part.response.seen.observed, part.response.by_slot(i, "offset"), 0.0)
            column = (part.whitener @ raw[..., None])[..., 0]
            drive[part.at, :column.shape[1], limb.actuator] += column
    white = stage.noise.apply(drive, stage.system).reshape(drive.shape)
    back = np.linalg.pinv(white, rcond=1e-6)
    errors = np.einsum("nkm,nmb->nkb", back, cleaned, optimize=True)
    spread = np.sqrt(np.sum(back**2, axis=-1))[..., None]
    errors = errors / np.where(spread > 0.0, spread, 1.0)
    return [_place("actuator", name, np.mean(errors[:, a] ** 2, axis=0))
            for a, name in enumerate(mechanism.actuators)]


def groups(stage: Stage) -> list[tuple[str, str, Bools]]:
    """Return (by, value, rows) for everything that was recorded and varies."""
    system = stage.system
    mechanism = system.problem.mechanism
    out: list[tuple[str, str, Bools]] = []

    def stacked(name: str) -> Array:
        return np.concatenate([np.asarray(getattr(p.response.rows, name)).reshape(
            p.at.stop - p.at.start, -1) for p in system.firsts])

    approach = stacked("approach")
    for a, name in enumerate(mechanism.actuators):
        for sign, word in ((1.0, "+"), (-1.0, "-")):
            out.append(("direction", f"{name} {word}", approach[:, a] == sign))
    load = np.linalg.norm(stacked("wrench")[:, :3], axis=1)
    out += _bins("load", load, 2, "N")
    out += _bins("temperature", stacked("temperature")[:, 0] + 20.0, 3, "deg C")
    time = stacked("time")[:, 0]
    out += _bins("time", time, 4, "s")
    pose = pose_vector(np.concatenate([p.response.pose for p in system.firsts]))
    length, unit = mechanism.units.factor("length"), mechanism.units.length
    for c in (c for c in mechanism.dof if c < 3):
        out += _bins("region", pose[:, c] / length, 2, unit, "xyz"[c])
    if len(system.problem.datasets) > 1:
        out += [("data set", d.name, system.dataset == i)
                for i, d in enumerate(system.problem.datasets)]
    return [g for g in out if 3 <= g[2].sum() < len(g[2])]


def _bins(by: str, values: Array, count: int, unit: str, name: str = ""
          ) -> list[tuple[str, str, Bools]]:
    """Split rows at the quantiles of a recorded value."""
    seen = np.isfinite(values)
    if not seen.any() or np.ptp(values[seen]) == 0.0:
        return []
    edges = np.unique(np.quantile(values[seen], np.linspace(0.0, 1.0, count + 1)))
    out = []
    for low, high in pairwise(edges):
        last = high == edges[-1]
        rows = seen & (values >= low) & ((values <= high) if last else (values < high))
        out.append((by, f"{name}{' ' if name else ''}{low:.4g} to {high:.4g} {unit}", rows))
    return out
