"""Universal joints whose two axes do not intersect ([LIN] section 2.3: their normal distance).

The first axis, a, is fixed to the body that carries the joint, the second is perpendicular to it at
a distance e, the rod perpendicular to the second. So the rod lies in the plane of a and of the
limb's other end X, and starts at P + e n, with P the joint's point on a and n the unit vector from
a towards X:

    |X - P - e n|^2 = h^2 + (r - e)^2,

r and h the distance of X from a and along it. The rotation t about a that brings n towards X makes
that length stationary. So the passive joint does no work: the limb's line through P + e n pairs
with errors and twists like that of a point, and closure and derivative are those of all limbs.
"""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import Chain, ChainStep, SlotSpec, Values, align, orientation

Steps = tuple[ChainStep, ...]


def turn_about(body: str) -> str:
    """Return the name of the value for the angle t (N,) of the body's offset joint, rad."""
    return f"turn about {body}.axis"


def universal_joint(body: str, on: str = "", own: bool = False) -> Steps:
    """Return the last steps of the chain of the body that carries a universal joint.

    Args:
        body: ``base`` or ``platform``; the slots are its ``axis`` and ``axis_offset``.
        on: the direction to which the joint's carrier is already aligned.
        own: the first axis is parallel to the limb's own z axis there, and so needs no slots.
    """
    axis, offset = f"{body}.axis", f"{body}.axis_offset"
    steps = () if own else (_mount(axis, on, turn_about(body)),)
    return (*steps, _arm(offset, "" if own else axis, turn_about(body)))


def _mount(axis: str, on: str, turn: str) -> ChainStep:
    """Rotation that carries local z onto the first axis, given in the body's axes."""
    plain = align(axis)

    def back(values: Values) -> Array:
        return np.swapaxes(orientation(values[on]), -1, -2) if on else np.eye(3)

    def motor(values: Values) -> Array:
        return cga.compose(cga.motor_from_matrix(back(values), np.zeros(3)), plain.motor(values))

    def twists(values: Values) -> list[tuple[str, Array]]:
        turned = back(values)
        turns = [(name, (turned @ twist[..., :3, None])[..., 0])
                 for name, twist in plain.twists(values)]
        return [(name, np.concatenate([w, np.zeros_like(w)], axis=-1)) for name, w in turns]

    slots = tuple(SlotSpec(s.name, s.quantity, s.tolerance_class, s.default, axis)
                  for s in plain.slots)
    return ChainStep(slots, motor, twists, needs=turn)


def _arm(offset: str, axis: str, turn: str) -> ChainStep:
    """Translation by ``offset`` perpendicular to local z, towards the limb's other end."""

    def towards(values: Values) -> Array:
        t = np.asarray(values[turn], dtype=float)
        return np.stack([np.cos(t), np.sin(t), np.zeros_like(t)], axis=-1)

    def motor(values: Values) -> Array:
        e = np.asarray(values[offset], dtype=float)
        return cga.translator(e[..., None] * towards(values))

    def twists(values: Values) -> list[tuple[str, Array]]:
        n = towards(values)
        return [(offset, np.concatenate([np.zeros_like(n), n], axis=-1))]

    return ChainStep((SlotSpec(offset, "length", "length", 0.0, axis),), motor, twists, needs=turn)


def offset_slot(chain: Chain) -> SlotSpec | None:
    """Return the slot of the axis offset at a chain's end, None if there is none."""
    last = chain.steps[-1] if chain.steps else None
    if last is None or not last.needs or last.slots[0].wheel:
        return None
    return last.slots[0]


def turn_towards(chain: Chain, values: Values, other_end: Array) -> dict[str, Array]:
    """Return the angle t (N,), rad, of a chain's last joint towards the limb's other end, by name.

    It is nan if that end is within the offset of the first axis: there the joint can rotate freely
    or would have to flip, and its angle is undetermined.

    Args:
        chain: of the body that carries the joint.
        values: of the limb's slots, SI.
        other_end: the limb's other end, in that body's axes (N, 3), m.
    """
    name = chain.steps[-1].needs
    before, _ = Chain(chain.steps[:-1]).evaluate({**values, name: 0.0}, ())
    seen = cga.move_point(cga.reverse(before), other_end)
    slot = offset_slot(chain)
    e = np.abs(np.asarray(values[slot.name] if slot else 0.0, dtype=float))
    r = np.hypot(seen[..., 0], seen[..., 1])
    turn = np.arctan2(seen[..., 1], seen[..., 0])
    return {name: np.where((r <= e) & (e > 0.0), np.nan, turn)}
