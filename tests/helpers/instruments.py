"""What tests of several packages share: instruments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import predict
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]

BOX = {"6-UPS": [0.3, 0.3, 0.25, 0.2, 0.2, 0.2], "delta-linear": [0.06, 0.06, 0.08, 0, 0, 0],
       "delta-rotary": [0.06, 0.06, 0.06, 0, 0, 0], "linapod": [0.1, 0.1, 0.1, 0.1, 0.1, 0.1],
       "3-RPR": [0.06, 0.06, 0, 0, 0, 0.1]}

POINT = np.array([0.4, -0.3, -0.2])
"""Where distances are measured from, base frame."""

SIGMA = 1e-5

def joints(mechanism: Mechanism, name: str, n: int, rng: np.random.Generator) -> Array:
    """Return joint values (n, k) of random poses about home."""
    pose = mechanism.home_pose + rng.uniform(-1.0, 1.0, (4 * n, 6)) * BOX[name]
    found = inverse(Model(mechanism), pose_motor(pose))
    return found.q[found.reached][:n]


def positions(mechanism: Mechanism, g: Array, q: Array, registration: Registration) -> Array:
    found = forward(Model(mechanism, g), q)
    assert found.converged.all()
    return predict(registration, found.pose)[0]


def data_of(mechanism: Mechanism, kind: str, q: Array, second: Array | None, g: Array,
            rng: np.random.Generator, noise: float, unknown: bool) -> Dataset:
    """Return measurements of the machine with parameters ``g`` in a session of one kind."""
    frame = np.zeros(6)
    if kind == "plane" and unknown:
        frame[[2, 3, 4]] = 0.003, 0.004, -0.002
    if kind == "distance" and second is None:
        frame[:3] = -POINT
        frame[2] *= not mechanism.motion.planar
    target = np.array([0.01, -0.02, 0.03])
    if not mechanism.motion.turns_freely:
        target = np.zeros(3)
    registration = Registration.of_pose(frame, target)
    point = positions(mechanism, g, q, registration)
    if second is not None:
        point = point - positions(mechanism, g, second, registration)
    value = point[:, 2] if kind == "plane" else np.linalg.norm(point, axis=1)
    blank = Dataset.of_poses(kind, q, np.full((len(q), 6), np.nan), (SIGMA, SIGMA), False)
    open_frame = unknown and second is None
    return replace(
        blank, kind=find_instrument(kind),
        value=value + noise * rng.normal(size=len(q)), to_q=second,
        sigma_value=np.full(len(q), SIGMA), frame=Unknown(
            open_frame, np.zeros(6) if open_frame else frame),
        target=Unknown(unknown and mechanism.motion.turns_freely,
                       np.zeros(3) if unknown else target))


def truth(mechanism: Mechanism, rng: np.random.Generator, scale: float = 1.0) -> Array:
    """Return parameters (P,) drawn from the tolerances."""
    g = mechanism.values.copy()
    for p in mechanism.free:
        g[p] += scale * rng.normal() * float(mechanism.parameters[p].tolerance or 0.0)
    return g
