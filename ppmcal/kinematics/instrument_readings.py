"""Instrument readings that are no pose coordinates: tilts against gravity, a limb's joints."""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.joint_readings import JointReading
from ppmcal.linalg import Array
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.instruments.inclinometer import tilt_to_up
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration


def levelled(mechanism: Mechanism) -> Array:
    """Return the rotation (3, 3) from base axes, with the file's direction of gravity, to z up."""
    if mechanism.motion.planar:
        return np.eye(3)
    return tilt_to_up(-mechanism.gravity / np.linalg.norm(mechanism.gravity))


def sensor_turn(mechanism: Mechanism, registration: Registration, pose: Array
                ) -> tuple[Array, Array]:
    """Return the orientation of an angle sensor in a frame with z up, at platform motors (n, 8).

    Returns:
        Rotation matrices (n, 3, 3) of platform and sensor. The sensor's axes are the platform's,
        rotated by its mounting and then so that it is level where the machine is at zero.
    """
    up = levelled(mechanism)
    platform = cga.rotation_matrix(registration.frame) @ up @ cga.rotation_matrix(pose)
    body = cga.rotation_matrix(cga.motor_from_rotation_vector(registration.target_rotation,
                                                              np.zeros(3)))
    return platform, platform @ body @ up.T


def own_readings(kind: InstrumentKind, registration: Registration, model: Model, q: Array,
                 pose: Array) -> Array:
    """Return the readings of a kind that is not :attr:`InstrumentKind.of_poses` (n, k), SI.

    Args:
        kind: of the instrument.
        registration: where it stands.
        model: the machine.
        q: joint values (n, k).
        pose: platform motors (n, 8); closed ones for an encoder at a joint.
    """
    if kind.of_turn is not None:
        return kind.of_turn(sensor_turn(model.mechanism, registration, pose)[1],
                            model.mechanism.motion)[0]
    return registration.offset + JointReading(model.closure(q), pose, kind.at).value[:, None]
