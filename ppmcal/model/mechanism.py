"""A parallel mechanism as data: limbs, parameters, home, limits, and what was registered."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.effects import EffectKind
from ppmcal.model.limbs import LimbKind
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.motions import Motion
from ppmcal.model.parameters import Parameter, SlotMap, free_indices, with_values
from ppmcal.model.registration import Registration
from ppmcal.notes import Note
from ppmcal.units import Units
from ppmcal.wording import pluralize

PASSIVE = -1
"""Actuator index of a limb without a drive."""
USUAL_NOISE = 1e-5
"""Default repeatability of drives, as a fraction of the reach: in addition to limb gaps."""


@dataclass(frozen=True)
class Limb:
    """One limb: its kind, which actuator drives it, its directions, and its slots.

    ``actuator`` is :data:`PASSIVE` for a limb that holds the platform without a drive. ``branch``
    is the file's setting (+1, -1 or None); ``constants`` maps direction names
    (``base.axis``) to unit vectors (3,).
    """

    name: str
    kind: LimbKind
    actuator: int
    slots: SlotMap
    constants: Mapping[str, Array] = field(default_factory=dict)
    branch: int | None = None

    @property
    def driven(self) -> bool:
        """Whether it has a drive."""
        return self.actuator != PASSIVE


@dataclass(frozen=True)
class Effect:
    """One effect of the machine.

    ``on`` (k,): the actuators that it acts on; ``parameters``: the kind's parameter name ->
    index into the machine's parameters.
    """

    kind: EffectKind
    on: tuple[bool, ...]
    parameters: Mapping[str, int]


@dataclass(frozen=True, eq=False, repr=False)
class Mechanism:
    """A parallel mechanism: data only, SI.

    Attributes:
        name: as in the file; ``motion``: the platform's coordinates.
        limbs: base to platform, in file order.
        actuators: names of the joint variables, (k,).
        parameters: all parameters; ``free``: indices that identification may change.
        home_pose: full pose (6,) x, y, z, rotation vector; selects the assembly mode.
        home_q: joint values at home by actuator, nan where the file gives none, (k,).
        limits: joint range by actuator, (k, 2), -inf and inf where none.
        gravity: unit direction of weight in base axes, (3,).
        effects: effects beyond geometry.
        units: the file's units, in which everything is written.
        free_patterns: the file's ``free`` list, or None.
        optional: groups of patterns to free in turn, if that predicts left-out rows better.
        registrations: frame and target of data sets that were identified, by name.
        measured: the data behind the calibration; None: not calibrated, or by an older version.
        digits: half the last printed digit of the file's numbers by quantity, SI.
        findings: warnings from reading the file.
        stiffness: of each limb's parts, ``bar``, ``drive``, ``joint1.x``, ... -> N/m or N m/rad;
            parts not listed are rigid; empty if the file has no stiffness.
        tolerances: class of slots -> standard deviation in file units, given or default; see
            :meth:`class_tolerance`.
        cost: class of slots -> (weight, exponent): a tolerance of t file units costs
            weight / t^exponent; only classes that the file lists.
        gauge: how a calibration by joint values alone fixes the base: ``base``, by base points that
            are held, or ``tolerances``, by the priors of all.
        defining: parameters held for that gauge: exact in the frames that they define.
        gaps: limb -> standard deviation of its closure gap, m; limbs not listed have only the
            drives' noise.
        source: path of the file, for messages; ``inputs``: all files it was read from.
    """

    name: str
    motion: Motion
    limbs: tuple[Limb, ...]
    actuators: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    free: tuple[int, ...]
    home_pose: Array
    home_q: Array
    limits: Array
    gravity: Array
    units: Units
    effects: tuple[Effect, ...] = ()
    free_patterns: tuple[str, ...] | None = None
    optional: tuple[tuple[str, ...], ...] = ()
    registrations: Mapping[str, Registration] = field(default_factory=dict)
    measured: MeasurementBasis | None = None
    digits: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Note, ...] = ()
    source: str = ""
    gauge: str = "base"
    defining: tuple[int, ...] = ()
    gaps: Mapping[str, float] = field(default_factory=dict)
    inputs: tuple[str, ...] = ()
    stiffness: tuple[Mapping[str, float], ...] = ()
    tolerances: Mapping[str, float] = field(default_factory=dict)
    cost: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Return name, motion, limbs and number of free parameters."""
        kinds = ", ".join(dict.fromkeys(limb.kind.name for limb in self.limbs))
        effects = "".join(f"; {k}" for k in dict.fromkeys(e.kind.name for e in self.effects))
        return (f"<mechanism {self.name}: {self.motion}, {pluralize(len(self.limbs), 'limb')} "
                f"{kinds}, {pluralize(len(self.free), 'free parameter')}{effects}>")

    @property
    def self_calibrated(self) -> bool:
        """Whether it was calibrated by joint values alone: only the base frame is known."""
        return self.measured is not None and not self.registrations

    @property
    def dof(self) -> tuple[int, ...]:
        """Indices of the machine's pose coordinates."""
        return self.motion.dof

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of those coordinates."""
        return self.motion.coordinates

    @cached_property
    def driven(self) -> tuple[int, ...]:
        """Indices of the limbs that have a drive; the others are passive."""
        return tuple(i for i, limb in enumerate(self.limbs) if limb.driven)

    @property
    def equations(self) -> int:
        """Number of stacked closure equations m."""
        return sum(limb.kind.surface.equations for limb in self.limbs)

    @cached_property
    def surplus(self) -> int:
        """Number of closure equations in excess of the platform's degrees of freedom."""
        return self.equations - len(self.dof)

    @cached_property
    def gap_sigma(self) -> Array:
        """Standard deviations of the limbs' closure gaps (m,), 0 without surplus equations.

        For an equation between directions (a cosine), the gap is an arc at the platform's joints.
        """
        size = {True: self.length_scale, False: 1.0}
        return np.array([self.gaps.get(limb.name, 0.0) / size[of_angle] for limb in self.limbs
                         for of_angle in limb.kind.surface.of_angles]) * (self.surplus > 0)

    @cached_property
    def dependent(self) -> int:
        """How many pose coordinates the closure determines: equations without an actuator."""
        return self.equations - len(self.actuators)

    @cached_property
    def freedoms(self) -> int:
        """How many pose coordinates can be commanded."""
        return len(self.dof) - self.dependent

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
        """Whether q is dimensionless (the limb has a drive ratio) for each actuator."""
        ratio = {limb.actuator: any(s == "ratio" for s, _ in limb.slots.direct)
                 for limb in reversed(self.limbs)}
        return tuple(ratio[a] for a in range(len(self.actuators)))

    @cached_property
    def limb_ratios(self) -> Array:
        """Drive ratio of each limb (L,), at the present values; 1 without one or a drive."""
        return np.array([limb.slots.values(self.values).get("ratio", 1.0) for limb in self.limbs])

    @property
    def joint_ratios(self) -> Array:
        """How far each joint moves per unit of q (k,), without its sign."""
        out = np.ones(len(self.actuators))
        own = list(self.driven)
        out[[self.limbs[i].actuator for i in own]] = np.abs(self.limb_ratios[own])
        return out

    @cached_property
    def usual_joint_noise(self) -> Array:
        """Default repeatability of the joint coordinates, if no data give it (k,), m or rad."""
        size = USUAL_NOISE * self.reach
        return np.array([size if q == "length" else size / self.length_scale
                         for q in self.actuator_quantity])

    def joint_factors(self, units: Units | None = None) -> Array:
        """Return the SI value of one unit of each joint variable (k,); 1 with a ratio.

        ``units`` are the mechanism file's unless others are given.
        """
        return np.array([1.0 if bare else (units or self.units).factor(q) for q, bare in zip(
            self.actuator_quantity, self.actuator_has_ratio, strict=True)])

    @cached_property
    def joint_units(self) -> tuple[tuple[float, str], ...]:
        """SI value and name of one file unit of each joint variable; 1 and "" with a ratio."""
        return tuple((1.0, "") if bare else (self.units.factor(q), self.units.name(q))
                     for q, bare in zip(self.actuator_quantity, self.actuator_has_ratio,
                                        strict=True))

    @cached_property
    def length_scale(self) -> float:
        """Root mean square distance of the platform joints from the platform origin, m.

        It weights rotation against translation in singular values and in the solver; 1 m if all
        joints are at the origin.
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

    def class_tolerance(self, tolerance_class: str, quantity: str) -> float | None:
        """Return the tolerance of a class of slots, SI; None if the file has none.

        Drive offsets are lengths or angles: one number in file units serves for both.
        """
        given = self.tolerances.get(tolerance_class)
        return None if given is None else given * self.units.factor(quantity)

    def registration(self, dataset: str) -> Registration:
        """Return the registration of a data set; for unknown names, that of the base frame."""
        return self.registrations.get(dataset, Registration())

    def with_free(self, patterns: Sequence[str] | None) -> Mechanism:
        """Return the machine with another choice of free parameters."""
        return replace(self, free=tuple(free_indices(self.parameters, patterns)), optional=())

    def with_values(self, g: Array) -> Mechanism:
        """Return the machine with parameters ``g`` (P,) as its present values."""
        return replace(self, parameters=with_values(self.parameters, g))

    def nominal(self) -> Mechanism:
        """Return the nominal machine: every parameter at its nominal value, no effects."""
        return replace(self.with_values(self.nominals), effects=())


def joint_points(mechanism: Mechanism) -> tuple[Array, Array]:
    """Return base points and platform points of all limbs at home, (L, 3) each, base axes."""
    g = mechanism.values
    fixed, moving = [], []
    for limb in mechanism.limbs:
        v = limb.slots.values(g)
        fixed.append([v.get(f"{limb.kind.point('base')}.{a}", 0.0) for a in "xyz"])
        moving.append([v.get(f"{limb.kind.point('platform')}.{a}", 0.0) for a in "xyz"])
    return np.array(fixed), cga.move_point(mechanism.home, np.array(moving))


@dataclass(frozen=True)
class Given:
    """Given values of one parameter of an effect, SI."""

    value: float
    tolerance: float | None = None
    free: bool = False
    nominal: float | None = None
    sigma: float | None = None


def resolved(quantity: str, joint: str) -> str:
    """Return a quantity with ``joint`` and ``load`` replaced by those of the actuator."""
    load = {"length": "N", "angle": "N.m"}[joint]
    return quantity.replace("joint", joint).replace("load", load)


def joint_quantity(mechanism: Mechanism, on: Sequence[bool]) -> str:
    """Return ``length`` or ``angle``: the quantity of the first of the actuators ``on``."""
    return next(q for q, used in zip(mechanism.actuator_quantity, on, strict=True) if used)


def usable_joints(mechanism: Mechanism, kind: EffectKind) -> NDArray[np.bool_]:
    """Return the actuators on which a kind of effect can act (k,)."""
    if kind.opposed and not mechanism.surplus:
        return np.zeros(len(mechanism.actuators), dtype=np.bool_)
    if kind.joints == "turning":
        return np.array([q == "angle" for q in mechanism.actuator_quantity])
    ropes = {limb.actuator for limb in mechanism.limbs if limb.kind.pulls_only}
    return np.array([kind.joints != "ropes" or a in ropes
                     for a in range(len(mechanism.actuators))])


def joint_groups(mechanism: Mechanism, kind: EffectKind) -> list[tuple[bool, ...]]:
    """Return the actuators on which a kind may act at once (k,): each alone, or opposing sets."""
    usable = np.flatnonzero(usable_joints(mechanism, kind))
    sets = combinations(usable, mechanism.surplus if kind.opposed else 1)
    return [tuple(a in chosen for a in range(len(mechanism.actuators))) for chosen in sets]


def limbs_with_free(mechanism: Mechanism, slots: Sequence[str], free: Collection[int]
                    ) -> tuple[Limb, ...]:
    """Return the limbs with a parameter among ``free`` in one of the slots."""
    return tuple(limb for limb in mechanism.limbs
                 if any(slot in slots and p in free for slot, p in limb.slots.direct))


def effect_label(mechanism: Mechanism, kind: EffectKind, on: Sequence[bool]) -> str:
    """Return a new name for an effect: ``backlash``, ``backlash.leg1+leg2``, ``backlash.2``."""
    where = "+".join(a for a, used in zip(mechanism.actuators, on, strict=True) if used)
    base = kind.name if all(on) else f"{kind.name}.{where}"
    label, count = base, 1
    while any(n.rpartition(".")[0] == label for n in mechanism.names):
        count += 1
        label = f"{base}.{count}"
    return label


def with_effect(mechanism: Mechanism, kind: EffectKind, on: Sequence[bool],
                given: Mapping[str, Given]) -> Mechanism:
    """Return the machine with one more effect.

    Args:
        mechanism: the machine so far.
        kind: of the effect.
        on: actuators that it acts on (k,).
        given: by parameter name of the kind; others take their default.
    """
    joint = joint_quantity(mechanism, on)
    label = effect_label(mechanism, kind, on)
    made = []
    for spec in kind.parameters(mechanism.motion):
        g = given.get(spec.name, Given(0.0 if spec.default is None else spec.default))
        made.append(Parameter(
            f"{label}.{spec.name}", resolved(spec.quantity, joint), g.value,
            g.value if g.nominal is None else g.nominal, g.tolerance, not g.free, "", (),
            g.sigma, g.free, 0.1 * g.value if spec.reciprocal else spec.size, spec.reciprocal,
            spec.nonlinear and not spec.scaling))
    first = len(mechanism.parameters)
    index = {s.name: first + i for i, s in enumerate(kind.parameters(mechanism.motion))}
    parameters = (*mechanism.parameters, *made)
    chosen = free_indices(made, None)
    return replace(mechanism, parameters=parameters,
                   effects=(*mechanism.effects, Effect(kind, tuple(on), index)),
                   free=(*mechanism.free, *(first + i for i in chosen)))
