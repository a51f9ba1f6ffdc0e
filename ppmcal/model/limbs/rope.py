"""Ropes: cables, belts and strings from an anchor, or from a pulley's exit, to the platform.

A rope that pulls is as long as its two ends are apart. What its winch or motor says is
u = ratio q + offset: the offset is what of it is always paid out, or never counted.
"""

from __future__ import annotations

from ppmcal.model.limbs.chain import Chain, U, shift, slide
from ppmcal.model.limbs.kind import LimbKind, register
from ppmcal.model.limbs.surfaces import SPHERE


def _rope(name: str, planar: bool, in_plane: str = "") -> LimbKind:
    return LimbKind(
        name, planar, SPHERE,
        base=Chain((shift("base.point", planar=planar),)),
        middle=Chain((slide(U, "x" if planar else "z"),)),
        platform=Chain((shift("platform.point", planar=planar),)),
        actuator="length", branch="branch", strut=True, closes_when="|B-A| = u",
        source="[IK] eq. 42 without joints", in_plane=in_plane, written="rope", pulls_only=True)


register(_rope("planar rope", planar=True))
register(_rope("rope", planar=False, in_plane="planar rope"))
