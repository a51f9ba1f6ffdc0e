"""Planar limbs: a point on a circle, a line of the base, or a line of the platform."""

from __future__ import annotations

from ppmcal.model.limbs.chain import Chain, U, joint, shift, slide, turn
from ppmcal.model.limbs.kind import LimbKind, register
from ppmcal.model.limbs.surfaces import BASE_PLANE, PLATFORM_PLANE, SPHERE

_BASE = shift("base.point", planar=True)
_PLATFORM = Chain((shift("platform.point", planar=True),))

register(LimbKind(
    "R(P)R", True, SPHERE,
    base=Chain((_BASE, joint(1))),
    middle=Chain((joint(2, "x"), slide(U, "x"), slide("lateral", "y", 0.0), joint(3))),
    platform=_PLATFORM, actuator="length", branch="branch",
    closes_when="|B-A|^2 = u^2 + lateral^2", source="[PPM] section 4.1, eq. 39"))

register(LimbKind(
    "(R)RR", True, SPHERE,
    base=Chain((_BASE, joint(1), turn(U), slide("proximal", "x"), joint(2))),
    middle=Chain((slide("distal", "x"), joint(3))),
    platform=_PLATFORM, actuator="angle", branch="elbow", branch_sign=-1,
    closes_when="|B - A - proximal d(u)| = distal", source="[PPM] section 3.1"))

register(LimbKind(
    "R(R)R", True, SPHERE,
    base=Chain((_BASE, joint(1))),
    middle=Chain((slide("proximal", "x"), joint(2), turn(U), slide("distal", "x"), joint(3))),
    platform=_PLATFORM, actuator="angle", branch="elbow",
    closes_when="|B-A|^2 = proximal^2 + distal^2 + 2 proximal distal cos u",
    source="[PPM] section 3.1"))

register(LimbKind(
    "(P)RR", True, SPHERE,
    base=Chain((_BASE, turn("base.angle"), joint(1, "x"), slide(U, "x"), joint(2))),
    middle=Chain((slide("length", "x"), joint(3))),
    platform=_PLATFORM, actuator="length", branch="branch",
    closes_when="|B - A - u d(alpha)| = length", source="[PPM] section 3.1"))

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


_PLATFORM_LINE = Chain((shift("platform.point", planar=True), turn("platform.angle")))

register(LimbKind(
    "(R)RP", True, PLATFORM_PLANE,
    base=Chain((_BASE, joint(1), turn(U), slide("proximal", "x"), joint(2))),
    middle=Chain((slide("lateral", "-y", 0.0), joint(3, "x"))),
    platform=_PLATFORM_LINE, actuator="angle", branch="branch",
    closes_when="n(psi).(A + proximal d(u) - B) = lateral", source="[PPM] section 3.1"))

register(LimbKind(
    "R(R)P", True, PLATFORM_PLANE,
    base=Chain((_BASE, joint(1))),
    middle=Chain((slide("proximal", "x"), joint(2), turn(U), joint(3, "x"))),
    platform=_PLATFORM_LINE, actuator="angle", branch="branch",
    closes_when="n(psi).(B-A) + proximal sin u = 0", source="[PPM] section 3.1"))

register(LimbKind(
    "R(P)P", True, PLATFORM_PLANE,
    base=Chain((_BASE, joint(1))),
    middle=Chain((joint(2, "x"), slide(U, "x"), turn("slide_angle"), joint(3, "x"))),
    platform=_PLATFORM_LINE, actuator="length",
    closes_when="n(psi).(B-A) + u sin sigma = 0", source="[PPM] section 3.1"))

register(LimbKind(
    "(P)RP", True, PLATFORM_PLANE,
    base=Chain((_BASE, turn("base.angle"), joint(1, "x"), slide(U, "x"), joint(2))),
    middle=Chain((joint(3, "x"),)),
    platform=_PLATFORM_LINE, actuator="length",
    closes_when="n(psi).(A + u d(alpha) - B) = 0", source="[PPM] section 3.1"))
