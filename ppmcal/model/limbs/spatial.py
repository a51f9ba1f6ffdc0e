"""Spatial limbs: U-S legs (a point on a sphere) and the R-S leg (a point on a circle).

The two axes of a U need not intersect (:mod:`axis_offset`). Its first axis is fixed to the base of
a U(P)S; to the carriage of a (P)US, which slides without rotating and is misaligned with its rail;
and, parallel to the crank's, to the arm of an (R)US; or to the platform, if the U is there and the
ball at the limb's other end.
"""

from __future__ import annotations

from ppmcal.model.limbs.axis_offset import universal_joint
from ppmcal.model.limbs.chain import Chain, U, align, joint, shift, slide, turn
from ppmcal.model.limbs.kind import LimbKind, register
from ppmcal.model.limbs.surfaces import CIRCLE, SPHERE

_BASE = shift("base.point", planar=False)
_POINT = shift("platform.point", planar=False)
_PLATFORM = Chain((_POINT, *universal_joint("platform")))

UPS = register(LimbKind(
    "U(P)S", False, SPHERE,
    base=Chain((_BASE, joint(1), *universal_joint("base"))),
    middle=Chain((joint(2), slide(U, "z"), joint(3))),
    platform=_PLATFORM, actuator="length", branch="branch", strut=True,
    closes_when="|B-A| = u", source="[IK] eq. 42, [LIN] section 2.1"))

PUS = register(LimbKind(
    "(P)US", False, SPHERE,
    base=Chain((_BASE, align("base.direction"), joint(1), slide(U, "z"), joint(2),
                *universal_joint("base", on="base.direction"))),
    middle=Chain((slide("length", "z"), joint(3))),
    platform=_PLATFORM, actuator="length", branch="branch",
    closes_when="|B - A - u direction| = length", source="[LIN] section 2.1"))

RUS = register(LimbKind(
    "(R)US", False, SPHERE,
    base=Chain((_BASE, align("base.axis", "base.zero"), joint(1), turn(U),
                slide("proximal", "x"), joint(2), *universal_joint("base", own=True))),
    middle=Chain((slide("distal", "z"), joint(3))),
    platform=_PLATFORM, actuator="angle", branch="branch",
    closes_when="|B - A - proximal Rot(axis, u) zero| = distal", source="[LIN] section 2.1"))

register(LimbKind(
    "R(P)S", False, CIRCLE,
    base=Chain((_BASE, align("base.axis"), joint(1))),
    middle=Chain((joint(2, "x"), slide(U, "x"), slide("lateral", "z", 0.0), joint(3))),
    platform=Chain((_POINT,)), actuator="length", branch="branch",
    closes_when="|B-A|^2 = u^2 + lateral^2 and axis.(B-A) = lateral",
    source="[IK] section 3.1, eq. 26 and 28"))
