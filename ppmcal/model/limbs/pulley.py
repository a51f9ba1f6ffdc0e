"""Pulleys over which a rope leaves the base: on the tangent, as long as tangent and arc together.

Of a pulley of radius r the rope leaves at E = C + r n(t) along the tangent to the platform's point
X, after the arc r w that it lies on:

    u = r w + |X - E|.

A turn of t winds on as much as it lets off (an involute): t is stationary, and so is the swivel of
a pulley that turns about the rope that comes onto it. So the derivative of the closure is the one
line from E to X, as for a rope from a point, and so is that of a sphere about E.

A rope that leaves a fixed sheave at an angle h/l to its plane bends at E; of the free length l its
part f lies in that plane. Then t is not stationary. The derivative is the line from E + k n to X,
k = r (l - f)/f: less than 1 mm beside E for a sheave of 50 mm that is left at 10 degrees.

Either way c = |X - E| + r w - u is told as a sphere about E + k n which has that value and that
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
"""Under which names the values hold how the rope leaves (N,): rad, and m for k."""
X, Z = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Pulley:
    """What a rope leaves over.

    Attributes:
        key: by which a file names it under ``base``.
        leaves: (values, the platform's point in the axes of the pulley (..., 3)) -> how the rope
            leaves, for the steps of the limb's chains; nan where that point is inside the pulley.
    """

    key: str
    leaves: Callable[[Values, Array], dict[str, Array]]

    @property
    def radius(self) -> str:
        """Name of its slot."""
        return f"base.{self.key}.radius"


def _wrap(angle: Array) -> Array:
    """Return an arc between a quarter turn less than none and one less than a whole turn, rad."""
    return np.asarray(np.mod(angle + 0.5 * np.pi, 2.0 * np.pi) - 0.5 * np.pi)


def _tangent(r: Array, away: Array) -> Array:
    """Return the length of the tangent from a point so far ``away`` from the centre."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(away * away - r * r))


def _leaves_sheave(values: Values, seen: Array) -> dict[str, Array]:
    """Return how a rope leaves a fixed sheave about z, wound in the sense of z from x on."""
    r = np.asarray(values[SHEAVE.radius], dtype=float)
    free = _tangent(r, np.hypot(seen[..., 0], seen[..., 1]))
    turn = np.arctan2(seen[..., 1], seen[..., 0]) - np.arctan2(free, r)
    return {EXIT: turn, WRAP: _wrap(turn), LEAN: r * (np.hypot(free, seen[..., 2]) - free) / free}


def _leaves_swivel(values: Values, seen: Array) -> dict[str, Array]:
    """Return how a rope leaves a pulley that has turned about z, on which it comes, towards X."""
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
    """Return the chains of base and rope over a pulley that turns about the rope that comes."""

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

    It has no errors: those of ``zero`` are those of the rope's offset.
    """

    def motor(values: Values) -> Array:
        return cga.motor_from_matrix(orientation(values[axis], values[zero]), np.zeros(3))

    return ChainStep((), motor, lambda values: [], constants=(axis, zero))


def _exit(pulley: Pulley, motor: Callable[[Values], Array], towards: Callable[[Values], Array]
          ) -> ChainStep:
    """Translation to where the rope leaves; ``towards``: by how much with the radius (..., 3)."""

    def twists(values: Values) -> list[tuple[str, Array]]:
        n = towards(values)
        return [(pulley.radius, np.concatenate([np.zeros_like(n), n], axis=-1))]

    return ChainStep((SlotSpec(pulley.radius, "length", "length", wheel=True),), motor, twists,
                     needs=EXIT)


def _rope(pulley: Pulley, along: Array, across: Array) -> ChainStep:
    """The rope that is not on the pulley, driven: u - r w ``along``, and k ``across``."""
    unit = np.concatenate([np.zeros(3), along])

    def motor(values: Values) -> Array:
        free = np.asarray(values[U] - values[pulley.radius] * values.get(WRAP, 0.0), dtype=float)
        lean = np.asarray(values.get(LEAN, 0.0), dtype=float)
        return cga.translator(free[..., None] * along + lean[..., None] * across)

    def twists(values: Values) -> list[tuple[str, Array]]:
        wrap = np.asarray(values.get(WRAP, 0.0), dtype=float)
        return [(U, unit), (pulley.radius, -wrap[..., None] * unit)]

    return ChainStep((), motor, twists, drive=True)
