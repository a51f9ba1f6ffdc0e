"""Entries of a sidecar that are known, unknown or given: frame, points, rotation, scale."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeGuard

import numpy as np

from ppmcal import algebra as cga
from ppmcal.errors import BadInput, refuse_unknown, unknown
from ppmcal.io.pose_fields import pose_from_map
from ppmcal.io.schema import is_number, show
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.linalg import Array
from ppmcal.model.dataset import Unknown
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import Motion
from ppmcal.units import Units

NEAR_ONE = (0.5, 2.0)
"""A scale beyond is rather a wrong unit."""


def frame_of(raw: object, motion: Motion, units: Units, source: str) -> Unknown:
    """Return where the base stands in the measuring frame."""
    if raw in ("unknown", "known"):
        return Unknown(raw == "unknown", np.zeros(6))
    place = f"{source}: frame"
    if isinstance(raw, dict) and "same_as" in raw:
        name = raw["same_as"]
        if len(raw) > 1 or not isinstance(name, str | int) or isinstance(name, bool):
            raise BadInput(f"{show(raw)} does not name another data set", place,
                           "Write {same_as: NAME} and nothing else")
        return Unknown(True, np.zeros(6), str(name))
    if isinstance(raw, dict) and {"points", "first_pose"} & {*raw}:
        raise BadInput("only measurements define a frame by points or by their first pose", place,
                       "Write unknown, known, or the pose")
    if isinstance(raw, dict):
        pose = pose_from_map(raw, motion.frame_coordinates, units, source, "frame",
                             needed=motion.coordinates)
        return Unknown(False, np.nan_to_num(pose))
    raise neither(raw, place, "a pose such as {x: 0, y: 0, rz: 0}, or {same_as: NAME}")


def point_of(raw: object, motion: Motion, units: Units, source: str, where: str = "target"
             ) -> Unknown:
    """Return a point (3,), m: known (the origin), unknown, or given."""
    sizes = tuple(range(motion.axes, 4))
    return _three(raw, sizes, units.factor("length"), f"{source}: {where}",
                  f"a list of {' or '.join(str(s) for s in sizes)} numbers")


def rotation_of(raw: object, units: Units, source: str) -> Unknown:
    """Return a rotation vector (3,), rad: known (none), unknown, or given."""
    return _three(raw, (3,), units.factor("angle"), f"{source}: target_rotation",
                  "a rotation vector [rx, ry, rz]")


def _three(raw: object, sizes: tuple[int, ...], factor: float, place: str, form: str) -> Unknown:
    """Return three numbers, SI, the last one 0 where it is left out."""
    if raw in ("unknown", "known"):
        return Unknown(raw == "unknown", np.zeros(3))
    if not isinstance(raw, list) or len(raw) not in sizes or not all(map(is_number, raw)):
        raise neither(raw, place, form)
    return Unknown(False, np.array([*map(float, raw), 0.0][:3]) * factor)


def scale_of(raw: object, kind: InstrumentKind, source: str) -> Unknown:
    """Return what measured lengths are times the true ones (1,): known (1), unknown, or given.

    A printed part that shrank, a caliper or a tracker in another scale: all rows of the file are
    off together. ``{value: 0.995, sigma: 0.0015}``: fitted, known to be so near that.
    """
    place = f"{source}: scale"
    if not kind.scales and raw not in ("known", 1, 1.0):
        raise BadInput("heights of a flat have no scale of their own" if kind.touches else
                       f"readings of the instrument '{kind}' are no lengths that have a scale",
                       place, "Take it out; a scale goes with pose, position or distance")
    if raw in ("unknown", "known"):
        return Unknown(raw == "unknown", np.ones(1))
    if isinstance(raw, dict):
        return _known_about(raw, place)
    if not _near_one(raw):
        raise neither(raw, place, f"a number from {NEAR_ONE[0]:g} to {NEAR_ONE[1]:g}, such as "
                      "0.997, or {value: 0.995, sigma: 0.0015}")
    return Unknown(False, np.array([float(raw)]))


def _near_one(raw: object) -> TypeGuard[float]:
    return is_number(raw) and NEAR_ONE[0] <= raw <= NEAR_ONE[1]


def _known_about(raw: Mapping[Any, Any], place: str) -> Unknown:
    """Return a scale that is fitted, near a value by one standard deviation."""
    if set(raw) != {"value", "sigma"}:
        raise BadInput(f"{show(raw)} is not a value with its standard deviation", place,
                       "Write {value: 0.995, sigma: 0.0015}")
    value, sigma = raw["value"], raw["sigma"]
    if not _near_one(value):
        raise BadInput(f"{show(value)} is not a number from {NEAR_ONE[0]:g} to {NEAR_ONE[1]:g}",
                       f"{place}.value", "Write what the file shows over true lengths, "
                       "such as 0.995")
    if not is_number(sigma) or not 0.0 < sigma < 1.0:
        raise BadInput(f"{show(sigma)} is not a standard deviation of a scale",
                       f"{place}.sigma", "Write a number between 0 and 1, such as "
                       "0.0015; of a scale that is known for sure write the value alone")
    return Unknown(True, np.array([float(value)]), sigma=float(sigma))


def actuator_noise(raw: object, mechanism: Mechanism, factors: Array, source: str) -> Array:
    """Return the drives' standard deviations (k,), unit of q; a number counts for all."""
    names = mechanism.actuators
    if not isinstance(raw, dict):
        return float(raw) * factors if isinstance(raw, int | float) else np.zeros(len(names))
    given = {str(name): value for name, value in raw.items()}
    refuse_unknown("actuator", given, names, f"{source}: instrument.sigma.actuator")
    return np.array([given.get(a, 0.0) * f for a, f in zip(names, factors, strict=True)])


def neither(raw: object, place: str, form: str) -> BadInput:
    """Return the refusal of what is neither known, unknown nor ``form``."""
    if isinstance(raw, str):
        error = unknown("word", raw, ("unknown", "known"), place)
        return BadInput(error.what, place, f"{error.hint} Or give {form}")
    return BadInput(f"{show(raw)} cannot be used here", place,
                    f"Write unknown, known, or {form}")


def at_point(frame: Unknown, point: Unknown) -> Unknown:
    """Return a frame with its origin in a point of it, as which distances have theirs."""
    away = cga.motor_from_rotation_vector(np.zeros(3), -point.value)
    return Unknown(point.fitted or frame.fitted,
                   pose_vector(cga.compose(away, pose_motor(frame.value))), defined=frame.defined)
