"""An instrument that has not measured yet: plans are made for it, fleets measured with it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.instrument_readings import own_readings
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.linalg import Array
from ppmcal.model.dataset import NO_OFFSET, TRUE_SCALE, Dataset, Unknown
from ppmcal.model.instruments import POSE, POSITION, InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

OF_TOLERANCE = 0.1
"""Noise of the default instrument, as a part of the median length tolerance."""
NAME = "plan"


@dataclass(frozen=True, eq=False)
class Instrument:
    """What measures, SI.

    ``kind`` as of a data set; ``sigma_position``, ``sigma_rotation``, ``sigma_value``: standard
    deviations, nan where it has none; ``sigma_actuator`` (k,) noise of the drives; ``frame``,
    ``target``, ``target_rotation``, ``scale``: fitted or known, and what the plan takes them to be;
    ``chosen``: whether the user gave it; ``name``: of its data set.
    """

    kind: InstrumentKind
    sigma_position: float
    sigma_rotation: float
    sigma_value: float
    sigma_actuator: Array
    frame: Unknown
    target: Unknown
    target_rotation: Unknown
    chosen: bool = True
    name: str = NAME
    scale: Unknown = TRUE_SCALE
    offset: Unknown = NO_OFFSET

    @property
    def registration(self) -> Registration:
        """Where the plan takes the instrument to stand."""
        return Registration.of_pose(self.frame.value, self.target.value,
                                    self.target_rotation.value,
                                    scale=float(self.scale.value[0]))

    def dataset(self, q: Array, pose: Array, columns: Mapping[str, Array], mechanism: Mechanism
                ) -> Dataset:
        """Return measurements (N rows) without error at joints (N, k) and poses (N, 6)."""
        n, planar = len(q), mechanism.motion.planar
        seen = measured_pose(self.registration, pose_motor(pose))
        seen[:, [2, 3, 4]] = np.where(planar, np.nan, seen[:, [2, 3, 4]])
        value = np.full(n, np.nan)
        if self.kind.value is not None:
            value = self.kind.value(seen[:, :3], np.zeros(3))
        if not self.kind.of_poses:
            own = own_readings(self.kind, self.registration, Model(mechanism), q, pose_motor(pose))
            seen[:], value = np.nan, own[:, 0] + float(self.offset.value[0])
            seen[:, list(self.kind.coordinates(mechanism.motion))] = own
        return Dataset(
            name=self.name, source=self.name, kind=self.kind, rows=np.arange(1, n + 1), q=q,
            commanded=None, position=seen[:, :3], rotation=seen[:, 3:], value=value, to_q=None,
            sigma_position=np.full((n, 3), self.sigma_position),
            sigma_rotation=np.full((n, 3), self.sigma_rotation),
            sigma_value=np.full(n, self.sigma_value), sigma_actuator=self.sigma_actuator,
            groups=np.arange(n), columns=columns, sessions=None, frame=self.frame,
            target=self.target, target_rotation=self.target_rotation, scale=self.scale,
            offset=self.offset)


def default_instrument(mechanism: Mechanism) -> Instrument:
    """Return the instrument where the user gave none.

    A full pose (a translational machine: a position), frame unknown, target known; noise
    :data:`OF_TOLERANCE` of the median length tolerance, rotations that over the platform's size.
    """
    free = [mechanism.parameters[i] for i in mechanism.free]
    sigmas = [p.prior_sigma for p in free if p.quantity == "length" and p.prior_sigma]
    sigma = OF_TOLERANCE * (float(np.median(sigmas)) if sigmas else 1e-3 * mechanism.reach)
    kind = POSE if mechanism.motion.turns else POSITION
    nothing = Unknown(False, np.zeros(3))
    return Instrument(kind, sigma, sigma / mechanism.length_scale, np.nan,
                      np.zeros(len(mechanism.actuators)), Unknown(True, np.zeros(6)), nothing,
                      nothing, chosen=False)


__all__ = ["NAME", "Instrument", "default_instrument"]
