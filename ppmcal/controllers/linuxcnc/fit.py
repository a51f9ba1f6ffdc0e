"""A hexapod as genhexkins' numbers: how far it misses with them, and those with which least.

What the controller makes of commands is compared with them over poses around home. Its commands
are in the base frame of the model, so nothing is taken out of the errors.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.controllers.linuxcnc.arithmetic import (
    GenhexkinsSetting,
    LinuxcncDrive,
    points,
    reached,
    right_shift,
)
from ppmcal.controllers.linuxcnc.hal import STRUTS
from ppmcal.controllers.pose_errors import ErrorSummary, pose_errors
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism

EXACT = 1e-9
"""genhexkins expresses a machine whose largest error is below this, m."""
REACH, TURN = 0.25, 0.25
"""Farthest that the grid goes: part of the mean strut length, and rad."""
SHRINK = (1.0, 0.8, 0.65, 0.5, 0.35, 0.25, 0.15, 0.1, 0.05, 0.02)
MOST = 0.9
"""The grid shrinks until this part of it lies within the limits."""
SAME = 1e-7
"""Poses closer than this part of the reach are the same."""
TURNS = np.array([(0.0, 0.0, 0.0), *product((-1.0, 1.0), repeat=3)]) / np.sqrt(3.0)
SPREAD = np.array([[*place, *turn] for place in product((-1.0, 0.0, 1.0), repeat=3)
                   for turn in TURNS])


def predicted_errors(drive: LinuxcncDrive, setting: GenhexkinsSetting, pose: Array) -> ErrorSummary:
    """Return how far the machine, driven with ``setting``, misses motors ``pose`` (N, 8).

    Over those that it takes.

    Raises:
        NoResult: it takes none.
    """
    return pose_errors(drive.mechanism, reached(drive, setting, pose), pose)


def within(mechanism: Mechanism, pose: Array) -> NDArray[np.bool_]:
    """Return which motors (N, 8) the machine takes with its joints within their limits (N,).

    From home without a singularity on the way, so that its joint values do lead there.
    """
    q = inverse(Model(mechanism), pose).q
    with np.errstate(invalid="ignore"):
        inside = np.all((q >= mechanism.limits[:, 0]) & (q <= mechanism.limits[:, 1]), axis=1)
    good: NDArray[np.bool_] = finite_rows(q) & inside
    rows = np.flatnonzero(good)
    back = forward(Model(mechanism), q[rows]).pose
    away = np.linalg.norm(cga.translation(back) - cga.translation(pose[rows]), axis=1)
    good[rows] = away < SAME * mechanism.reach
    return good


def grid(drive: LinuxcncDrive) -> tuple[Array, float, float]:
    """Return motors (N, 8) around home within the limits, and how far they go, m and rad.

    27 places with 9 turns each: none, and by the same angle about the four diagonals, to and fro.
    """
    mechanism, legs = drive.mechanism, drive.legs
    upright = cga.motor_from_rotation_vector(mechanism.home_pose[3:], np.zeros(3))
    strut = cga.move_point(mechanism.home, legs.platform) - legs.base
    size = REACH * float(np.mean(np.linalg.norm(strut, axis=1)))
    for part in SHRINK:
        far, turn = part * size, part * TURN
        moved = cga.motor_from_rotation_vector(turn * SPREAD[:, 3:],
                                               mechanism.home_pose[:3] + far * SPREAD[:, :3])
        pose = cga.compose(moved, upright)
        good = within(mechanism, pose)
        if np.mean(good) >= MOST:
            break
    return pose[good], far, turn


def best(drive: LinuxcncDrive, start: GenhexkinsSetting, pose: Array) -> GenhexkinsSetting:
    """Return the setting with the smallest errors at motors ``pose`` (N, 8).

    Squared errors of position and, times the machine's length scale, of rotation, by the 36
    coordinates, 6 shifts and 6 stretches; ``start`` itself where that is exact.
    """
    if predicted_errors(drive, start, pose).max < EXACT:
        return start
    fit, unit = _Fit(drive, right_shift(drive, start.stretch), pose), drive.unit
    first = np.concatenate([drive.legs.base.ravel(), drive.legs.platform.ravel(),
                            start.shift * unit, np.ones(STRUTS)])
    with linalg.guarded("the numbers for genhexkins"):
        p = least_squares(fit.errors, first, fit.slopes, xtol=1e-14, ftol=1e-14, gtol=1e-14,
                          max_nfev=60).x
    found = replace(start.geometry, base=points(p[:18].reshape(6, 3) / unit),
                    platform=points(p[18:36].reshape(6, 3) / unit))
    return GenhexkinsSetting(found, start.stretch / p[42:], p[36:42] / unit)


class _Fit:
    """Errors over poses by p: base (6, 3), platform (6, 3), shift (6,), gain (6,); m and 1.

    The machine's own struts drive gain (j - shift) + right where j is the length that genhexkins
    asks for. Errors of the pose follow those of the struts by A^-1 of the machine at the wanted
    pose, rows (s, R a x s), which holds but for the squares of what is missed.
    """

    def __init__(self, drive: LinuxcncDrive, right: Array, pose: Array) -> None:
        legs = drive.legs
        self.unit, self.beside, self.right = drive.unit, legs.beside, right
        self.turn = cga.rotation_matrix(pose)
        self.place = cga.translation(pose)[:, None, :]
        arm = legs.platform @ self.turn.swapaxes(1, 2)
        strut = self.place + arm - legs.base
        self.true = np.linalg.norm(strut, axis=-1)
        if any(np.any(v.get(s.name, 0.0)) for v, limb in zip(
                Model(drive.mechanism).limb_values, drive.mechanism.limbs, strict=True)
               for s in limb.kind.axis_offsets):
            # where a universal joint's axes do not meet, a point is at another length
            self.true = self._driven(drive, pose)
        line = strut / self.true[..., None]
        self.back = linalg.inv(np.concatenate([line, np.cross(arm, line)], axis=-1))
        self.back[:, 3:] *= drive.mechanism.length_scale

    def _driven(self, drive: LinuxcncDrive, pose: Array) -> Array:
        """Return how long the machine's struts are driven to be at ``pose``, (N, 6), m."""
        model = Model(drive.mechanism)
        q = inverse(model, pose).q
        u = np.stack([model.joint_coordinate(i, q) for i in range(STRUTS)], axis=-1)
        return np.asarray(np.hypot(u + drive.legs.along, self.beside), dtype=float)

    def struts(self, p: Array) -> tuple[Array, Array, Array]:
        """Return directions (N, 6, 3), what is asked for less the shift, and true lengths."""
        strut = (self.place + p[18:36].reshape(6, 3) @ self.turn.swapaxes(1, 2)
                 - p[:18].reshape(6, 3))
        length = np.linalg.norm(strut, axis=-1)
        asked = length - p[36:42]
        return strut / length[..., None], asked, np.hypot(p[42:] * asked + self.right, self.beside)

    def errors(self, p: Array) -> Array:
        """Return errors (6N,) in the controller's unit."""
        long = self.struts(p)[2] - self.true
        return np.asarray((self.back @ long[..., None]).ravel() / self.unit, dtype=float)

    def slopes(self, p: Array) -> Array:
        """Return their derivative by p, (6N, 48)."""
        s, asked, long = self.struts(p)
        by_drive = self.back * ((p[42:] * asked + self.right) / long)[:, None]
        by_strut = by_drive * p[42:]
        parts = (-by_strut[..., None] * s[:, None],
                 by_strut[..., None] * np.einsum("nlc,ncd->nld", s, self.turn)[:, None],
                 -by_strut, by_drive * asked[:, None])
        return np.concatenate([v.reshape(len(s) * 6, -1) / self.unit for v in parts], axis=1)
