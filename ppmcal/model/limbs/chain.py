"""Chains of elementary motions, and the error twists of their slots.

A limb is three chains joined by its two passive joints: *base* (base frame to the first
passive joint), *middle* (first to second passive joint) and *platform* (platform frame to
the second passive joint). Each chain is a product of elementary motors ([PPM] eq. 13-15),

    chain(g, u) = E1 E2 ... En,

and a change of one slot moves everything after its element by a twist. In the chain's root axes
that twist is ``Ad(E1...Ei-1) b``, with ``b`` the element's own constant generator: this is all that
the error model needs of a limb.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array

Values = Mapping[str, Any]
"""Slot name -> scalar or (N,) array, direction name -> (3,) array, all SI; for L limbs together
(1, L) or (N, L), and (1, L, 3)."""

AXES = {
    "x": (1.0, 0.0, 0.0),
    "y": (0.0, 1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
    "-y": (0.0, -1.0, 0.0),
}
JOINT_COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
U = "u"
"""The name under which the values hold the actuated joint's coordinate."""


@dataclass(frozen=True)
class SlotSpec:
    """One scalar of a limb kind: its name, quantity, and default.

    ``quantity`` is ``length`` or ``angle``; ``tolerance_class`` the key of the file's
    ``tolerances`` that covers it. ``default`` is None if the file must give a value; ``needs`` the
    direction without which a limb has no such slot; ``wheel``: it is the radius of a pulley.
    """

    name: str
    quantity: str
    tolerance_class: str
    default: float | None = None
    needs: str = ""
    wheel: bool = False

    @property
    def is_bar(self) -> bool:
        """Whether it is the length of a bar: positive and always given, unlike an offset."""
        return self.tolerance_class == "length" and self.default is None and not self.wheel


@dataclass(frozen=True)
class ChainStep:
    """One elementary motion of a chain.

    ``motor(values)`` is the motion (..., 8); ``twists(values)`` yields for each slot the
    generator (..., 6) in the axes before the step, as ``(slot name, twist)``. A step that
    ``needs`` a missing value is skipped. A ``drive`` moves by u along the single twist that it
    yields, which does not depend on u (:mod:`driven`).
    """

    slots: tuple[SlotSpec, ...]
    motor: Callable[[Values], Array]
    twists: Callable[[Values], list[tuple[str, Array]]]
    joint: bool = False
    constants: tuple[str, ...] = ()
    needs: str = ""
    drive: bool = False


def _unit(kind: str, direction: Any) -> Array:
    zero = np.zeros(3)
    d = np.asarray(direction, dtype=float)
    return np.concatenate([d, zero] if kind == "rotation" else [zero, d])


def shift(name: str, planar: bool) -> ChainStep:
    """Translation by the point ``name`` (slots ``name.x``, ``.y``, and ``.z`` in space)."""
    axes = ("x", "y") if planar else ("x", "y", "z")
    names = [f"{name}.{a}" for a in axes]
    units = [_unit("translation", AXES[a]) for a in axes]

    def motor(values: Values) -> Array:
        parts = [np.asarray(values[n], dtype=float) for n in names]
        if planar:
            parts.append(np.zeros(()))
        return cga.translator(np.stack(np.broadcast_arrays(*parts), axis=-1))

    slots = tuple(SlotSpec(n, "length", "point") for n in names)
    return ChainStep(slots, motor, lambda values: list(zip(names, units, strict=True)))


def slide(
    name: str, axis: str, default: float | None = None, along: str | None = None
) -> ChainStep:
    """Translation by slot ``name`` (or the joint ``u``) along a local axis.

    ``along`` names a constant that overrides the axis with a fixed local direction.
    """

    def direction(values: Values) -> Array:
        return np.asarray(values[along] if along else AXES[axis], dtype=float)

    def motor(values: Values) -> Array:
        return cga.translator(np.asarray(values[name], dtype=float)[..., None] * direction(values))

    slots = () if name == U else (SlotSpec(name, "length", "length", default),)
    return ChainStep(slots, motor, lambda values: [(name, _unit("translation", direction(values)))],
                     drive=name == U)


def turn(name: str) -> ChainStep:
    """Rotation about the local z axis by slot ``name`` (or the joint ``u``), in rad."""
    unit = _unit("rotation", AXES["z"])

    def motor(values: Values) -> Array:
        return cga.rotor(np.array(AXES["z"]), np.asarray(values[name], dtype=float))

    slots = () if name == U else (SlotSpec(name, "angle", "angle"),)
    return ChainStep(slots, motor, lambda values: [(name, unit)], drive=name == U)


def align(name: str, zero: str | None = None) -> ChainStep:
    """Rotation that carries local z onto the direction ``name`` (and local x onto ``zero``).

    Its error is the rotation vector ``name.rx, .ry, .rz`` in the axes before the step, applied
    after the nominal orientation, so that ``zero`` rotates with the axis.
    """
    names = [f"{name}.{c}" for c in ("rx", "ry", "rz")]

    def motor(values: Values) -> Array:
        nominal = cga.motor_from_matrix(orientation(values[name], values[zero] if zero else None),
                                        np.zeros(3))
        return cga.compose(cga.motor_from_rotation_vector(_stack(values, names), np.zeros(3)),
                           nominal)

    def twists(values: Values) -> list[tuple[str, Array]]:
        turns = left_jacobian(_stack(values, names))
        return [(n, np.concatenate([turns[..., k], np.zeros_like(turns[..., k])], axis=-1))
                for k, n in enumerate(names)]

    slots = tuple(SlotSpec(n, "angle", "angle", 0.0) for n in names)
    return ChainStep(slots, motor, twists, constants=(name, zero) if zero else (name,))


def joint(number: int, axis: str = "z") -> ChainStep:
    """Frame error of joint ``number``: six components in its own axes ([PPM] eq. 13-14).

    The joint's own z axis lies along the local axis ``axis``; its x and y follow
    cyclically. The frame is carried by the link before the joint, so the components are
    constant while the joint moves.
    """
    names = [f"joint{number}.{c}" for c in JOINT_COMPONENTS]
    # columns: the joint's x, y, z axes in local axes
    turn_to_joint = np.eye(3) if axis == "z" else np.eye(3)[:, [1, 2, 0]]

    def motor(values: Values) -> Array:
        c = _stack(values, names)
        return cga.motor_from_rotation_vector(c[..., 3:] @ turn_to_joint.T,
                                              c[..., :3] @ turn_to_joint.T)

    def twists(values: Values) -> list[tuple[str, Array]]:
        c = _stack(values, names)
        t, r = c[..., :3] @ turn_to_joint.T, c[..., 3:] @ turn_to_joint.T
        out = [(n, _unit("translation", turn_to_joint[:, k])) for k, n in enumerate(names[:3])]
        turns = left_jacobian(r) @ turn_to_joint
        for k, n in enumerate(names[3:]):
            w = turns[..., k]
            out.append((n, np.concatenate([w, np.cross(t, w)], axis=-1)))
        return out

    slots = tuple(SlotSpec(n, "angle" if n[-2] == "r" else "length",
                           "angle" if n[-2] == "r" else "point", 0.0) for n in names)
    return ChainStep(slots, motor, twists, joint=True)


def _stack(values: Values, names: Collection[str]) -> Array:
    parts = [np.asarray(values.get(n, 0.0), dtype=float) for n in names]
    return np.stack(np.broadcast_arrays(*parts), axis=-1)


def orientation(axis: Any, zero: Any = None) -> Array:
    """Return the matrices (..., 3, 3): third column ``axis`` (..., 3), first towards ``zero``.

    Without ``zero`` the first column is the base axis least parallel to ``axis``, made
    perpendicular: any choice is valid, since only the third column is then used.
    """
    z = np.asarray(axis, dtype=float)
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    x = np.eye(3)[np.argmin(np.abs(z), axis=-1)] if zero is None else np.asarray(zero, dtype=float)
    x = x - np.sum(x * z, axis=-1, keepdims=True) * z
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def left_jacobian(rotation_vector: Array) -> Array:
    """Return d(rotation)/d(rotation vector) as base-side rotations, (..., 3) -> (..., 3, 3).

    exp(r + dr) = exp(J dr) exp(r), J = I + (1-cos t)/t^2 [r] + (t - sin t)/t^3 [r]^2.
    """
    r = np.asarray(rotation_vector, dtype=float)
    t2 = np.sum(r * r, axis=-1)
    t = np.sqrt(t2)
    small = t2 < 1e-8
    safe = np.where(small, 1.0, t)
    a = np.where(small, 0.5 - t2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    b = np.where(small, 1.0 / 6.0 - t2 / 120.0, (safe - np.sin(safe)) / safe**3)
    k = cross_matrix(r)
    out: Array = np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k)
    return out


def cross_matrix(v: Array) -> Array:
    """Return [v] with [v] w = v x w, (..., 3) -> (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


@dataclass(frozen=True)
class ErrorTwists:
    """Error twists of one step's slots: generators in the axes before the step.

    ``names`` (K,); ``to_root`` (8,), (N, 8) or for L limbs (1 or N, L, 8): the chain up to the
    step; ``generators`` (K, 6), or one set for each of these. In the chain's root axes each twist
    is Ad(to_root) generator.
    """

    names: tuple[str, ...]
    to_root: Array
    generators: Array

    def twists(self) -> Array:
        """Return the twists in root axes (..., K, 6)."""
        return cga.adjoint_twist(self.to_root[..., None, :], self.generators)

    def pairing(self, lines: Array, picked: Sequence[int]) -> Array:
        """Return the pairing of lines (N, ..., k, 6), root axes, with some twists (N, ..., k, K).

        If the chain moves from pose to pose, one line is transformed to the step's axes instead of
        all twists to the root: the same result at lower cost.
        """
        if self.to_root.ndim == 1 or self.to_root.shape[0] == 1:
            generators = self.twists()[..., picked, :]
        else:
            lines = cga.move_line(cga.reverse(self.to_root)[..., None, :], lines)
            generators = self.generators[..., picked, :]
        swapped = np.concatenate([lines[..., 3:], lines[..., :3]], axis=-1)
        return np.asarray(swapped @ np.swapaxes(generators, -1, -2), dtype=float)


@dataclass(frozen=True)
class Chain:
    """A product of steps, evaluated for all poses at once."""

    steps: tuple[ChainStep, ...]

    def evaluate(self, values: Values, wanted: Collection[str],
                 start: tuple[Array, tuple[ErrorTwists, ...]] | None = None
                 ) -> tuple[Array, tuple[ErrorTwists, ...]]:
        """Return the chain's motor (..., 8) and the error twists of the ``wanted`` slots.

        Joint frames whose components are all zero and unwanted are skipped. ``start``: the result
        for the steps before these.
        """
        total, moved = cga.identity_motor(), False
        carried: list[ErrorTwists] = []
        if start is not None:
            total, moved, carried = start[0], True, [*start[1]]
        for step in self.steps:
            if step.joint and not any(s.name in wanted or (s.name in values and np.any(
                    values[s.name])) for s in step.slots):
                continue
            if step.needs and step.needs not in values:
                continue
            asked = step.drive or any(s.name in wanted for s in step.slots)
            mine = [(name, twist) for name, twist in step.twists(values)
                    if name in wanted] if asked else []
            if mine:
                stacked = np.stack(np.broadcast_arrays(*(t for _, t in mine)), axis=-2)
                carried.append(ErrorTwists(tuple(n for n, _ in mine), total, stacked))
            motor = step.motor(values)
            total, moved = cga.compose(total, motor) if moved else motor, True
        return total, tuple(carried)
