"""What an effect kind is: parameters, the columns it needs, and what it adds.

Everything that an effect can add is a :class:`Shift`: a change of limb slots row by row
(a joint that is not where the controller believes it is a change of ``offset``), a twist
of the platform, or a stretch of the measured positions. An effect knows slot and column
names only; limbs know no effect, and the sum knows neither.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppmcal.errors import unknown
from ppmcal.linalg import Array, Bools

Rows = NDArray[np.int64] | NDArray[np.bool_]

COORDINATES = {"planar": ("x", "y", "rz"), "translational": ("x", "y", "z"),
               "spatial": ("x", "y", "z", "rx", "ry", "rz")}
PLACE = {"x": 0, "y": 1, "z": 2, "rx": 3, "ry": 4, "rz": 5}


@dataclass(frozen=True, eq=False)
class Shift:
    """What effects add in N rows, SI.

    Attributes:
        slots: (limb index, slot name) -> change of that slot (N,); ``offset`` is the
            joint's own coordinate u.
        pose: platform displacement of the origin and rotation vector, base axes (N, 6).
        stretch: change of the map from true to measured position, measuring frame,
            (N or 1, 3, 3): measured = (1 + stretch) true.
    """

    slots: Mapping[tuple[int, str], Array] = field(default_factory=dict)
    pose: Array | None = None
    stretch: Array | None = None

    def take(self, rows: Rows) -> Shift:
        """Return the shift of some rows."""
        stretch = self.stretch
        if stretch is not None and stretch.shape[0] > 1:
            stretch = stretch[rows]
        return Shift({s: v[rows] for s, v in self.slots.items()},
                     None if self.pose is None else self.pose[rows], stretch)

    def times(self, factor: float) -> Shift:
        """Return the shift scaled by a number."""
        return Shift({s: factor * v for s, v in self.slots.items()},
                     None if self.pose is None else factor * self.pose,
                     None if self.stretch is None else factor * self.stretch)


def total(shifts: Sequence[Shift]) -> Shift:
    """Return the sum of shifts."""
    slots: dict[tuple[int, str], Array] = {}
    pose: Array | None = None
    stretch: Array | None = None
    for shift in shifts:
        for name, value in shift.slots.items():
            slots[name] = slots[name] + value if name in slots else value
        if shift.pose is not None:
            pose = shift.pose if pose is None else pose + shift.pose
        if shift.stretch is not None:
            stretch = shift.stretch if stretch is None else stretch + shift.stretch
    return Shift(slots, pose, stretch)


@dataclass(frozen=True)
class LimbSetting:
    """What an effect may know of one limb: its actuator and lengths, slot -> value, m.

    ``struts``: lengths of its bars; ``offset`` stands for u where the strut is driven.
    ``base`` and ``platform``: coordinates of its joint centres.
    """

    actuator: int
    struts: Mapping[str, Array]
    base: Mapping[str, Array]
    platform: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class Setting:
    """What an effect may know of N rows with k actuators; nan where it was not recorded.

    Attributes:
        motion: planar, translational or spatial.
        turning: (k,) whether the actuated joint turns; else it slides.
        travel: ratio q (N, k), m or rad. stroke: its range (k, 2), nan where unknown.
        approach: side from which each joint came, +1 or -1 (N, k).
        velocity: of u (N, k), per second.
        temperature: minus 20 degrees Celsius, K (N,).
        wrench: on the platform at its origin, base axes (N, 6), N and N m.
        time: s (N,).
        limbs: one each.
        load_of: gives the load on the actuators (N, k), N or N m.
    """

    motion: str
    turning: Bools
    travel: Array
    stroke: Array
    approach: Array
    velocity: Array
    temperature: Array
    wrench: Array
    time: Array
    limbs: tuple[LimbSetting, ...]
    load_of: Callable[[], Array]

    @cached_property
    def load(self) -> Array:
        """F = J_q^T wrench (N, k): positive when it pushes towards larger u."""
        return self.load_of()

    def at_joints(self, change: Array, on: Bools) -> Shift:
        """Return the shift of joint coordinates u by ``change`` (N, k) on some actuators."""
        return Shift({(i, "offset"): change[:, limb.actuator]
                      for i, limb in enumerate(self.limbs) if on[limb.actuator]})

    def at_slots(self, which: str, per_unit: Array, on: Bools) -> Shift:
        """Return relative changes ``per_unit`` (N,) of the slots ``struts``, ``base``..."""
        return Shift({(i, slot): value * per_unit
                      for i, limb in enumerate(self.limbs) if on[limb.actuator]
                      for slot, value in getattr(limb, which).items()})


@dataclass(frozen=True)
class EffectParameter:
    """One number of an effect.

    ``quantity``: ``length``, ``angle``, ``joint`` (whichever the actuator has), ``load``
    (its force in N or moment in N m), or a quotient such as ``joint/load``; ``1`` is a
    pure number. ``default`` None: the file must give it. ``low``, ``high``: the range in which
    it has a meaning, SI. ``usual``: the range in which machines have it, SI, or, with
    ``of_stroke``, in parts of the joint's stroke: a value outside is not named as this effect
    (``why``: where the range is from). ``size``: a change that counts, SI. ``constant``: never
    fitted. ``reciprocal``: the effect is linear in its inverse, in which a fit takes its steps.
    """

    name: str
    quantity: str
    default: float | None = 0.0
    low: float = -np.inf
    high: float = np.inf
    usual: tuple[float, float] = (-np.inf, np.inf)
    of_stroke: bool = False
    why: str = ""
    size: float = 1e-5
    constant: bool = False
    reciprocal: bool = False


STROKE = "ISO 230-2: errors of a drive are small parts of its stroke"


@dataclass(frozen=True)
class Terms:
    """What an effect adds: the shift (N rows), and its derivative by each parameter."""

    shift: Shift
    by: Mapping[str, Shift]


Evaluate = Callable[[Setting, Bools, Mapping[str, float]], Terms]


@dataclass(frozen=True)
class Derived:
    """A figure that says more to people than the parameters that it follows from.

    ``quantity``: as that of a parameter; ``value``: (parameter -> value, middle of the measured
    stroke, m or rad) -> figure, SI.
    """

    name: str
    quantity: str
    value: Callable[[Mapping[str, float], float], float]


@dataclass(frozen=True)
class EffectKind:
    """One kind of effect.

    Attributes:
        name: as in the file.
        equation: what it adds, one line.
        source: standard or paper.
        parameters: motion -> its parameters.
        needs: columns: ``dir``, ``vel``, ``temperature``, ``load``, ``wrench``, ``time``.
        evaluate: (setting, on (k,), parameter -> value) -> :class:`Terms`.
        per_actuator: whether it belongs to single actuators; else to the whole machine.
        joints: ``any``, ``turning``: which actuators it can act on.
        motions: in which it exists.
        uses_load: whether the shift depends on the pose through the actuators' load.
        worked: a case with numbers: (parameters, setting changes, expected); see tests.
        derived: figures that follow from the parameters, told beside them.
    """

    name: str
    equation: str
    source: str
    parameters: Callable[[str], tuple[EffectParameter, ...]]
    needs: tuple[str, ...]
    evaluate: Evaluate
    per_actuator: bool = True
    joints: str = "any"
    motions: tuple[str, ...] = ("planar", "translational", "spatial")
    uses_load: bool = False
    worked: Worked | None = None
    derived: tuple[Derived, ...] = ()


@dataclass(frozen=True)
class Worked:
    """A worked case: one actuator or pose coordinate, plain numbers.

    ``setting``: field -> number for a single row; ``values``: the parameters;
    ``result``: the change of u of the actuator, of the first changed slot, of the first
    pose coordinate or of a measured 1 m, SI.
    """

    values: Mapping[str, float]
    setting: Mapping[str, float]
    result: float


def fixed_list(*parameters: EffectParameter) -> Callable[[str], tuple[EffectParameter, ...]]:
    """Return the same parameters for every motion."""
    return lambda motion: parameters


def linear(values: Mapping[str, float], by: Mapping[str, Shift]) -> Terms:
    """Return the terms of an effect that is linear in the parameters ``by`` names."""
    return Terms(total([s.times(values[p]) for p, s in by.items() if values[p] != 0.0]), by)


_KINDS: dict[str, EffectKind] = {}


def register(kind: EffectKind) -> EffectKind:
    """Add a kind to the registry; its name must be new."""
    if kind.name in _KINDS:
        raise ValueError(f"effect kind '{kind.name}' is registered twice")
    _KINDS[kind.name] = kind
    return kind


def effect_kinds() -> dict[str, EffectKind]:
    """Return all registered kinds by name."""
    return dict(_KINDS)


def find_effect(name: str, where: str = "") -> EffectKind:
    """Return the kind called ``name``.

    Raises:
        BadInput: unknown name; lists the valid ones and the nearest match.
    """
    if name not in _KINDS:
        raise unknown("effect", name, _KINDS, where)
    return _KINDS[name]
