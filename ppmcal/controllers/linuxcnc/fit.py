"""A hexapod as genhexkins' numbers: how far it misses with them, and those with which least.

What the controller makes of commands is compared with them over poses around home. Its commands
are in the base frame of the model, so nothing is taken out of the errors.

Strut n runs from b_n, fixed in the base, to a_n, fixed in the platform. Commanded to x, y, z and
A, B, C, in degrees, the controller turns the platform by R = Rz(C) Ry(B) Rx(A) and asks for

    j_n = |P + R a_n - b_n| + lead asin(n3 . n2) / 2 pi        (genhexkins.c, posemath.c),

the strut's length and, where a screw lead is set, what its nut turns with the joints: with s the
strut's direction, n2 is the unit vector of (R an_n) x s and n3 that of s x (bn_n x s). Spindle
and tool offset are added to z of all a and b; they move the frames, not the machine.

Joint positions become joint values q of the model by what the INI file says: in its present state
j = +-(ratio q + offset) with the *nominal* ratio and offset of the limb, minus for a limb whose u
is negative. With q the machine's own forward kinematics tell where the platform ends up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.controllers.export import other_machine
from ppmcal.controllers.linuxcnc import is_hexapod
from ppmcal.controllers.linuxcnc.hal import STRUTS, HexapodGeometry, Joint, Points
from ppmcal.controllers.number_intervals import fitted
from ppmcal.controllers.pose_errors import ErrorSummary, pose_errors, within_limits
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.limbs.chain import U
from ppmcal.model.limbs.spatial import UPS
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class Legs:
    """The limbs of a hexapod as genhexkins sees them, SI, in the order of the struts.

    Attributes:
        base, platform: joint centres (6, 3), with the shift of joint 1.
        ratio, offset: (6,), u = ratio q + offset.
        along, beside: (6,): the strut is hypot(u + along, beside) long; joints 2 and 3 that stand
            off their places by that much along the driven line, and beside it. u + along is
            positive, as the reader takes no branch of a strut but 1.
        actuator: column of q (6,).
    """

    base: Array
    platform: Array
    ratio: Array
    offset: Array
    along: Array
    beside: Array
    actuator: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class LinuxcncDrive:
    """A machine without effects, its limbs, its nominal ones, and the controller's unit, m."""

    mechanism: Mechanism
    legs: Legs
    nominal: Legs
    unit: float


@dataclass(frozen=True, eq=False)
class GenhexkinsSetting:
    """What the controller holds: its points, and per joint the change of the INI file.

    ``stretch`` (6,) and ``shift`` (6,), in the controller's unit: see :class:`Joint`.
    """

    geometry: HexapodGeometry
    stretch: Array
    shift: Array


def rotations(angles: Array) -> Array:
    """Return R = Rz(C) Ry(B) Rx(A) (N, 3, 3) of A, B, C (N, 3) in degrees."""
    (ca, cb, cc), (sa, sb, sc) = np.cos(np.radians(angles)).T, np.sin(np.radians(angles)).T
    flat = [cb * cc, sa * sb * cc - ca * sc, ca * sb * cc + sa * sc,
            cb * sc, sa * sb * sc + ca * cc, ca * sb * sc - sa * cc, -sb, sa * cb, ca * cb]
    return np.stack(flat, axis=-1).reshape(-1, 3, 3)


def commands(pose: Array, unit: float) -> Array:
    """Return (N, 6) x, y, z in the unit and A, B, C in degrees of motors (N, 8).

    At B = +-90 deg, where only a combination of A and C counts, C is 0.
    """
    r = cga.rotation_matrix(pose)
    level = np.hypot(r[:, 0, 0], r[:, 1, 0])
    upright = level < 1e-9
    a = np.where(upright, np.arctan2(-r[:, 1, 2], r[:, 1, 1]), np.arctan2(r[:, 2, 1], r[:, 2, 2]))
    c = np.where(upright, 0.0, np.arctan2(r[:, 1, 0], r[:, 0, 0]))
    turn = np.degrees(np.stack([a, np.arctan2(-r[:, 2, 0], level), c], axis=-1))
    return np.concatenate([cga.translation(pose) / unit, turn], axis=-1)


def strut_lengths(geometry: HexapodGeometry, command: Array) -> Array:
    """Return joint positions (N, 6) that genhexkins asks for at commands (N, 6), in its unit."""
    up = np.array([0.0, 0.0, geometry.spindle_offset + geometry.tool_offset])
    turn = rotations(command[:, 3:])
    strut = (command[:, None, :3] + (np.array(geometry.platform) + up) @ turn.swapaxes(1, 2)
             - np.array(geometry.base) - up)
    length: Array = np.linalg.norm(strut, axis=-1)
    if geometry.screw_lead == 0.0:
        return length
    with np.errstate(invalid="ignore", divide="ignore"):
        s = strut / length[..., None]
        n3 = _unit(np.cross(s, np.cross(np.array(geometry.base_n), s)))
        n2 = _unit(np.cross(np.array(geometry.platform_n) @ turn.swapaxes(1, 2), s))
        turned: Array = np.arcsin(np.sum(n3 * n2, axis=-1))
    return length + geometry.screw_lead * turned / (2.0 * np.pi)


def _unit(v: Array) -> Array:
    out: Array = v / np.linalg.norm(v, axis=-1, keepdims=True)
    return out


def legs_of(mechanism: Mechanism) -> Legs:
    """Return the limbs as genhexkins sees them.

    Raises:
        BadInput: the machine is not a hexapod of six driven struts.
    """
    limbs = mechanism.limbs
    if not is_hexapod(mechanism):
        raise other_machine(
            mechanism, f"genhexkins takes six limbs {UPS.name} with `motion: spatial`, each with "
            "its own actuator, pentakins five that end on rings about the platform's z axis; "
            "genserkins is for serial arms, which no machine here is")
    model = Model(mechanism)
    rows = []
    for i, limb in enumerate(limbs):
        v = model.limb_values[i]
        base, platform = (cga.translation(chain.evaluate(v, ())[0])
                          for chain in (limb.kind.base, limb.kind.platform))
        start, end = (cga.translation(limb.kind.middle.evaluate({**v, U: x}, ())[0])
                      for x in (0.0, 1.0))
        along = float(start @ (end - start))
        beside = float(np.linalg.norm(start - along * (end - start)))
        rows.append([*base, *platform, v.get("ratio", 1.0), v.get("offset", 0.0), along, beside])
    t = np.array(rows)
    return Legs(t[:, :3], t[:, 3:6], t[:, 6], t[:, 7], t[:, 8], t[:, 9],
                np.array([limb.actuator for limb in limbs], dtype=np.int64))


def drive_of(mechanism: Mechanism, unit: float) -> LinuxcncDrive:
    """Return how the controller would drive the machine, its effects aside."""
    own = replace(mechanism, effects=())
    return LinuxcncDrive(own, legs_of(own), legs_of(own.nominal()), unit)


def genhexkins_setting(drive: LinuxcncDrive, geometry: HexapodGeometry | None = None
                       ) -> GenhexkinsSetting:
    """Return the setting as read off the machine; exact where no joint stands beside its line.

    ``geometry``: in the pins that are not points, what stays as it is.
    """
    legs = drive.legs
    base, platform = points(legs.base / drive.unit), points(legs.platform / drive.unit)
    geometry = (HexapodGeometry(base, platform) if geometry is None
                else replace(geometry, base=base, platform=platform))
    stretch = legs.ratio / drive.nominal.ratio
    return GenhexkinsSetting(geometry, stretch, right_shift(drive, stretch) / drive.unit)


def right_shift(drive: LinuxcncDrive, stretch: Array) -> Array:
    """Return the shift (6,), m, with which joint positions are u + along of the machine."""
    legs, was = drive.legs, drive.nominal
    return np.asarray(legs.offset + legs.along - stretch * (was.offset + was.along))


def points(values: Array) -> Points:
    """Return an array (6, 3) as it goes into a :class:`HexapodGeometry`."""
    return tuple((float(x), float(y), float(z)) for x, y, z in values)


def joints(drive: LinuxcncDrive, setting: GenhexkinsSetting) -> tuple[Joint, ...]:
    """Return what to write of the INI file, with the joint positions at the model's home."""
    home = strut_lengths(setting.geometry, commands(drive.mechanism.home[None], drive.unit))[0]
    return tuple(Joint(float(h), float(f), float(d))
                 for h, f, d in zip(home, setting.stretch, setting.shift, strict=True))


def rounded(setting: GenhexkinsSetting) -> GenhexkinsSetting:
    """Return what is left of a setting after writing and reading."""
    cut = [Joint(0.0, float(f), float(d)).rounded()
           for f, d in zip(setting.stretch, setting.shift, strict=True)]
    return GenhexkinsSetting(setting.geometry.rounded(), np.array([j.stretch for j in cut]),
                   np.array([j.shift for j in cut]))


def reached(drive: LinuxcncDrive, setting: GenhexkinsSetting, pose: Array) -> Array:
    """Return where the machine goes when told to go to ``pose``, motors (N, 8); nan: nowhere.

    The nuts turn as the controller believes, and the frames' offsets are left out.
    """
    bare = replace(setting.geometry, screw_lead=0.0, spindle_offset=0.0, tool_offset=0.0)
    j = strut_lengths(bare, commands(pose, drive.unit))
    was = drive.nominal
    present = (j - setting.shift) / setting.stretch * drive.unit
    q = np.zeros_like(j)
    q[:, drive.legs.actuator] = (present - was.offset - was.along) / was.ratio
    return forward(Model(drive.mechanism), q).pose


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
    good = finite_rows(q) & within_limits(mechanism, q)
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
    p = fitted(fit.errors, first, "the numbers for genhexkins", 60, fit.slopes, tight=1e-14)
    found = replace(start.geometry, base=points(p[:18].reshape(6, 3) / unit),
                    platform=points(p[18:36].reshape(6, 3) / unit))
    return GenhexkinsSetting(found, start.stretch / p[42:], p[36:42] / unit)


def numbers(setting: GenhexkinsSetting, unit: float) -> Array:
    """Return what of a setting is fitted (48,): base, platform and shifts, m, and stretches."""
    base, platform = np.array(setting.geometry.base), np.array(setting.geometry.platform)
    return np.concatenate([unit * base.ravel(), unit * platform.ravel(), unit * setting.shift,
                           setting.stretch])


def errors_by(drive: LinuxcncDrive, pose: Array) -> Callable[[Array], Array]:
    """Return what makes errors at motors (N, 8), (6N,), of :func:`numbers`."""
    start = genhexkins_setting(drive)
    fit = _Fit(drive, right_shift(drive, start.stretch), pose)
    return lambda p: fit.errors(np.concatenate([p[:42], start.stretch / p[42:]]))


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
