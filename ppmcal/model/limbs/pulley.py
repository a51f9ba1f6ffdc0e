"""Pulleys over which a rope leaves the base: its length is that of the tangent plus the arc.

From a pulley of radius r the rope leaves at E = C + r n(t) along the tangent to the platform's
point X, after the arc r w of contact:

    u = r w + |X - E|.

A change of t winds on as much as it pays out (an involute): u is stationary in t, and so it is in
the swivel angle of a pulley that swivels about the incoming rope. So the derivative of the closure
is the single line from E to X, as for a rope from a point, and equals that of a sphere about E.

A rope that leaves a fixed sheave at an angle h/l to its plane bends at E; f is the component of the
free length l in that plane. Then u is not stationary in t. The derivative is the line from E + k n
to X, k = r (l - f)/f: less than 1 mm from E for a sheave of 50 mm and an angle of 10 degrees.

In both cases c = |X - E| + r w - u is expressed by a sphere about E + k n with the same value and
derivative at X (:data:`surfaces.OVER_SHEAVE`, :data:`surfaces.OVER_SWIVEL`), whether the limb
closes or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import (
    Chain,
    ChainStep,
    SlotSpec,
    U,
    Values,
    align,
    orientation,
    shift,
)

EXIT, SWIVEL, WRAP, LEAN = "pulley.exit", "pulley.swivel", "pulley.wrap", "pulley.lean"
"""Names of the values for how the rope leaves (N,): rad, and m for k."""
X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Pulley:
    """A pulley over which a rope leaves.

    Attributes:
        key: its key in files under ``base``.
        leaves: (values, the platform's point in the axes of the pulley (..., 3)) -> how the rope
            leaves, for the steps of the limb's chains; nan if that point is inside the pulley.
    """

    key: str
    leaves: Callable[[Values, Array], dict[str, Array]]

    @property
    def radius(self) -> str:
        """Name of its slot."""
        return f"base.{self.key}.radius"


def _wrap(angle: Array) -> Array:
    """Return an arc between -pi/2 and 3 pi/2, rad."""
    return np.asarray(np.mod(angle + 0.5 * np.pi, 2.0 * np.pi) - 0.5 * np.pi)


def _tangent(r: Array, away: Array) -> Array:
    """Return the length of the tangent from a point at distance ``away`` from the centre."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(away * away - r * r))


def _leaves_sheave(values: Values, seen: Array) -> dict[str, Array]:
    """Return how a rope leaves a fixed sheave about z, wound positively about z starting at x."""
    r = np.asarray(values[SHEAVE.radius], dtype=float)
    free = _tangent(r, np.hypot(seen[..., 0], seen[..., 1]))
    turn = np.arctan2(seen[..., 1], seen[..., 0]) - np.arctan2(free, r)
    return {EXIT: turn, WRAP: _wrap(turn), LEAN: r * (np.hypot(free, seen[..., 2]) - free) / free}


def _leaves_swivel(values: Values, seen: Array) -> dict[str, Array]:
    """Return how a rope leaves a pulley that swivels towards X about z, the incoming rope."""
    r = np.asarray(values[SWIVELLING.radius], dtype=float)
    out, up = np.hypot(seen[..., 0], seen[..., 1]) - r, seen[..., 2]
    wrap = _wrap(np.arctan2(up, -out) - np.arctan2(_tangent(r, np.hypot(out, up)), r))
    return {EXIT: wrap, WRAP: wrap, SWIVEL: np.arctan2(seen[..., 1], seen[..., 0])}


SHEAVE, SWIVELLING = Pulley("pulley", _leaves_sheave), Pulley("swivel_pulley", _leaves_swivel)


def over_sheave(planar: bool) -> tuple[Chain, Chain]:
    """Return the chains of base and rope over a sheave whose axis is fixed to the base."""
    names = ("base.pulley.axis", "base.pulley.zero")
    axis = _upright(*names) if planar else align(*names)

    def towards(values: Values) -> Array:
        t = np.asarray(values[EXIT], dtype=float)
        return np.stack([np.cos(t), np.sin(t), np.zeros_like(t)], axis=-1)

    def motor(values: Values) -> Array:
        out = np.asarray(values[SHEAVE.radius] + values[LEAN], dtype=float)
        return cga.compose(cga.rotor(Z, np.asarray(values[EXIT], dtype=float)),
                           cga.translator(out[..., None] * X))

    return (Chain((shift("base.pulley.center", planar), axis, _exit(SHEAVE, motor, towards))),
            Chain((_rope(SHEAVE, *((X, Z) if planar else (Z, X))),)))


def over_swivel() -> tuple[Chain, Chain]:
    """Return the chains of base and rope over a pulley that swivels about the incoming rope."""

    def towards(values: Values) -> Array:
        t, wrap = (np.asarray(values[n], dtype=float) for n in (SWIVEL, EXIT))
        out = 1.0 - np.cos(wrap)
        return np.stack([out * np.cos(t), out * np.sin(t), np.sin(wrap)], axis=-1)

    def motor(values: Values) -> Array:
        r = np.asarray(values[SWIVELLING.radius], dtype=float)
        return cga.translator(r[..., None] * towards(values))

    return (Chain((shift("base.swivel_pulley.point", False), align("base.swivel_pulley.axis"),
                   _exit(SWIVELLING, motor, towards))), Chain((_rope(SWIVELLING, Z, X),)))


def _upright(axis: str, zero: str) -> ChainStep:
    """Rotation that carries local z onto ``axis``, up or down, and local x onto ``zero``.

    It has no error slots: those of ``zero`` are equivalent to the rope's offset.
    """

    def motor(values: Values) -> Array:
        return cga.motor_from_matrix(orientation(values[axis], values[zero]), np.zeros(3))

    return ChainStep((), motor, lambda values: [], constants=(axis, zero))


def _exit(pulley: Pulley, motor: Callable[[Values], Array], towards: Callable[[Values], Array]
          ) -> ChainStep:
    """Translation to where the rope leaves; ``towards``: its derivative by the radius (..., 3)."""

    def twists(values: Values) -> list[tuple[str, Array]]:
        n = towards(values)
        return [(pulley.radius, np.concatenate([np.zeros_like(n), n], axis=-1))]

    return ChainStep((SlotSpec(pulley.radius, "length", "length", wheel=True),), motor, twists,
                     needs=EXIT)


def _rope(pulley: Pulley, along: Array, across: Array) -> ChainStep:
    """The rope off the pulley, driven: u - r w ``along``, and k ``across``."""
    unit = np.concatenate([np.zeros(3), along])

    def motor(values: Values) -> Array:
        free = np.asarray(values[U] - values[pulley.radius] * values.get(WRAP, 0.0), dtype=float)
        lean = np.asarray(values.get(LEAN, 0.0), dtype=float)
        return cga.translator(free[..., None] * along + lean[..., None] * across)

    def twists(values: Values) -> list[tuple[str, Array]]:
        wrap = np.asarray(values.get(WRAP, 0.0), dtype=float)
        return [(U, unit), (pulley.radius, -wrap[..., None] * unit)]

    return ChainStep((), motor, twists, drive=True)
