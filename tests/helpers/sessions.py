"""What tests of several packages share: sessions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from helpers.paths import ROOT
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

Array = NDArray[np.float64]

CONFIGS = ROOT / "configs"

BOX = {"3-RPR": [0.08, 0.08, 0, 0, 0, 0.2], "delta-linear": [0.08, 0.08, 0.06, 0, 0, 0],
       "6-UPS": [0.3, 0.3, 0.25, 0.2, 0.2, 0.2]}

POSITION, ROTATION = 1e-5, 2e-5

def machine(name: str) -> Mechanism:
    return read_mechanism(CONFIGS / f"{name}.yaml")


def session(mechanism: Mechanism, name: str, g: Array, rng: np.random.Generator, n: int = 40,
            label: str = "a") -> Dataset:
    """Measure poses of the machine ``g`` with an instrument that stands somewhere."""
    pose = mechanism.home_pose + rng.uniform(-1.0, 1.0, (3 * n, 6)) * BOX[name]
    found = inverse(Model(mechanism), pose_motor(pose))
    q = found.q[found.reached][:n]
    planar = mechanism.motion.planar
    frame = rng.normal(size=6) * ([0.1, 0.1, 0, 0, 0, 0.2] if planar else [0.1] * 3 + [0.05] * 3)
    registration = Registration.of_pose(frame)
    seen = measured_pose(registration, forward(Model(mechanism, g), q).pose)
    seen = seen + rng.normal(size=seen.shape) * ([POSITION] * 3 + [ROTATION] * 3)
    data = Dataset.of_poses(label, q, seen, (POSITION, ROTATION), False)
    if not mechanism.motion.turns:
        data = replace(data, kind=find_instrument("position"),
                       rotation=np.full((len(q), 3), np.nan))
    return replace(data, frame=Unknown(True, np.zeros(6)))


def drawn(mechanism: Mechanism, rng: np.random.Generator) -> Array:
    g = mechanism.nominals.copy()
    for p in mechanism.free:
        g[p] += (mechanism.parameters[p].tolerance or 0.0) * rng.normal()
    return g


def two_sessions(seed: int, shift: float, second: int = 20) -> tuple[Mechanism, Dataset]:
    """Return measurements of a 3-RPR in sessions A and B; in B leg 2's zero is elsewhere."""
    mechanism, rng = machine("3-RPR"), np.random.default_rng([11, seed])
    g = drawn(mechanism, rng)
    data = session(mechanism, "3-RPR", g, rng, 60)
    moved = data.q.copy()
    in_b = np.arange(60) >= 60 - second
    moved[in_b, 1] -= shift
    return mechanism, replace(data, q=moved, sessions=tuple(np.where(in_b, "B", "A").tolist()))
