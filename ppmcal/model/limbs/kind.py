"""Limb kinds, and the closure that all of them share.

With the actuated joint locked, the two passive joints constrain a point of one body to a surface of
the other, the limb's kinematic geometric body (KGB, [PPM] section 3.1). Both are vectors
of the conformal algebra, so every closure equation is one inner product

    c = s * (F . M K M~),

with F carried by the base, K by the platform, M the platform's motor, and s the factor
that makes c a length, positive when the platform is too far along the leg's line.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.axis_offset import offset_slot, turn_towards
from ppmcal.model.limbs.chain import Chain, ChainStep, ErrorTwists, SlotSpec, Values
from ppmcal.model.limbs.pulley import Pulley
from ppmcal.model.registry import Registry

Part = tuple[Array, tuple[ErrorTwists, ...]]
Still = tuple[Part, Part]
"""Motors and twists of the pose-independent part of a base chain, and of a platform chain."""


@dataclass(frozen=True)
class ClosureSurface:
    """The KGB of a limb for N poses, with the twists of its slots.

    Axes: n poses (or 1 if independent of the pose), k equations. For L limbs together, the limb
    axis follows that of poses: (n, L, k, ...).

    Attributes:
        fixed: base-side vectors, (n, k, 5), base axes.
        moving: platform-side vectors, (n, k, 5), platform axes.
        scale: s of the closure, (n, k); -1/radius for a sphere.
        radius: radius of spheres, (n, k), 0 for planes; m.
        point_moves: whether the platform carries the point, (k,) (otherwise the surface).
        middle_lines: the leg's line in the middle chain's root axes, (n, k, 6).
        base, middle, platform: error twists of the wanted slots, chain by chain.
    """

    fixed: Array
    moving: Array
    scale: Array
    radius: Array
    point_moves: tuple[bool, ...]
    middle_lines: Array
    base: tuple[ErrorTwists, ...]
    middle: tuple[ErrorTwists, ...]
    platform: tuple[ErrorTwists, ...]


@dataclass(frozen=True)
class EquationForm:
    """One closure equation by a name known to the compiled path.

    ``name``: ``sphere``, centred at the end of the base chain; ``base plane``, normal to the local
    ``axis`` (0, 1, 2: x, y, z) of the base chain's end; ``platform plane``, of the platform's;
    ``angle``, the local ``axis`` of the base chain's end perpendicular to ``other`` of the
    platform's; ``between axes``, both of these in one plane with the line between the chain ends;
    ``over sheave`` and ``over swivel``, a rope from the kind's pulley, whose axis is z of the base
    chain's end without it, or which swivels about that; the rope is the middle chain's ``axis``.
    """

    name: str
    axis: int = 0
    other: int = 0


@dataclass(frozen=True)
class Surface:
    """How the three chain motors become KGB vectors: one closure family.

    ``build(base, middle, platform)`` takes the chain motors (..., 8) and returns
    ``fixed, moving, scale, radius, middle_lines`` as lists over the k equations. ``forms`` lists
    their forms; a family without them is evaluated by ``build`` alone. For limbs with more than two
    passive joints the surface may also depend on the pose: then it ``turns``, and ``build`` takes
    the platform's motors, or None, after the chains'.
    """

    name: str
    point_moves: tuple[bool, ...]
    build: Callable[..., Iterator[tuple[Array, Array, Array, Array, Array]]]
    forms: tuple[EquationForm, ...] = ()
    turns: bool = False

    @property
    def equations(self) -> int:
        """Number of closure equations that a limb of this family imposes on the platform."""
        return len(self.point_moves)

    @property
    def of_angles(self) -> tuple[bool, ...]:
        """Which of them constrain only the platform's rotation: cosines instead of lengths."""
        forms = self.forms or (EquationForm(""),) * self.equations
        return tuple(f.name in ("angle", "between axes") for f in forms)

    @property
    def angles(self) -> bool:
        """Whether one of them constrains only the platform's rotation."""
        return any(self.of_angles)


@dataclass(frozen=True)
class LimbKind:
    """One row of the table of limb kinds.

    Attributes:
        name: ``R(P)R``: joints from base to platform, the actuated one in parentheses; a passive
            limb has none.
        planar: whether it is in the x-y plane.
        surface: its closure family.
        base, middle, platform: its chains.
        actuator: ``length`` or ``angle``, quantity of the actuated joint; empty for a passive limb,
            which has no drive.
        branch: name of the setting that selects one of two inverse roots, or None.
        strut: whether the joint value is a distance: then only the larger root is valid.
        branch_sign: +1 if the setting's +1 is the larger root, -1 for the smaller.
        closes_when: the closure in the terms of the contract, for messages.
        source: paper and equation.
        written: its name in files, if different: motion and pulley select among kinds of one such
            name.
        pulls_only: whether it is a rope, which can pull but not push.
        pulley: over which it leaves the base, if any.
        effect: kind of effect whose parameters a file may give with the limb's slots, if any.
    """

    name: str
    planar: bool
    surface: Surface
    base: Chain
    middle: Chain
    platform: Chain
    actuator: str
    branch: str | None = None
    branch_sign: int = 1
    strut: bool = False
    closes_when: str = ""
    source: str = ""
    written: str = ""
    pulls_only: bool = False
    pulley: Pulley | None = None
    effect: str = ""

    def __reduce__(self) -> tuple[Callable[[str], LimbKind], tuple[str]]:
        """Pickle by name: the steps are functions."""
        return find_kind, (self.name,)

    @property
    def driven(self) -> bool:
        """Whether the limb has a drive; a passive one only constrains the platform."""
        return bool(self.actuator)

    @property
    def called(self) -> str:
        """Its name in files."""
        return self.written or self.name

    def point(self, end: str) -> str:
        """Return the path of its point on ``base`` or ``platform``: ``base.point``."""
        first = self.base if end == "base" else self.platform
        return first.steps[0].slots[0].name.rpartition(".")[0]

    @property
    def steps(self) -> tuple[ChainStep, ...]:
        """All steps, base to platform."""
        return self.base.steps + self.middle.steps + self.platform.steps

    @property
    def slots(self) -> tuple[SlotSpec, ...]:
        """Geometry slots (no joint frames), in chain order, then the drive's offset and ratio."""
        geometry = tuple(s for step in self.steps if not step.joint for s in step.slots)
        if not self.driven:
            return geometry
        return (*geometry, SlotSpec("offset", self.actuator, "offset", 0.0),
                SlotSpec("ratio", self.actuator, "ratio", 1.0))

    @property
    def joint_slots(self) -> tuple[SlotSpec, ...]:
        """Frame error components of the limb's joints, all 0 by default."""
        return tuple(s for step in self.steps if step.joint for s in step.slots)

    @property
    def directions(self) -> tuple[str, ...]:
        """Names of the unit vectors that the file must give (``base.direction``)."""
        return tuple(c for step in self.steps for c in step.constants)

    @property
    def axes_without_errors(self) -> tuple[str, ...]:
        """Names of first directions without error slots."""
        return tuple(step.constants[0] for step in self.steps if step.constants and not step.slots)

    @property
    def zeros(self) -> dict[str, str]:
        """First directions with a second one that rotates along: ``base.axis`` -> ``base.zero``."""
        return {step.constants[0]: step.constants[1] for step in self.steps
                if len(step.constants) > 1}

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the unit vectors that the file may give: first axes of universal joints."""
        return tuple(dict.fromkeys(s.needs for s in self.slots if s.needs))

    @property
    def axis_offsets(self) -> tuple[SlotSpec, ...]:
        """The offsets between the axes of a universal joint, on the base's or platform's side."""
        found = (offset_slot(chain) for chain in (self.base, self.platform))
        return tuple(slot for slot in found if slot is not None)

    def turns(self, values: Values, wanted: Collection[str] = ()) -> bool:
        """Whether the surface depends on the pose: by itself, or as :meth:`is_turned`."""
        return self.surface.turns or self.is_turned(values, wanted)

    def is_turned(self, values: Values, wanted: Collection[str] = ()) -> bool:
        """Whether its starting point depends on the pose.

        So over a pulley, and if the axes of a universal joint do not intersect, or might not.
        """
        return self.pulley is not None or self._turning(values, wanted) is not None

    @property
    def cannot_turn(self) -> str:
        """The reason if its joints or its pulley cannot turn towards a pose."""
        return "ends inside its pulley" if self.pulley else (
            "ends within the axis_offset of its universal joint's first axis, so the joint cannot "
            "turn towards it")

    def _turning(self, values: Values, wanted: Collection[str]) -> Chain | None:
        """Return the chain that ends in an offset universal joint."""
        for chain in (self.base, self.platform):
            slot = offset_slot(chain)
            if slot is not None and slot.name in values and (
                    slot.name in wanted or np.any(values[slot.name])):
                return chain
        return None

    def still(self, values: Values, wanted: Collection[str]) -> Still:
        """Return the pose-independent part of a limb over a pulley, to evaluate it only once."""
        return (Chain(self.base.steps[:-1]).evaluate(values, wanted),
                self.platform.evaluate(values, wanted))

    def turn(self, values: Values, pose: Array, wanted: Collection[str] = (),
             still: Still | None = None) -> dict[str, Array]:
        """Return the angle of an offset universal joint about its first axis at motors (N, 8).

        See :func:`axis_offset.turn_towards`; empty if its axes intersect. For a pulley, how the
        rope leaves it (:class:`pulley.Pulley`).
        """
        if self.pulley is not None:
            root, platform = (part[0] for part in still or self.still(values, ()))
            end = cga.move_point(pose, cga.translation(platform))
            return self.pulley.leaves(values, cga.move_point(cga.reverse(root), end))
        own = self._turning(values, wanted)
        if own is None:
            return {}
        other, there = ((self.platform, pose) if own is self.base
                        else (self.base, cga.reverse(pose)))
        end = cga.translation(other.evaluate(values, ())[0])
        return turn_towards(own, values, cga.move_point(there, end))

    def evaluate(self, values: Values, wanted: Collection[str] = (), pose: Array | None = None,
                 still: Still | None = None) -> ClosureSurface:
        """Return the limb's KGB; ``wanted`` names the slots whose twists are needed.

        Args:
            values: all slots, the directions, and ``u`` (N,), SI.
            wanted: slot names, ``u`` for the actuated joint.
            pose: motors (N, 8), on which the surface depends if the kind :meth:`turns`. Without
                one (and without a turn among the values) the axes of all joints intersect, and
                ropes start at the centre of their pulley.
            still: the result of :meth:`still`, if known.
        """
        if pose is not None:
            values = {**values, **self.turn(values, pose, wanted, still)}
        base, base_twists = self.base.evaluate(values, wanted) if still is None else (
            Chain(self.base.steps[-1:]).evaluate(values, wanted, still[0]))
        middle, middle_twists = self.middle.evaluate(values, wanted)
        platform, platform_twists = (self.platform.evaluate(values, wanted) if still is None
                                     else still[1])
        further = (pose,) if self.surface.turns else ()
        columns = list(zip(*self.surface.build(base, middle, platform, *further), strict=True))
        fixed, moving, scale, radius, lines = (_stack(list(c), 0 if i in (2, 3) else 1)
                                               for i, c in enumerate(columns))
        return ClosureSurface(fixed, moving, scale, radius, self.surface.point_moves, lines,
                    base_twists, middle_twists, platform_twists)


def _stack(parts: list[Array], own: int) -> Array:
    """Stack the k equations after poses (and limbs): arrays (n?, L?, ...) -> (n, L?, k, ...).

    ``own``: number of further axes of each, after those.
    """
    lead = max(1, *(p.ndim - own for p in parts))
    full = [p.reshape((1,) * (lead + own - p.ndim) + p.shape) for p in parts]
    shape = np.broadcast_shapes(*(p.shape[:lead] for p in full))
    return np.stack([np.broadcast_to(p, shape + p.shape[lead:]) for p in full], axis=lead)


_REGISTRY: Registry[LimbKind] = Registry("limb kind", "ppmcal.limbs")
register, kinds = _REGISTRY.register, _REGISTRY.kinds


def find_kind(name: str, where: str = "") -> LimbKind:
    """Return the kind called ``name``, like :meth:`Registry.find`; functions pickle by name."""
    return _REGISTRY.find(name, where)
