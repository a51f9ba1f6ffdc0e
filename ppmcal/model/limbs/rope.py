"""Ropes: cables, belts and strings from an anchor, or over a pulley, to the platform.

A taut rope is as long as the distance of its two ends, plus the arc on its pulley (:mod:`pulley`).
Its winch or motor gives u = ratio q + offset: the offset is a length that is always paid out, or
never counted. In files all of them are called ``rope``; the pulley selects the kind.
"""

from __future__ import annotations

from ppmcal.model.limbs.chain import Chain, U, shift, slide
from ppmcal.model.limbs.kind import LimbKind, Surface, register
from ppmcal.model.limbs.pulley import SHEAVE, SWIVELLING, Pulley, over_sheave, over_swivel
from ppmcal.model.limbs.surfaces import OVER_SHEAVE, OVER_SHEAVE_IN_PLANE, OVER_SWIVEL, SPHERE


def _rope(name: str, planar: bool, base: Chain, middle: Chain, surface: Surface = SPHERE,
          pulley: Pulley | None = None, closes_when: str = "|B-A| = u",
          source: str = "[IK] eq. 42 without joints") -> LimbKind:
    return LimbKind(
        name, planar, surface, base=base, middle=middle,
        platform=Chain((shift("platform.point", planar=planar),)),
        actuator="length", branch="branch", strut=True, closes_when=closes_when, source=source,
        written="rope", pulls_only=True, pulley=pulley,
        effect="rope_elasticity")


OVER = "radius wrap + |B-E| = u, E where it leaves the pulley"
SOURCE = "Pott: Cable-driven parallel robots (2018), pulley kinematics"

for _planar in (True, False):
    _name = "planar rope" if _planar else "rope"
    register(_rope(_name, _planar, Chain((shift("base.point", planar=_planar),)),
                   Chain((slide(U, "x" if _planar else "z"),))))
    register(_rope(f"{_name} over a pulley", _planar, *over_sheave(_planar),
                   OVER_SHEAVE_IN_PLANE if _planar else OVER_SHEAVE, SHEAVE, OVER, SOURCE))

register(_rope("rope over a swivel pulley", False, *over_swivel(), OVER_SWIVEL, SWIVELLING, OVER,
               SOURCE))
