"""Planar limbs whose passive joints are R and R: a point on a circle (sphere in space)."""

from __future__ import annotations

from ppmcal.limbs.chain import Chain, U, joint, shift, slide, turn
from ppmcal.limbs.kind import LimbKind, register
from ppmcal.limbs.surfaces import SPHERE

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
