"""Inclinometers: roll and pitch of a body on the platform, against gravity.

With u the direction up in the sensor's own axes, roll = atan2(u_y, u_z) and pitch =
atan2(-u_x, |u_y, u_z|): rotations about z, y and x in that order, of which the first is not
observable. The sensor is level if its z axis is up; mounted without a rotation it is level if the
platform's axes are parallel to the base's, with the base oriented to gravity as in the mechanism
file. The mounting has three angles, all of them identifiable (that about z by how tilt is split
between the two readings); the base's own tilt has two, without the rotation about the vertical.
Unless the platform rotates about the vertical, only the sum of both tilts is identifiable.

In the plane there is one reading, ``roll``: the rotation of the platform. There the base's tilt and
the mounting are one angle.
"""

from __future__ import annotations

import numpy as np

from ppmcal.linalg import Array, nearest_rotation
from ppmcal.model.instruments.kind import InstrumentKind, Parts, register
from ppmcal.model.motions import Motion

ROUNDS = 50
"""Iterations that alternate between frame and mounting, each optimal given the other."""
IN_PLANE = 1e-6


def _angles(turn: Array, motion: Motion) -> tuple[Array, Array]:
    """Return roll and pitch (n, 2), or roll (n, 1) in the plane, and derivatives by rotations."""
    if motion.planar:
        about_z = np.broadcast_to([0.0, 0.0, 1.0], (len(turn), 1, 3))
        return np.arctan2(turn[:, 1, 0], turn[:, 0, 0])[:, None], about_z
    x, y, z = up = np.moveaxis(turn[:, 2], -1, 0)
    # a rotation w moves the up direction in the sensor's axes by turn' (z x w)
    moves = np.stack([turn[:, 1], -turn[:, 0], np.zeros_like(turn[:, 0])], axis=-1)
    size = np.hypot(y, z)
    by_roll = (z[:, None] * moves[:, 1] - y[:, None] * moves[:, 2]) / (size**2)[:, None]
    by_size = (y[:, None] * moves[:, 1] + z[:, None] * moves[:, 2]) / size[:, None]
    by_pitch = x[:, None] * by_size - size[:, None] * moves[:, 0]
    return (np.stack([np.arctan2(y, z), np.arctan2(-x, size)], axis=1),
            np.stack([by_roll, by_pitch / np.sum(up**2, axis=0)[:, None]], axis=1))


def _up(angles: Array) -> Array:
    """Return the direction up in the sensor's axes (n, 3) for roll and pitch (n, 2)."""
    roll, pitch = angles.T
    return np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll),
                     np.cos(pitch) * np.cos(roll)], axis=1)


def _aligned(angles: Array, platform: Array, at: tuple[Array, Array], opened: tuple[bool, bool]
             ) -> tuple[Array, Array]:
    """Return frame and mounting (3, 3) that best map up to the readings (Wahba)."""
    frame, body = at
    if angles.shape[1] == 1:
        rest = np.exp(1j * angles[:, 0]) / ((frame @ platform @ body)[:, 0, 0]
                                            + 1j * (frame @ platform @ body)[:, 1, 0])
        angle = np.angle(rest.sum())
        turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0],
                         [0.0, 0.0, 1.0]])
        return (frame, body @ turn) if opened[1] else (turn @ frame, body)
    read, up = _up(angles), np.array([0.0, 0.0, 1.0])
    for _ in range(ROUNDS if all(opened) else 1):
        if opened[1]:
            body = nearest_rotation((np.swapaxes(frame @ platform, -1, -2) @ up).T @ read, False)
        if opened[0]:
            # up as measured on the platform, in base axes: gives the tilt, but no rotation about it
            seen = np.sum((platform @ body @ read[..., None])[..., 0], axis=0)
            frame = tilt_to_up(seen / np.linalg.norm(seen))
    return frame, body


def tilt_to_up(direction: Array) -> Array:
    """Return the smallest rotation (3, 3) that carries a unit direction (3,) onto z."""
    x, y, z = direction
    if z < IN_PLANE - 1.0:
        return np.diag([1.0, -1.0, -1.0])
    return np.array([[1.0 - x * x / (1.0 + z), -x * y / (1.0 + z), -x],
                     [-x * y / (1.0 + z), 1.0 - y * y / (1.0 + z), -y], [x, y, z]])


def _frame(motion: Motion, between: bool) -> Parts:
    """Return the components of the base's tilt; in the plane the mounting covers it."""
    return () if motion.planar else (3, 4)


def _refused(motion: Motion, gravity: Array) -> tuple[str, str]:
    """Reject platforms that never tilt, and gravity that does not show tilts."""
    if not (motion.turns if motion.planar else motion.turns_freely):
        return (f"the platform of a {motion} machine never tilts",
                "Use pose, position or distance")
    if np.linalg.norm(gravity[:motion.axes]) < IN_PLANE:
        return ("an inclinometer needs gravity, and the mechanism file has none "
                + ("in the plane" if motion.planar else "at all"),
                "Write the direction of weight in base axes, such as `gravity: [0, -1, 0]`")
    return "", ""


INCLINOMETER = register(InstrumentKind(
    "inclinometer", lambda motion: (5,) if motion.planar else (3, 4), frame_parts=_frame,
    target_parts=lambda motion, relative: (), opened=(), sigma="rotation", names=("roll", "pitch"),
    of_turn=_angles, aligned=_aligned, refused=_refused,
    assumed={"frame": "known", "target": "known", "target_rotation": "unknown"}))
