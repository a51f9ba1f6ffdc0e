"""Planar limbs whose passive joints are P and R: a platform point on a base-side line."""

from __future__ import annotations

from ppmcal.limbs.chain import Chain, U, joint, shift, slide, turn
from ppmcal.limbs.kind import LimbKind, register
from ppmcal.limbs.surfaces import BASE_PLANE

_BASE = shift("base.point", planar=True)
_PLATFORM = Chain((shift("platform.point", planar=True),))

register(LimbKind(
    "(R)PR", True, BASE_PLANE,
    base=Chain((_BASE, joint(1), turn(U), joint(2, "x"))),
    middle=Chain((slide("lateral", "y", 0.0), joint(3))),
    platform=_PLATFORM, actuator="angle", branch="branch",
    closes_when="n(u).(B-A) = lateral", source="[PPM] section 3.1"))

register(LimbKind(
    "P(R)R", True, BASE_PLANE,
    base=Chain((_BASE, turn("base.angle"), joint(1, "x"))),
    middle=Chain((joint(2), turn(U), slide("length", "x"), joint(3))),
    platform=_PLATFORM, actuator="angle", branch="branch",
    closes_when="n(alpha).(B - A - length d(alpha+u)) = 0", source="[PPM] section 3.1"))

register(LimbKind(
    "(P)PR", True, BASE_PLANE,
    base=Chain((_BASE, turn("base.angle"), joint(1, "x"), slide(U, "x"),
                turn("slide_angle"), joint(2, "x"))),
    middle=Chain((joint(3),)),
    platform=_PLATFORM, actuator="length",
    closes_when="n(alpha+sigma).(B - A - u d(alpha)) = 0", source="[PPM] section 3.1"))

register(LimbKind(
    "P(P)R", True, BASE_PLANE,
    base=Chain((_BASE, turn("base.angle"), joint(1, "x"))),
    middle=Chain((turn("slide_angle"), joint(2, "x"), slide(U, "x"), joint(3))),
    platform=_PLATFORM, actuator="length",
    closes_when="n(alpha).(B - A - u d(alpha+sigma)) = 0", source="[PPM] section 3.1"))
