"""LinuxCNC's genhexkins against a hexapod: what it makes of a command.

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

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.controllers.linuxcnc import is_hexapod
from ppmcal.controllers.linuxcnc.hal import HexapodGeometry, Joint, Points
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.linalg import Array
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
        raise BadInput(f"the machine is {mechanism.motion} with limbs "
                       f"{', '.join(limb.kind.name for limb in limbs)}", mechanism.source,
                       f"genhexkins takes six limbs {UPS.name} with `motion: spatial`, each "
                       "with its own actuator, pentakins five that end on rings about the "
                       "platform's z axis; genserkins is for serial arms, which no machine here is")
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


def unmoved(geometry: HexapodGeometry) -> HexapodGeometry:
    """Return the geometry without what moves both sides alike: offsets, and the turning nuts."""
    return replace(geometry, screw_lead=0.0, spindle_offset=0.0, tool_offset=0.0)


def reached(drive: LinuxcncDrive, setting: GenhexkinsSetting, pose: Array) -> Array:
    """Return where the machine goes when told to go to ``pose``, motors (N, 8); nan: nowhere.

    The nuts turn as the controller believes, and the frames' offsets are left out.
    """
    j = strut_lengths(unmoved(setting.geometry), commands(pose, drive.unit))
    was = drive.nominal
    present = (j - setting.shift) / setting.stretch * drive.unit
    q = np.zeros_like(j)
    q[:, drive.legs.actuator] = (present - was.offset - was.along) / was.ratio
    return forward(Model(drive.mechanism), q).pose
