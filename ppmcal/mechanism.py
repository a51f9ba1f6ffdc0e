"""Limbs and a platform: stacked closure, pose Jacobian A, joint Jacobian Jq, errors Bg.

Conditions are stacked limb by limb into d rows, as many as the pose has coordinates:

    c(M, q, g) = 0,    A dpose + Jq dq + Bg dg = 0,

with dpose = (platform origin displacement, rotation) in base axes, restricted to the
machine's motion. All three matrices are read off the same leg lines ([LIN] section 2.5,
[IK] eq. 32 and 49): A is the line about the platform origin, Jq and Bg its pairing with
the twist of each joint and slot.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.limbs import Body, LimbKind
from ppmcal.limbs.chain import U
from ppmcal.parameters import Parameter, SlotMap, free_indices, with_values
from ppmcal.units import Units

Array = NDArray[np.float64]

POSE_COORDINATES = ("x", "y", "z", "rx", "ry", "rz")
MOTIONS = {"planar": (0, 1, 5), "translational": (0, 1, 2), "spatial": (0, 1, 2, 3, 4, 5)}
"""Indices into the full pose (x, y, z, rx, ry, rz) that each motion has."""


@dataclass(frozen=True)
class Limb:
    """One limb: its kind, which actuator drives it, its directions, and its slots.

    ``branch`` is the setting as the file gives it (+1, -1 or None); ``constants`` maps
    direction names (``base.axis``) to unit vectors (3,).
    """

    name: str
    kind: LimbKind
    actuator: int
    slots: SlotMap
    constants: Mapping[str, Array] = field(default_factory=dict)
    branch: int | None = None


@dataclass(frozen=True)
class Registration:
    """Where an instrument stood: measured = frame o pose o target.

    ``frame`` (6,): the base's pose in the measuring frame; ``target`` (3,): the measured
    point in platform axes; ``target_rotation`` (3,): rotation vector of the measured body
    against the platform. SI.
    """

    frame: Array
    target: Array
    target_rotation: Array


@dataclass(frozen=True, eq=False)
class Mechanism:
    """A parallel mechanism: data only, SI.

    Attributes:
        name, motion: as in the file; motion is a key of :data:`MOTIONS`.
        limbs: base to platform, in file order.
        actuators: names of the joint variables, (k,).
        parameters: all parameters; ``free``: indices that identification may change.
        home_pose: full pose (6,) x, y, z, rotation vector; selects the assembly mode.
        home_q: joint values at home by actuator, nan where the file gives none, (k,).
        limits: joint range by actuator, (k, 2), -inf and inf where none.
        gravity: unit direction of weight in base axes, (3,).
        units: the file's units, in which everything is written.
        free_patterns: the file's ``free`` list, or None.
        registrations: frame and target of data sets that were identified, by name.
        digits: half the last printed digit of the file's numbers by quantity, SI.
        findings: warnings that reading the file gave.
        source: path of the file, for messages.
    """

    name: str
    motion: str
    limbs: tuple[Limb, ...]
    actuators: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    free: tuple[int, ...]
    home_pose: Array
    home_q: Array
    limits: Array
    gravity: Array
    units: Units
    free_patterns: tuple[str, ...] | None = None
    registrations: Mapping[str, Registration] = field(default_factory=dict)
    digits: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    source: str = ""

    @property
    def dof(self) -> tuple[int, ...]:
        """Indices of the pose coordinates that the machine has."""
        return MOTIONS[self.motion]

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of those coordinates."""
        return tuple(POSE_COORDINATES[i] for i in self.dof)

    @property
    def conditions(self) -> int:
        """Number of stacked limb conditions d."""
        return sum(limb.kind.surface.conditions for limb in self.limbs)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Parameter names, in order."""
        return tuple(p.name for p in self.parameters)

    @cached_property
    def values(self) -> Array:
        """Present parameter values (P,)."""
        return np.array([p.value for p in self.parameters])

    @cached_property
    def nominals(self) -> Array:
        """Nominal parameter values (P,)."""
        return np.array([p.nominal for p in self.parameters])

    @cached_property
    def home(self) -> Array:
        """The platform-to-base motor at home, (8,)."""
        return cga.motor_from_rotation_vector(self.home_pose[3:], self.home_pose[:3])

    @cached_property
    def actuator_quantity(self) -> tuple[str, ...]:
        """``length`` or ``angle`` for each actuator (of its first limb)."""
        first = {limb.actuator: limb.kind.actuator for limb in reversed(self.limbs)}
        return tuple(first[a] for a in range(len(self.actuators)))

    @cached_property
    def actuator_has_ratio(self) -> tuple[bool, ...]:
        """Whether q is a bare number (the limb has a drive ratio) for each actuator."""
        ratio = {limb.actuator: any(s == "ratio" for s, _ in limb.slots.direct)
                 for limb in reversed(self.limbs)}
        return tuple(ratio[a] for a in range(len(self.actuators)))

    @cached_property
    def length_scale(self) -> float:
        """Root mean square distance of the platform joints from the platform origin, m.

        It weighs rotation against translation in singular values and in the solver; 1 m
        where all joints sit at the origin.
        """
        points = joint_points(self)[1] - self.home_pose[:3]
        scale = float(np.sqrt(np.mean(np.sum(points**2, axis=-1))))
        return scale if scale > 0.0 else 1.0

    @cached_property
    def reach(self) -> float:
        """Largest distance between base joints and platform joints at home, m."""
        fixed, moving = joint_points(self)
        everything = np.concatenate([fixed, moving])
        apart = everything[:, None, :] - everything[None, :, :]
        return float(np.sqrt(np.max(np.sum(apart**2, axis=-1)))) or 1.0


    def with_free(self, patterns: Sequence[str] | None) -> Mechanism:
        """Return the machine with another choice of free parameters."""
        return replace(self, free=tuple(free_indices(self.parameters, patterns)))

    def with_values(self, g: Array) -> Mechanism:
        """Return the machine with parameters ``g`` (P,) as its present values."""
        return replace(self, parameters=with_values(self.parameters, g))

    def nominal(self) -> Mechanism:
        """Return the machine as drawn: every parameter at its nominal value."""
        return self.with_values(self.nominals)


def joint_points(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return base points and platform points of all limbs at home, (L, 3) each, base axes."""
    g = mechanism.values
    fixed, moving = [], []
    for limb in mechanism.limbs:
        v = limb.slots.values(g)
        fixed.append([v.get(f"base.point.{a}", 0.0) for a in "xyz"])
        moving.append([v.get(f"platform.point.{a}", 0.0) for a in "xyz"])
    return np.array(fixed), cga.move_point(mechanism.home, np.array(moving))


@dataclass(frozen=True, eq=False)
class Model:
    """A mechanism at parameter values ``g`` (P,); default its present ones."""

    mechanism: Mechanism
    g: Array | None = None

    @cached_property
    def parameters(self) -> Array:
        """The parameter vector in use (P,)."""
        return self.mechanism.values if self.g is None else self.g

    @cached_property
    def limb_values(self) -> tuple[dict[str, Any], ...]:
        """Slots and directions of each limb."""
        return tuple({**limb.slots.values(self.parameters), **limb.constants}
                     for limb in self.mechanism.limbs)

    def joint_coordinate(self, limb: int, q: Array) -> Array:
        """Return u = ratio q + offset of one limb, (N,); m or rad."""
        v = self.limb_values[limb]
        own = q[:, self.mechanism.limbs[limb].actuator]
        return np.asarray(v.get("ratio", 1.0) * own + v.get("offset", 0.0), dtype=float)

    def closure(self, q: Array, wanted: Collection[int] = ()) -> Closure:
        """Build all KGBs for joint values ``q`` (N, k) or (k,).

        ``wanted`` are the parameter indices whose columns Bg will be asked for.
        """
        q = np.atleast_2d(np.asarray(q, dtype=float))
        bodies, slots, columns = [], [], []
        for i, limb in enumerate(self.mechanism.limbs):
            names, used = limb.slots.feeds(set(wanted))
            values = {**self.limb_values[i], U: self.joint_coordinate(i, q)}
            bodies.append(limb.kind.evaluate(values, {U, *names}))
            slots.append(tuple(names))
            columns.append(tuple(used))
        return Closure(self, q, tuple(bodies), tuple(slots), tuple(columns))


@dataclass(frozen=True, eq=False)
class Closure:
    """The stacked conditions of N poses with their joints locked at ``q`` (N, k)."""

    model: Model
    q: Array
    bodies: tuple[Body, ...]
    slots: tuple[tuple[str, ...], ...]
    columns: tuple[tuple[int, ...], ...]

    @cached_property
    def fixed(self) -> Array:
        """Base-side KGB vectors (N, d, 5)."""
        return _stack([b.fixed for b in self.bodies])

    @cached_property
    def moving(self) -> Array:
        """Platform-side KGB vectors (1 or N, d, 5)."""
        return _stack([b.moving for b in self.bodies])

    @cached_property
    def scale(self) -> Array:
        """Factor that makes each inner product a length (N, d)."""
        return _stack([b.scale for b in self.bodies])

    @cached_property
    def radius(self) -> Array:
        """Sphere radii (N, d), 0 for planes."""
        return _stack([b.radius for b in self.bodies])

    @cached_property
    def point_moves(self) -> Array:
        """Whether the platform carries the point (d,)."""
        return np.array([m for b in self.bodies for m in b.point_moves])

    def carried(self, pose: Array) -> Array:
        """Platform-side vectors carried to the base frame by motors ``pose`` (N, 8)."""
        return cga.move_vector(np.atleast_2d(pose)[:, None, :], self.moving)

    def gaps(self, pose: Array) -> Array:
        """Return c (N, d), m: the inner product scaled to a length (exact where it is 0)."""
        return self.scale * cga.inner(self.fixed, self.carried(pose))

    def lengths(self, pose: Array) -> Array:
        """Return the conditions as true lengths (N, d), m: |x - C| - radius for spheres."""
        gap = self.gaps(pose)
        r = self.radius
        return np.where(r > 0.0, np.sqrt(np.maximum(r * r + 2.0 * r * gap, 0.0)) - r, gap)

    def lines(self, pose: Array) -> Array:
        """Return the legs' lines (N, d, 6) in base axes: unit direction, moment.

        A platform twist B changes c by their pairing.
        """
        moved = self.carried(pose)
        here = self.point_moves[:, None]
        point = np.where(here, moved, self.fixed)
        surface = np.where(here, self.fixed, moved)
        sign = np.where(self.point_moves, 1.0, -1.0)
        return (sign * self.scale)[..., None] * cga.leg_line(point, surface)

    def contacts(self, pose: Array) -> Array:
        """Return the points at which the legs hold the platform (N, d, 3), base axes."""
        moved = self.carried(pose)
        return cga.coordinates(np.where(self.point_moves[:, None], moved, self.fixed))

    def pose_matrix(self, pose: Array, lines: Array | None = None) -> Array:
        """Return A (N, d, d): columns (origin displacement, rotation) of the motion."""
        lines = self.lines(pose) if lines is None else lines
        n, m = lines[..., :3], lines[..., 3:]
        t = cga.translation(np.atleast_2d(pose))[:, None, :]
        return np.concatenate([n, m - np.cross(t, n)], axis=-1)[..., self.model.mechanism.dof]

    def joint_matrix(self, pose: Array, lines: Array | None = None) -> Array:
        """Return Jq = dc/dq (N, d, k), m per unit of q."""
        lines = self.lines(pose) if lines is None else lines
        mechanism = self.model.mechanism
        out = np.zeros((*lines.shape[:2], len(mechanism.actuators)))
        row = 0
        for i, (limb, body) in enumerate(zip(mechanism.limbs, self.bodies, strict=True)):
            k = len(body.point_moves)
            rows = _slot_columns(body, lines[:, row:row + k], pose, (U,))[..., 0]
            ratio = self.model.limb_values[i].get("ratio", 1.0)
            out[:, row:row + k, limb.actuator] = rows * ratio
            row += k
        return out

    def error_blocks(self, pose: Array, lines: Array | None = None
                     ) -> list[tuple[slice, tuple[int, ...], Array]]:
        """Return Bg limb by limb: (rows, parameter indices, block (N, k, P_limb))."""
        lines = self.lines(pose) if lines is None else lines
        out = []
        row = 0
        for i, (limb, body) in enumerate(zip(self.model.mechanism.limbs, self.bodies, strict=True)):
            rows = slice(row, row + len(body.point_moves))
            row = rows.stop
            if not self.columns[i]:
                continue
            raw = _slot_columns(body, lines[:, rows], pose, self.slots[i],
                                self.q[:, limb.actuator])
            chain = limb.slots.jacobian(self.model.parameters, self.slots[i], self.columns[i])
            out.append((rows, self.columns[i], raw @ chain))
        return out

    def error_matrix(self, pose: Array, wanted: Sequence[int], lines: Array | None = None) -> Array:
        """Return Bg (N, d, len(wanted)), dense, columns in the order of ``wanted``."""
        place = {p: i for i, p in enumerate(wanted)}
        blocks = self.error_blocks(pose, lines)
        n = np.atleast_2d(pose).shape[0]
        out = np.zeros((n, self.model.mechanism.conditions, len(place)))
        for rows, columns, block in blocks:
            out[:, rows, [place[c] for c in columns]] += block
        return out


def _stack(parts: Sequence[Array]) -> Array:
    n = max(p.shape[0] for p in parts)
    return np.concatenate([np.broadcast_to(p, (n, *p.shape[1:])) for p in parts], axis=1)


def _slot_columns(body: Body, lines: Array, pose: Array, slots: Sequence[str],
                  q: Array | None = None) -> Array:
    """Return dc/dslot (N, k, S) of one limb: line against frame twist, chain by chain.

    ``offset`` moves the joint coordinate u itself, ``ratio`` moves it by q.
    """
    n, k = lines.shape[:2]
    def on_platform() -> Array:
        return cga.move_line(cga.reverse(np.atleast_2d(pose))[:, None, :], lines)

    chains: tuple[tuple[float, dict[str, Array], Callable[[], Array]], ...] = (
        (-1.0, body.base, lambda: lines), (-1.0, body.middle, lambda: body.middle_lines),
        (1.0, body.platform, on_platform))
    out = np.zeros((n, k, len(slots)))
    for sign, twists, line in chains:
        names = {s: U if s in ("offset", "ratio") else s for s in slots}
        mine = [i for i, s in enumerate(slots) if names[s] in twists]
        if not mine:
            continue
        stacked = [np.atleast_2d(twists[names[slots[i]]]) for i in mine]
        m = max(t.shape[0] for t in stacked)
        generators = np.stack([np.broadcast_to(t, (m, 6)) for t in stacked], axis=-1)
        wrench = line()
        swapped = np.concatenate([wrench[..., 3:], wrench[..., :3]], axis=-1)
        out[..., mine] = sign * (swapped @ generators)
    for i, s in enumerate(slots):
        if s == "ratio" and q is not None:
            out[..., i] *= q[:, None]
    return out
