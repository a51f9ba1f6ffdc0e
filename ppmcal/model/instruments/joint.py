"""Encoders at a joint of a limb: at a passive joint, or a second one next to the drive's own.

The column ``value`` holds an angle, or a length for a slide: the position of the link after the
joint relative to the one before it, plus an offset, unknown by default. The limb declares its
joints (:mod:`ppmcal.model.limbs.passive_joints`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.errors import BadInput, unknown
from ppmcal.model.instruments.kind import InstrumentKind, register
from ppmcal.model.limbs.passive_joints import joints_of

if TYPE_CHECKING:
    from ppmcal.model.limbs.passive_joints import EncoderJoint
    from ppmcal.model.mechanism import Limb, Mechanism


def _is_ball(joint: EncoderJoint, limb: Limb) -> bool:
    return joint.unless in limb.constants


def _lacks_axis(joint: EncoderJoint, limb: Limb) -> bool:
    return bool(joint.needs) and joint.needs not in limb.constants


def _joints(mechanism: Mechanism) -> list[str]:
    """Return the joints of a machine that can have an encoder, limb by limb."""
    return [f"{limb.name}.{name}" for limb in mechanism.limbs
            for name, joint in joints_of(limb.kind).items()
            if not _is_ball(joint, limb) and not _lacks_axis(joint, limb)]


def _placed(at: str, mechanism: Mechanism, place: str) -> int:
    """Return the coordinate that represents a joint's reading: x for a slide, rz for a rotation."""
    limb_name, _, name = at.rpartition(".")
    limbs = {limb.name: limb for limb in mechanism.limbs}
    named = {f"{n}.{j}" for n, limb in limbs.items() for j in joints_of(limb.kind)}
    if not at:
        raise BadInput("the joint that the encoder is at is missing", place,
                       f"Write one, such as `at: {min(named, default='leg1.joint1')}`")
    if limb_name not in limbs:
        raise unknown("joint", at, sorted(named), place)
    limb = limbs[limb_name]
    joints = joints_of(limb.kind)
    if name not in joints:
        there = ", ".join(f"{limb_name}.{n} ({j.said})" for n, j in joints.items())
        raise BadInput(f"{limb_name}, of kind {limb.kind.called}, has no joint "
                       f"'{name}' with a single angle or length", place,
                       f"Choose one of: {there}" if there else "Choose another limb")
    joint = joints[name]
    if _is_ball(joint, limb):
        raise BadInput(f"{at} is a ball: {limb_name} has its universal joint on the platform",
                       place, "Choose another joint")
    if _lacks_axis(joint, limb):
        raise BadInput(f"{at} is a universal joint, and the mechanism file does not give the "
                       "direction of its first axis, about which the encoder turns", place,
                       f"Give {limb_name} the direction {joint.needs}, such as "
                       f"`{joint.needs.split('.')[0]}: {{axis: [0, 1, 0]}}`")
    return 0 if joint.quantity == "length" else 5


JOINT = register(InstrumentKind(
    "joint", lambda motion: (5,), "value", frame_parts=lambda motion, between: (),
    target_parts=lambda motion, relative: (), opened=(), sigma="value", placed=_placed,
    joints=_joints, assumed={"frame": "known", "target": "known"}))
