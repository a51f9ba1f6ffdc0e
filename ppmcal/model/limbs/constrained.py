"""Spatial limbs that also constrain the platform's rotation: fewer joints, or parallel axes.

``joint1`` ... number the joints in the name; joints within the limb itself, such as the slide of a
U(P)U, are taken as exact and have no frames. A universal joint's first axis is fixed to the body
that carries it, the second is perpendicular to it.
"""

from __future__ import annotations

from ppmcal.model.limbs.chain import Chain, U, align, joint, shift, slide, turn
from ppmcal.model.limbs.kind import LimbKind, register
from ppmcal.model.limbs.surfaces import (
    BETWEEN_AXES,
    FREE_HINGE,
    HELD_SLIDE,
    HINGE_ON_PLATFORM,
    PLANE_AND_DIRECTION,
    ROD_AND_ANGLE,
    SPHERE_BETWEEN_AXES,
)

_BASE, _POINT = shift("base.point", planar=False), shift("platform.point", planar=False)
_ON_AXIS = Chain((_BASE, align("base.axis"), joint(1)))


def _platform(number: int) -> Chain:
    """Return the chain to a joint whose axis is fixed to the platform."""
    return Chain((_POINT, align("platform.axis"), joint(number)))


register(LimbKind(
    "U(P)U", False, SPHERE_BETWEEN_AXES, base=_ON_AXIS, middle=Chain((slide(U, "z"),)),
    platform=_platform(3), actuator="length", branch="branch", strut=True,
    closes_when="|B-A| = u; base.axis, platform.axis and B-A are in one plane",
    source="Di Gregorio, Parenti-Castelli: A translational 3-DOF parallel manipulator (1998)"))

register(LimbKind(
    "U(P)R", False, HINGE_ON_PLATFORM, base=_ON_AXIS,
    middle=Chain((slide(U, "x"), slide("lateral", "z", 0.0))), platform=_platform(3),
    actuator="length", branch="branch",
    closes_when="|B-A|^2 = u^2 + lateral^2; platform.axis.(B-A) = lateral; platform.axis is "
                "perpendicular to base.axis",
    source="Bi, Jin: Kinematic modeling of Exechon parallel kinematic machine (2011)"))

register(LimbKind(
    "(P)RRR", False, PLANE_AND_DIRECTION,
    base=Chain((_BASE, align("base.axis"), joint(1), slide(U, "z"), joint(2))),
    middle=Chain((slide("lateral", "z", 0.0),)), platform=_platform(4), actuator="length",
    closes_when="base.axis.(B-A) = u + lateral; platform.axis is along base.axis",
    source="Kong, Gosselin: Type synthesis of parallel mechanisms (2007), Tripteron"))

register(LimbKind(
    "(R)RPaU", False, ROD_AND_ANGLE,
    base=Chain((_BASE, align("base.axis", "base.zero"), joint(1), turn(U),
                slide("proximal", "x"), joint(2))),
    middle=Chain((slide("distal", "z"),)), platform=_platform(4), actuator="angle",
    branch="branch",
    closes_when="|B - A - proximal Rot(axis, u) zero| = distal; platform.axis is perpendicular to "
                "base.axis",
    source="Clavel: DELTA, a fast robot with parallel geometry (1988)"))

register(LimbKind(
    "UP", False, HELD_SLIDE, base=_ON_AXIS, middle=Chain(()),
    platform=Chain((_POINT, align("platform.axis", "platform.direction"), joint(2, "x"))),
    actuator="",
    closes_when="A is on the line through B along platform.direction; platform.axis is "
                "perpendicular to base.axis",
    source="Neumann: Tricept, US patent 4732525 (1988)"))

register(LimbKind(
    "UPU", False, BETWEEN_AXES, base=_ON_AXIS, middle=Chain(()), platform=_platform(3),
    actuator="", closes_when="base.axis, platform.axis and B-A are in one plane",
    source="Di Gregorio, Parenti-Castelli: A translational 3-DOF parallel manipulator (1998)"))

register(LimbKind(
    "UPR", False, FREE_HINGE, base=_ON_AXIS, middle=Chain((slide("lateral", "z", 0.0),)),
    platform=_platform(3), actuator="",
    closes_when="platform.axis.(B-A) = lateral; platform.axis is perpendicular to base.axis",
    source="Bi, Jin: Kinematic modeling of Exechon parallel kinematic machine (2011)"))
