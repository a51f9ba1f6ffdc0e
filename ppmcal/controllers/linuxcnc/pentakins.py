"""LinuxCNC's pentakins: five struts to rings about the tool's axis, and a machine in its numbers.

Strut n runs from b_n, fixed in the base, to a ring of radius r_n about the effector's z axis, at
height z_n, on which its end turns. Commanded to x, y, z, A and B, in degrees, the controller turns
the effector by R = Ry(B) Rx(A) and asks for

    j_n = sqrt((rho - r_n)^2 + (w_z - z_n)^2),    w = R^-1 (b_n - P), rho = hypot(w_x, w_y)

(pentakins.c). That is a limb U(P)S whose universal joint is on the platform, its first axis along
z, its axes r_n apart. How the effector turns about z is nothing to it: that a passive limb holds.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.export import (
    Exported,
    NotExpressed,
    Number,
    effects_lacking,
    head,
    misread,
    refuse,
)
from ppmcal.controllers.linuxcnc.hal import DIGITS, Joint, format_joints, parse_joints
from ppmcal.controllers.number_intervals import fitted, following
from ppmcal.controllers.pose_errors import next_to_none, pose_errors, within_limits
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.partial_pose import inverse_partial, pose_vector
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.limbs.spatial import UPS
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

STRUTS, NUMBERS = 5, 5
STEP = 1e-7
"""Step of differences by the numbers, m and 1."""
HAL, JOINTS = "pentakins.hal", "joints.ini"
UNIT = 1e-3
"""Lengths are written in mm."""
FIELDS = ("base.{}.x", "base.{}.y", "base.{}.z", "effector.{}.r", "effector.{}.z")
UPRIGHT, ON_AXIS = 0.999, 1e-3
"""A joint's axis is the tool's, and is on it, to this cosine and this part of the reach."""
SPREAD, TILT, POSES, SEED, ENOUGH = 0.1, 0.2, 100, 1, 20
"""How far poses are from home, parts of the reach and rad, and how many."""
EXACT = 1e-7
"""Lengths that are met to less, m, are held: what the decimals leave."""
_PIN = re.compile(r"^setp pentakins\.(base|effector)\.(\d)\.([xyzr]) (\S+)$", re.MULTILINE)


def is_pentapod(mechanism: Mechanism) -> bool:
    """Return whether five struts with drives of their own end on rings about the platform's z."""
    own = [limb for limb in mechanism.limbs if limb.driven]
    if (not mechanism.motion.turns_freely or len(own) != STRUTS
            or len({limb.actuator for limb in own}) != STRUTS
            or any(limb.kind is not UPS or "platform.axis" not in limb.constants for limb in own)):
        return False
    at = np.array([[limb.slots.values(mechanism.nominals).get(f"platform.point.{c}", 0.0)
                    for c in "xy"] for limb in own])
    level = min(abs(float(limb.constants["platform.axis"][2])) for limb in own)
    return level > UPRIGHT and bool(np.abs(at).max() < ON_AXIS * mechanism.reach)


@dataclass(frozen=True, eq=False)
class PentapodSetting:
    """What the controller holds: numbers (5, 5) as :data:`FIELDS`, m; joints' changes (5,) each."""

    numbers: Array
    stretch: Array
    shift: Array

    def array(self) -> Array:
        """Return all of it as one array (35,), m and 1."""
        return np.concatenate([self.numbers.ravel(), self.shift, self.stretch])

    @classmethod
    def of(cls, p: Array) -> PentapodSetting:
        """Return the setting of such an array (35,)."""
        at = STRUTS * NUMBERS
        return cls(p[:at].reshape(STRUTS, NUMBERS), p[at + STRUTS:], p[at:at + STRUTS])

    def rounded(self) -> PentapodSetting:
        """Return what is left of it after writing and reading."""
        joints = [Joint(0.0, float(s), float(d / UNIT)).rounded()
                  for s, d in zip(self.stretch, self.shift, strict=True)]
        return PentapodSetting(np.round(self.numbers / UNIT, DIGITS) * UNIT + 0.0,
                               np.array([j.stretch for j in joints]),
                               np.array([j.shift for j in joints]) * UNIT)


def strut_lengths(numbers: Array, pose: Array) -> Array:
    """Return what the controller asks of its joints (N, 5) at motors (N, 8), m.

    A and B are those that put the tool's axis where it is wanted: the turn about it does not count.
    """
    axis = cga.rotation_matrix(pose)[:, :, 2]
    a, b = np.arcsin(np.clip(-axis[:, 1], -1.0, 1.0)), np.arctan2(axis[:, 0], axis[:, 2])
    (ca, cb), (sa, sb), one = np.cos([a, b]), np.sin([a, b]), np.zeros_like(a)
    turn = np.stack([cb, sb * sa, sb * ca, one, ca, -sa, -sb, cb * sa, cb * ca],
                    axis=-1).reshape(-1, 3, 3)
    away = numbers[:, :3] - cga.translation(pose)[:, None, :]
    own = away @ turn
    return np.asarray(np.hypot(np.hypot(own[..., 0], own[..., 1]) - numbers[:, 3],
                               own[..., 2] - numbers[:, 4]))


def export_pentapod(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return a pentapod in pentakins' numbers; see :class:`ppmcal.controllers.export.Exporter`.

    Raises:
        BadInput: an option without use.
        NoResult: it takes next to no pose, or the lines read back as others.
    """
    for given, option in ((old, "--old"), (poses, "--poses")):
        refuse(given, option, "pentakins' numbers are compared with the nominal ones, over poses "
               "about home")
    bare = replace(mechanism, effects=())
    wanted = _poses(bare)
    exact, held = _fitted(bare, wanted)
    new = exact.rounded()
    nominal = _read_off(bare.nominal(), bare)
    lacks = tuple(_lacks(mechanism, bare, wanted, new, held))
    before, after = (pose_errors(bare, _reached(bare, s, wanted), wanted) for s in (nominal, new))
    names = [limb.name for limb in bare.limbs if limb.driven]
    texts = _files(bare, new, names, head(mechanism.name, before, after, lacks) + (
        "\nPins of LinuxCNC's pentakins; lengths in mm, as [TRAJ]LINEAR_UNITS must be."))
    return Exported(
        "linuxcnc", "LinuxCNC", texts,
        f"pentakins' numbers hold {'most of it, fitted' if lacks else 'all of the geometry'}",
        tuple(_table(nominal, new)), f"{len(wanted)} poses about home", before, after, lacks,
        (Note(f"limbs {', '.join(names)} are struts and joints 0 to 4; lengths are in mm, and "
              "tool-offset stays as it is", NOTE),),
        (Note(f"Load {HAL} by HALFILE in place of the lines that set these pins now, and change "
              f"the INI file's joints as {JOINTS} says, once.", NOTE),),
        poses=pose_vector(wanted),
        again=following(lambda m: _errors_by(replace(m, effects=()), wanted), mechanism,
                        exact.array(), np.full(7 * STRUTS, STEP), _named))


def _files(mechanism: Mechanism, new: PentapodSetting, names: list[str], comment: str
           ) -> dict[str, str]:
    """Return the two files, read back.

    Raises:
        NoResult: as other numbers.
    """
    home = strut_lengths(new.numbers, mechanism.home[None])[0] / UNIT
    ini = tuple(Joint(float(h), float(s), float(d / UNIT)).rounded()
                for h, s, d in zip(home, new.stretch, new.shift, strict=True))
    texts = {HAL: format_pins(new.numbers, names, comment),
             JOINTS: format_joints(ini, names, f"What {HAL} needs of the machine's INI file; "
                                   "lengths in mm. Change 'present' once.")}
    if (not np.array_equal(parse_pins(texts[HAL], HAL), np.round(new.numbers / UNIT, DIGITS) + 0.0)
            or parse_joints(texts[JOINTS], JOINTS) != ini):
        raise misread(f"{HAL}, {JOINTS}")
    return texts


def _poses(mechanism: Mechanism) -> Array:
    """Return motors (N, 8) about home that the machine takes within its limits."""
    rng = np.random.default_rng(SEED)
    spread = rng.uniform(-1.0, 1.0, (POSES, 6)) * np.repeat(
        [SPREAD * mechanism.reach, TILT], 3)
    asked = mechanism.home_pose + spread
    asked[:, 5] = np.nan
    found = inverse_partial(Model(mechanism), asked)
    good = finite_rows(found.pose) & within_limits(mechanism, found.q)
    if good.sum() < ENOUGH:
        raise next_to_none(mechanism)
    return np.asarray(found.pose[good])


def _driven(mechanism: Mechanism) -> list[int]:
    return [i for i, limb in enumerate(mechanism.limbs) if limb.driven]


def _counts(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return ratio and offset of each strut, (5,) each."""
    values = [Model(mechanism).limb_values[i] for i in _driven(mechanism)]
    return (np.array([v.get("ratio", 1.0) for v in values]),
            np.array([v.get("offset", 0.0) for v in values]))


def _read_off(mechanism: Mechanism, real: Mechanism) -> PentapodSetting:
    """Return the numbers as they stand in the slots, joints from nominal counts of ``real``."""
    values = [Model(mechanism).limb_values[i] for i in _driven(mechanism)]
    numbers = np.array([[*(v.get(f"base.point.{c}", 0.0) for c in "xyz"),
                         v.get("platform.axis_offset", 0.0), v.get("platform.point.z", 0.0)]
                        for v in values])
    (ratio, offset), (was, zero) = _counts(mechanism), _counts(real.nominal())
    stretch = ratio / was
    return PentapodSetting(numbers, stretch, offset - stretch * zero)


def _fitted(mechanism: Mechanism, wanted: Array) -> tuple[PentapodSetting, bool]:
    """Return the setting that asks for what struts have to be, and whether it does so exactly."""
    start, true = _struts(mechanism, wanted)
    if np.abs(strut_lengths(start.numbers, wanted) - true).max() < EXACT:
        return start, True
    numbers, shift = start.numbers.copy(), start.shift.copy()
    for n in range(STRUTS):
        def errors(p: Array, n: int = n) -> Array:
            rows = numbers.copy()
            rows[n] = p[:NUMBERS]
            return np.asarray((strut_lengths(rows, wanted)[:, n] - p[NUMBERS] - true[:, n]) / UNIT)

        p = fitted(errors, np.array([*numbers[n], 0.0]), "the numbers for pentakins", 60,
                   tight=1e-14)
        numbers[n], shift[n] = p[:NUMBERS], start.shift[n] + p[NUMBERS]
    return PentapodSetting(numbers, start.stretch, shift), False


def _struts(mechanism: Mechanism, wanted: Array) -> tuple[PentapodSetting, Array]:
    """Return the numbers as read off, and what struts have to be with them (N, 5), m."""
    start = _read_off(mechanism, mechanism)
    q = inverse_partial(Model(mechanism), pose_vector(wanted)).q
    ratio, offset = _counts(mechanism.nominal())
    own = [mechanism.limbs[i].actuator for i in _driven(mechanism)]
    return start, start.stretch * (ratio * q[:, own] + offset) + start.shift


def _errors_by(mechanism: Mechanism, wanted: Array) -> Callable[[Array], Array]:
    """Return what makes errors of struts (5N,), and of stretches, m and 1, of a setting (35,)."""
    start, true = _struts(mechanism, wanted)

    def errors(p: Array) -> Array:
        own = PentapodSetting.of(p)
        away = strut_lengths(own.numbers, wanted) - (own.shift - start.shift) - true
        return np.concatenate([np.nan_to_num(away).ravel(), own.stretch - start.stretch])

    return errors


def _named(p: Array) -> Mapping[str, float]:
    """Return a setting (35,) as :func:`_table` calls its numbers."""
    own = PentapodSetting.of(p)
    return {n.name: n.new for n in _table(own, own)}


def _reached(mechanism: Mechanism, setting: PentapodSetting, wanted: Array) -> Array:
    """Return where the machine goes when told to go to motors (N, 8)."""
    ratio, offset = _counts(mechanism.nominal())
    present = (strut_lengths(setting.numbers, wanted) - setting.shift) / setting.stretch
    q = np.zeros_like(present)
    q[:, [mechanism.limbs[i].actuator for i in _driven(mechanism)]] = (present - offset) / ratio
    return forward(Model(mechanism), q).pose


def _lacks(mechanism: Mechanism, bare: Mechanism, wanted: Array, new: PentapodSetting, held: bool
           ) -> Iterator[NotExpressed]:
    """Yield what rings about one axis cannot hold."""
    if not held:
        names = tuple(p.name for p in mechanism.parameters if p.value != p.nominal and (
            ".platform." in p.name or ".joint" in p.name))
        yield NotExpressed("joints on the platform whose axes are beside its z axis, or not along "
                           "it, and joints out of their places", names,
                           pose_errors(bare, _reached(bare, new, wanted), wanted))
    yield from effects_lacking(mechanism)


def _table(old: PentapodSetting, new: PentapodSetting) -> Iterator[Number]:
    for n in range(STRUTS):
        for name, was, value in zip(FIELDS, old.numbers[n], new.numbers[n], strict=True):
            yield Number(f"pentakins.{name.format(n)}", float(was / UNIT), float(value / UNIT),
                         "mm")
    for n in range(STRUTS):
        yield Number(f"[JOINT_{n}] stretch", 1.0, float(new.stretch[n]), "")
        yield Number(f"[JOINT_{n}] shift", 0.0, float(new.shift[n] / UNIT), "mm")


def format_pins(numbers: Array, names: list[str], comment: str) -> str:
    """Return the HAL file of numbers (5, 5), m."""
    lines = [f"# {line}".rstrip("\\ ") for line in comment.splitlines()]
    for n, name in enumerate(names):
        lines += ["", f"# strut {n}: {name}", *(
            f"setp pentakins.{field.format(n)} {v + 0.0:.{DIGITS}f}"
            for field, v in zip(FIELDS, np.round(numbers[n] / UNIT, DIGITS), strict=True))]
    return "\n".join(lines) + "\n"


def parse_pins(text: str, source: str) -> Array:
    """Return the numbers (5, 5), mm, of such a file.

    Raises:
        BadInput: one is missing.
    """
    found = {f"{group}.{n}.{c}": float(v) for group, n, c, v in _PIN.findall(text)}
    wanted = [[field.format(n) for field in FIELDS] for n in range(STRUTS)]
    missing = [name for row in wanted for name in row if name not in found]
    if missing:
        raise BadInput(f"pentakins.{missing[0]} is not set", source, "Set all 25 of them")
    return np.array([[found[name] for name in row] for row in wanted])
