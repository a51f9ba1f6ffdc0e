"""Planar limbs whose passive joints are R and P: a limb point on a platform-side line."""

from __future__ import annotations

from ppmcal.limbs.chain import Chain, U, joint, shift, slide, turn
from ppmcal.limbs.kind import LimbKind, register
from ppmcal.limbs.surfaces import PLATFORM_PLANE

_BASE = shift("base.point", planar=True)
_PLATFORM = Chain((shift("platform.point", planar=True), turn("platform.angle")))

register(LimbKind(
    "(R)RP", True, PLATFORM_PLANE,
    base=Chain((_BASE, joint(1), turn(U), slide("proximal", "x"), joint(2))),
    middle=Chain((slide("lateral", "-y", 0.0), joint(3, "x"))),
    platform=_PLATFORM, actuator="angle", branch="branch",
    closes_when="n(psi).(A + proximal d(u) - B) = lateral", source="[PPM] section 3.1"))

register(LimbKind(
    "R(R)P", True, PLATFORM_PLANE,
    base=Chain((_BASE, joint(1))),
    middle=Chain((slide("proximal", "x"), joint(2), turn(U), joint(3, "x"))),
    platform=_PLATFORM, actuator="angle", branch="branch",
    closes_when="n(psi).(B-A) + proximal sin u = 0", source="[PPM] section 3.1"))

register(LimbKind(
    "R(P)P", True, PLATFORM_PLANE,
    base=Chain((_BASE, joint(1))),
    middle=Chain((joint(2, "x"), slide(U, "x"), turn("slide_angle"), joint(3, "x"))),
    platform=_PLATFORM, actuator="length",
    closes_when="n(psi).(B-A) + u sin sigma = 0", source="[PPM] section 3.1"))

register(LimbKind(
    "(P)RP", True, PLATFORM_PLANE,
    base=Chain((_BASE, turn("base.angle"), joint(1, "x"), slide(U, "x"), joint(2))),
    middle=Chain((joint(3, "x"),)),
    platform=_PLATFORM, actuator="length",
    closes_when="n(psi).(A + u d(alpha) - B) = 0", source="[PPM] section 3.1"))
