"""Readings of encoders at the joints of a limb: the driven one, and the passive ones.

The position of each joint follows from the closed limb. A reading depends on the relative pose of
its two bodies, so its derivative is one line, as for the closure: paired with a twist of the
platform, and with opposite sign with that of every frame before it. A pure rotation about an axis
is a line at infinity: no direction, the axis as its moment.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.axis_offset import offset_slot
from ppmcal.model.limbs.kind import LimbKind

Reading = tuple[Array, Array, Array]
"""Value (n,), rad or m; line in base axes (n, 6); line in the middle chain's root axes (n, 6)."""


@dataclass(frozen=True)
class EncoderJoint:
    """A joint that can have an encoder.

    ``quantity``: ``angle`` or ``length``; ``said``: its letter, or that it is driven; ``needs``:
    the direction that a limb must have for it, ``unless`` it has another; ``read``: motors (n, 8)
    of the ends of the base chain, the middle chain, and the platform chain in base axes -> the
    reading; None: the drive's own u.
    """

    quantity: str
    said: str
    needs: str = ""
    unless: str = ""
    read: Callable[[Array, Array, Array], Reading] | None = None


def _pull(direction: Array, through: Array) -> Array:
    return np.concatenate([direction, np.cross(through, direction)], axis=-1)


def _couple(axis: Array) -> Array:
    return np.concatenate([np.zeros_like(axis), axis], axis=-1)


def _axes(motor: Array, axis: int) -> Array:
    return np.asarray(cga.rotation_matrix(motor)[..., :, axis])


def _first_axis(base: Array, middle: Array, held: Array) -> Reading:
    """Angle of a universal joint about its first axis, z, towards the rod's other end."""
    end = cga.translation(held)
    seen = cga.move_point(cga.reverse(base), end)
    across = (cga.rotation_matrix(base) @ _across(seen)[..., None])[..., 0]
    return np.arctan2(seen[..., 1], seen[..., 0]), _pull(across, end), np.zeros((1, 6))


def _hinge(base: Array, middle: Array, held: Array) -> Reading:
    """Angle about z of the base chain's end: from the middle chain's reach to the platform."""
    value, line, _ = _first_axis(base, middle, held)
    reach = cga.translation(middle)
    return (value - np.arctan2(reach[..., 1], reach[..., 0]), line, _pull(_across(reach), reach))


def _across(place: Array) -> Array:
    """Return the derivative of the angle about z by a point (n, 3): 1/m, normal to it and to z."""
    x, y, _ = np.moveaxis(place, -1, 0)
    return np.asarray(np.stack([-y, x, np.zeros_like(x)], axis=-1) / (x * x + y * y)[..., None])


def _turn(base: Array, middle: Array, held: Array) -> Reading:
    """Rotation of the platform beyond both chains, about z, in the plane."""
    angle = sum(sign * np.arctan2(m[..., 1, 0], m[..., 0, 0]) for sign, m in (
        (1.0, cga.rotation_matrix(held)), (-1.0, cga.rotation_matrix(base)),
        (-1.0, cga.rotation_matrix(middle))))
    couple = _couple(np.array([[0.0, 0.0, 1.0]]))
    return np.asarray(angle), couple, couple


def _rest_of_turn(base: Array, middle: Array, held: Array) -> Reading:
    """Rotation of the platform minus that at the other end's hinge, in the plane."""
    (a, line, own), (b, turn, couple) = _hinge(base, middle, held), _turn(base, middle, held)
    return b - a, turn - line, couple - own


def _slide_on_base(base: Array, middle: Array, held: Array) -> Reading:
    """Position of the platform's point along x of the base chain's end."""
    end, reach, along = cga.translation(held), cga.translation(middle), _axes(base, 0)
    value = np.sum(along * (end - cga.translation(base)), axis=-1) - reach[..., 0]
    return value, _pull(along, end), _pull(np.broadcast_to([1.0, 0.0, 0.0], reach.shape), reach)


def _slide_on_platform(base: Array, middle: Array, held: Array) -> Reading:
    """Position of the platform's point, along its x, from the end of the middle chain."""
    start, along = cga.translation(base), _axes(held, 0)
    back = cga.translation(cga.reverse(middle))[..., 0]
    value = np.sum(along * (cga.translation(held) - start), axis=-1) + back
    own = _axes(middle, 0)
    return value, _pull(along, start), _pull(own, np.zeros_like(own))


PASSIVE = {"sphere": (_hinge, _rest_of_turn), "circle": (_hinge,),
           "base plane": (_slide_on_base, _turn), "platform plane": (_turn, _slide_on_platform)}
"""By closure family of planar limbs, and of one with a hinge on the base: first and second joint.
A ball has no single angle."""


def joints_of(kind: LimbKind) -> dict[str, EncoderJoint]:
    """Return the joints of a limb kind that can have an encoder, by name."""
    letters = re.findall(r"\(?[A-Z]\)?", kind.name)
    if len(letters) != sum(step.joint for step in kind.steps):
        return {}
    flat = kind.planar or kind.surface.equations > 1
    reads = iter(PASSIVE.get(kind.surface.name, ()) if flat else ())
    out = {}
    for number, letter in enumerate(letters, start=1):
        name, plain = f"joint{number}", letter.strip("()")
        if letter != plain:
            out[name] = EncoderJoint(kind.actuator, f"{plain}, driven")
            continue
        own, other = offset_slot(kind.base), offset_slot(kind.platform)
        if plain == "U" and own is not None:
            # with an axis on the platform's side, that joint is the U and this one a ball
            out[name] = EncoderJoint("angle", plain, own.needs, other.needs if other else "",
                                     _first_axis)
        elif plain in "RP" and (read := next(reads, None)) is not None:
            out[name] = EncoderJoint("length" if plain == "P" else "angle", plain, read=read)
    return out
