"""Errors row by row, as the instrument sees them and as the limbs do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.arrays import Array, Bools, known
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import shifted
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.partial_pose import carried_back
from ppmcal.observation import coordinates
from ppmcal.problem import Problem, State


@dataclass(frozen=True)
class Residuals:
    """Errors row by row, by data set; nan where not measured. SI.

    ``vector`` (N, m) by measured coordinate, ``sigma`` (N, m) their stated standard
    deviations, ``position`` and ``rotation`` norms (N,), ``closure`` (N, d) limb lengths
    at the measured poses, nan where the pose was not fully measured.
    """

    vector: tuple[Array, ...]
    sigma: tuple[Array, ...]
    position: tuple[Array, ...]
    rotation: tuple[Array, ...]
    closure: tuple[Array, ...]

    def figures(self, rows: Sequence[Bools]) -> dict[str, dict[str, float]]:
        """Return mean, rms, p95 and max of each kind of error over the given rows."""
        out = {}
        for name, parts in (("position", self.position), ("rotation", self.rotation)):
            values = np.concatenate([p[k] for p, k in zip(parts, rows, strict=True)])
            values = values[np.isfinite(values)]
            if values.size:
                out[name] = {"mean": float(values.mean()),
                             "rms": float(np.sqrt(np.mean(values**2))),
                             "p95": float(np.quantile(values, 0.95)),
                             "max": float(values.max())}
        gaps = np.concatenate([c[k].ravel() for c, k in zip(self.closure, rows, strict=True)])
        gaps = gaps[np.isfinite(gaps)]
        if gaps.size:
            out["closure"] = {"rms": float(np.sqrt(np.mean(gaps**2))),
                              "max": float(np.abs(gaps).max())}
        return out


def residuals(problem: Problem, state: State) -> Residuals:
    """Return the errors of all rows at a state."""
    parts: list[list[Array]] = [[], [], [], [], []]
    motion = problem.mechanism.motion
    for i, data in enumerate(problem.datasets):
        chosen = coordinates(data, motion)
        places = sum(1 for c in chosen if c < 3)
        vector = np.full((len(data), len(chosen)), np.nan)
        sigma = np.full_like(vector, np.nan)
        one = replace(problem, datasets=(data,))
        for rows in one.rows(State(state.g, (state.stations[i],), (state.poses[i],)), False):
            vector[rows.index] = np.where(rows.observed, rows.raw, np.nan)
            covariance = np.linalg.inv(np.swapaxes(rows.whitener, -1, -2) @ rows.whitener)
            sigma[rows.index] = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        parts[0].append(vector)
        parts[1].append(sigma)
        parts[2].append(_norm(vector[:, :places]))
        parts[3].append(_norm(vector[:, places:]))
        parts[4].append(closure_lengths(problem, state, i))
    return Residuals(*(tuple(p) for p in parts))


def _norm(vector: Array) -> Array:
    """Norm over the measured components, nan where none is."""
    seen = np.isfinite(vector)
    norm = np.sqrt(np.sum(np.where(seen, vector, 0.0) ** 2, axis=1))
    return np.where(seen.any(axis=1), norm, np.nan)


def closure_lengths(problem: Problem, state: State, index: int) -> Array:
    """Return the limb conditions at the measured poses, as lengths (N, d); nan if unknown."""
    data, station = problem.datasets[index], state.stations[index]
    out = np.full((len(data), problem.mechanism.conditions), np.nan)
    position, rotation = data.position.copy(), data.rotation.copy()
    motion = problem.mechanism.motion
    if motion == "planar":
        position[:, 2], rotation[:, :2] = 0.0, 0.0
    if motion == "translational":
        rotation = np.zeros_like(rotation)
    whole = known(position) & known(rotation) & known(data.q)
    if (data.kind == "pose" or motion == "translational") and whole.any():
        measured = np.concatenate([position[whole], rotation[whole]], axis=1)
        pose = carried_back(problem.mechanism, station, measured)
        joints = problem.joints(index, state)[whole]
        model = shifted(Model(problem.mechanism, state.g), problem.conditions[index].take(whole),
                        joints, pose)
        if model.shift is not None and model.shift.pose is not None:
            pose = moved(pose, -model.shift.pose)
        out[whole] = model.closure(joints).lengths(pose)
    return out
