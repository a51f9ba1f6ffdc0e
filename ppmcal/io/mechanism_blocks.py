"""Blocks of a mechanism file that are read and written as a whole: closure, stiffness, measurement.

``closure``: how far surplus limbs may be from closing. ``closure: {sigma: 0.1}`` is of all limbs,
``closure: {sigma: {c1: 0.1, c2: 0.2}}`` of those that it names: standard deviations in length
units. Limbs that are not named close but for their drives.

``stiffness``: springs of bars, drives and joint frames. At the top level it is the default of all
limbs; the same key in a limb replaces it key by key (a joint as a whole). ``bar``: N per length
unit along the limb's contact line; ``drive``: N per length unit or N m per angle unit of the joint
coordinate u; ``joint1`` ...: [LIN] eq. 18, one coefficient for each elementary component of that
joint's frame, or one number for x, y and z together. What is not given, or .inf, is rigid.

``measurement``: what identify keeps of its measurements.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.errors import BadInput, refuse_unknown
from ppmcal.io.mechanism_schema import ClosureFile, MeasurementFile, MechanismFile
from ppmcal.io.noise_limits import refuse_sigma
from ppmcal.io.pose_fields import COORDINATES, pose_from_map, pose_to_map
from ppmcal.io.schema import LARGEST, is_number, show
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH, ZERO_CELSIUS
from ppmcal.model.limbs import LimbKind
from ppmcal.model.limbs.chain import JOINT_COMPONENTS
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Limb, Mechanism
from ppmcal.model.registration import Registration
from ppmcal.units import Units, coordinate_quantity, to_file

CONDITIONS = {"temperature": ZERO_CELSIUS, "payload": 0.0, "time": 0.0,
              **dict.fromkeys(WRENCH, 0.0)}
"""Recorded conditions whose ranges are kept, and what is added to make them SI."""
KEY = "stiffness"
PARTS = ("bar", "drive")
TRANSLATIONS = JOINT_COMPONENTS[:3]
SMALLEST = 1e-12
Springs = dict[str, float]
"""``bar``, ``drive``, ``joint1.x`` ... -> value in file units, .inf for rigid."""


def read_gaps(file: ClosureFile | None, mechanism: Mechanism) -> dict[str, float]:
    """Return what limbs may gap, m, by name; those with 0 are left out.

    Raises:
        BadInput: a limb that is not there, an implausible value, a machine without surplus limbs.
    """
    if file is None:
        return {}
    place, names = f"{mechanism.source}: closure", [limb.name for limb in mechanism.limbs]
    if not mechanism.surplus:
        raise BadInput(
            f"the limbs put {mechanism.equations} conditions on {len(mechanism.dof)} coordinates: "
            "whatever they gap, there is a pose at which all close, so that a gap would be no "
            "other than noise of the drives", place, "Say that in the sidecar of the "
            "measurements, `instrument: {sigma: {actuator: 0.1}}`, and leave this key out")
    given = file.sigma if isinstance(file.sigma, dict) else dict.fromkeys(names, file.sigma)
    refuse_unknown("limb", given, names, f"{place}.sigma")
    out = {name: given[name] * mechanism.units.factor("length") for name in names
           if given.get(name)}
    refuse_sigma(np.array(list(out.values())), "length", mechanism, mechanism.units,
                 f"{place}.sigma", nothing="0")
    return out


def gaps_tree(mechanism: Mechanism) -> dict[str, Any]:
    """Return what limbs may gap as the file has it, empty where it says nothing."""
    length = mechanism.units.factor("length")
    own = {limb.name: to_file(mechanism.gaps[limb.name], length) for limb in mechanism.limbs
           if limb.name in mechanism.gaps}
    if not own:
        return {}
    alike = len(own) == len(mechanism.limbs) and len(set(own.values())) == 1
    return {"sigma": next(iter(own.values())) if alike else own}


# ---- stiffness


def read_stiffness(default: Any, raw: Sequence[Mapping[Any, Any]], limbs: Sequence[Limb],
                   units: Units, source: str) -> tuple[dict[str, float], ...]:
    """Return the stiffness of each limb's parts, SI, without those that are rigid.

    One mapping for each limb; nothing at all where no limb has a spring. What limbs have in the
    file, ``raw``, goes before its ``default``.

    Raises:
        BadInput: an unknown key, a joint that the kind does not have, a value that is not a
            stiffness, or limbs that share an actuator and disagree on its drive.
    """
    joints = dict.fromkeys(j for limb in limbs for j in joint_names(limb.kind))
    common = _section(default, joints, f"{source}: {KEY}")
    merged = []
    for limb, tree in zip(limbs, raw, strict=True):
        names = joint_names(limb.kind)
        parts = parts_of(limb.kind)
        own = _section(tree.get(KEY), names, f"{source}: limbs.{limb.name}.{KEY}", parts)
        merged.append({k: v for k, v in {**common, **own}.items() if k in (*parts, *names)})
    _agree_on_drives(merged, limbs, source)
    out = tuple(_in_si(springs, limb, units) for springs, limb in zip(merged, limbs, strict=True))
    return out if any(out) else ()


def stiffness_trees(mechanism: Mechanism) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Return what a file says of stiffness: the default, and ``{stiffness: ...}`` of each limb.

    Keys on which all limbs agree go into the default, in file units; both read back equal.
    """
    limbs = mechanism.limbs
    if not mechanism.stiffness:
        return {}, [{} for _ in limbs]
    trees = [_tree(springs, limb, mechanism.units)
             for springs, limb in zip(mechanism.stiffness, limbs, strict=True)]
    common = {k: v for k, v in trees[0].items() if all(t.get(k) == v for t in trees)}
    own = [{k: v for k, v in t.items() if k not in common} for t in trees]
    return common, [{KEY: t} if t else {} for t in own]


def parts_of(kind: LimbKind) -> tuple[str, ...]:
    """Return the springs of a kind beside its joints'; a passive limb has those of joints alone."""
    return PARTS if kind.driven else ()


def joint_names(kind: LimbKind) -> tuple[str, ...]:
    """Return the joints of a kind, ``joint1``, ``joint2``, ..."""
    return tuple(dict.fromkeys(s.name.partition(".")[0] for s in kind.joint_slots))


def spring_quantity(part: str, kind: LimbKind) -> str:
    """Return what a spring's stiffness is measured in: ``N/length`` or ``N.m/angle``."""
    turning = (kind.actuator == "angle" if part == "drive" else
               part.rpartition(".")[2].startswith("r"))
    return "N.m/angle" if turning else "N/length"


def _section(raw: Any, joints: Iterable[str], place: str, parts: Sequence[str] = PARTS
             ) -> dict[str, Springs]:
    """Return key -> its springs of one ``stiffness`` mapping, file units."""
    if raw is None:
        return {}
    allowed = (*parts, *joints)
    if not isinstance(raw, dict):
        raise BadInput(f"{show(raw)} is not a mapping", place,
                       f"Write keys with values here: {', '.join(allowed)}")
    refuse_unknown("key", raw, allowed, place)
    return {key: {key: _value(value, f"{place}.{key}")} if key in PARTS else
            _joint(key, value, f"{place}.{key}") for key, value in raw.items()}


def _joint(name: str, raw: Any, place: str) -> Springs:
    """Return the springs of one joint frame; a bare number is that of x, y and z.

    A component laid over a bare number by ``extends`` arrives as ``{value: ..., rz: ...}``.
    """
    if not isinstance(raw, dict):
        one = _value(raw, place)
        return {f"{name}.{c}": one for c in TRANSLATIONS}
    alike = _joint(name, raw["value"], place) if "value" in raw else {}
    own = {key: value for key, value in raw.items() if key != "value"}
    refuse_unknown("joint frame component", own, JOINT_COMPONENTS, place)
    return alike | {f"{name}.{key}": _value(value, f"{place}.{key}") for key, value in own.items()}


def _value(raw: Any, place: str) -> float:
    if not is_number(raw, math.inf) or raw <= 0.0:
        raise BadInput(f"{show(raw)} is not a stiffness", place,
                       "Write a positive number, or .inf for rigid")
    value = float(raw)
    if value != math.inf and not SMALLEST <= value <= LARGEST:
        raise BadInput(f"{show(raw)} is out of range", place,
                       "Write a number such as 5e7, or .inf for rigid")
    return value


def _in_si(springs: Mapping[str, Springs], limb: Limb, units: Units) -> dict[str, float]:
    """Return one limb's springs in SI, without what is rigid, in a fixed order."""
    flat = {k: v for part in springs.values() for k, v in part.items() if v != float("inf")}
    order = [*PARTS, *(s.name for s in limb.kind.joint_slots)]
    return {k: flat[k] * units.factor(spring_quantity(k, limb.kind)) for k in order if k in flat}


def _agree_on_drives(merged: Sequence[Mapping[str, Springs]], limbs: Sequence[Limb],
                     source: str) -> None:
    """Refuse limbs that share an actuator, one drive, and give it two stiffnesses."""
    first: dict[int, tuple[str, float]] = {}
    for springs, limb in zip(merged, limbs, strict=True):
        own = springs.get("drive", {}).get("drive", float("inf"))
        name, other = first.setdefault(limb.actuator, (limb.name, own))
        if own != other:
            raise BadInput(
                f"the drive's stiffness is {own:g} here but {other:g} in {name}, and both name "
                "the same actuator", f"{source}: limbs.{limb.name}.{KEY}.drive",
                "Limbs that share an actuator share its drive: give both the same")


def _tree(springs: Mapping[str, float], limb: Limb, units: Units) -> dict[str, Any]:
    """Return one limb's springs as the file has them, a number where x, y, z are alike."""
    out: dict[str, Any] = {}
    for part, value in springs.items():
        name, _, component = part.partition(".")
        written = to_file(value, units.factor(spring_quantity(part, limb.kind)))
        if component:
            out.setdefault(name, {})[component] = written
        else:
            out[name] = written
    for name, parts in out.items():
        if (isinstance(parts, dict) and tuple(parts) == TRANSLATIONS
                and len(set(parts.values())) == 1):
            out[name] = parts["x"]
    return out


# ---- measurement


def read_registrations(file: MechanismFile, units: Units, source: str) -> dict[str, Registration]:
    """Return frame and target of each data set.

    Raises:
        BadInput: a frame that is not a pose of this motion.
    """
    out: dict[str, Registration] = {}
    if file.measurement is None:
        return out
    for name, entry in file.measurement.datasets.items():
        where = f"measurement.datasets.{name}.frame"
        frame = np.zeros(6) if entry.frame is None else pose_from_map(
            entry.frame, file.motion.frame_coordinates, units, source, where)
        target = np.array([*(entry.target or [0.0, 0.0, 0.0]), 0.0][:3]) * units.factor("length")
        turn = np.array(entry.target_rotation or [0.0, 0.0, 0.0]) * units.factor("angle")
        out[name] = Registration.of_pose(frame, target, turn, entry.scale)
    return out


def read_measured(file: MeasurementFile | None, units: Units, actuators: Sequence[str],
                  joints: Array, source: str) -> MeasurementBasis | None:
    """Return what the calibration saw, None where the file does not say.

    ``joints``: SI value of one unit of each actuator (k,).

    Raises:
        BadInput: a range of a column that there is not.
    """
    if file is None or (file.noise is None and not file.ranges and file.converged is None):
        return None
    known = _columns(units, actuators, joints)
    refuse_unknown("column", file.ranges, known, f"{source}: measurement.ranges")
    ranges = {name: (low * known[name][0] + known[name][1], high * known[name][0] + known[name][1])
              for name, (low, high) in file.ranges.items()}
    noise = file.noise
    if noise is None:
        return MeasurementBasis(ranges=ranges, converged=file.converged)
    p = float("nan") if noise.chi2_p is None else noise.chi2_p
    return MeasurementBasis(noise.sigma_ratio, p, ranges, file.converged)


def measurement_tree(mechanism: Mechanism) -> dict[str, Any]:
    """Return the block as plain data, empty where there is nothing to keep."""
    out: dict[str, Any] = {}
    if mechanism.registrations:
        units = mechanism.units
        length, angle = units.factor("length"), units.factor("angle")
        out["datasets"] = {name: {
            "frame": pose_to_map(r.frame_pose, mechanism.motion.frame_coordinates, units),
            "target": [to_file(float(v), length) for v in r.target],
            "target_rotation": [to_file(float(v), angle) for v in r.target_rotation],
            **({} if r.scale == 1.0 else {"scale": r.scale}),
        } for name, r in mechanism.registrations.items()}
    seen = mechanism.measured
    if seen is not None and np.isfinite(seen.sigma_ratio):
        out["noise"] = {"sigma_ratio": seen.sigma_ratio,
                        **({"chi2_p": seen.chi2_p} if np.isfinite(seen.chi2_p) else {})}
    if seen is not None and seen.converged is not None:
        out["converged"] = seen.converged
    if seen is not None and seen.ranges:
        known = _columns(mechanism.units, mechanism.actuators, mechanism.joint_factors())
        out["ranges"] = {name: [_shown(value, *known[name]) for value in ends]
                         for name, ends in seen.ranges.items()}
    return out


def _shown(value: float, factor: float, zero: float) -> float:
    """Return a number in file units; to a millionth where zero is elsewhere, as rounding is."""
    return round(value - zero, 6) if zero else to_file(value, factor)


def _columns(units: Units, actuators: Sequence[str], joints: Array
             ) -> dict[str, tuple[float, float]]:
    """Return the columns that have ranges: name -> SI value of one unit, and of zero."""
    return {**{c: (units.factor(coordinate_quantity(c)), 0.0) for c in COORDINATES},
            **{f"q_{a}": (float(f), 0.0) for a, f in zip(actuators, joints, strict=True)},
            **{c: (1.0, zero) for c, zero in CONDITIONS.items()}}
