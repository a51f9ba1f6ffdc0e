"""What could be missing: every kind of effect, for all actuators together and for each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnose.system import System
from ppmcal.effects import EffectKind, Shift, effect_kinds
from ppmcal.influence import lacking
from ppmcal.parameters import is_joint_component

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
GEOMETRY = "geometry"
FEWEST_PERIODS, MOST_PERIODS = 1.5, 80.0
"""Periods per stroke that are tried; a longer wave is a curvature."""
DIRECTIONS = 12
LOCAL, DISTORTION = "local", "distortion"
SHAPES = (*((i / 12.0, w) for i in range(13) for w in (0.05, 0.1)),
          *((i / 8.0, 0.0) for i in range(1, 8)))
"""Anonymous shapes: place and width in parts of the stroke; width 0 is a kink."""


@dataclass(frozen=True)
class Form:
    """One hypothesis: a kind of effect on some actuators.

    Attributes:
        kind: name; ``geometry`` for a frozen slot.
        on: actuator names, empty for the whole machine.
        shared: one value for all of ``on``, else one for each.
        names: parameters by column; with one value for each actuator ``leg1:width``.
        constants: parameters that are not linear: period, direction.
        slot: the frozen parameter's name, for ``geometry``.
        anonymous: a shape without a cause; it takes part so that no kind has to imitate
            it, and is never named.
        searched: how many constants a grid has chosen.
        low, high: physical range of each column's coefficient.
        columns: where its columns are in the library.
    """

    kind: str
    on: tuple[str, ...]
    shared: bool
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    columns: tuple[int, ...]
    constants: dict[str, float] = field(default_factory=dict)
    slot: str = ""
    anonymous: bool = False
    searched: int = 0

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.columns)

    @property
    def family(self) -> str:
        """What it is told apart as: the kind, the frozen slot, or the shape's place."""
        if self.anonymous:
            return self.label
        return f"{GEOMETRY} {self.slot}" if self.slot else self.kind

    @property
    def label(self) -> str:
        """Return words for people: ``backlash on leg2``."""
        if self.slot:
            return f"{GEOMETRY} {self.slot}"
        if self.anonymous:
            return f"an unknown shape along {' '.join(self.on) or 'the position'}"
        return f"{self.kind} on {', '.join(self.on)}" if self.on else self.kind


@dataclass(frozen=True)
class Untestable:
    """A kind that the data cannot test, and what they lack."""

    kind: str
    missing: tuple[str, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class Library:
    """All hypotheses: ``columns`` (N, m, T) white, ``forms`` over them, and what is untestable."""

    columns: Array
    forms: tuple[Form, ...]
    untestable: tuple[Untestable, ...]


class _Maker:
    """Collects columns and forms."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.columns: list[Array] = []
        self.forms: list[Form] = []
        self.untestable: list[Untestable] = []
        mechanism = system.problem.mechanism
        self.actuators = mechanism.actuators
        self.motion = mechanism.motion
        self.turning = np.array([q == "angle" for q in mechanism.actuator_quantity])

    def shifts(self, kind: EffectKind, on: Bools, values: dict[str, float],
               name: str) -> list[Shift]:
        return [kind.evaluate(p.setting, on, values).by[name] for p in self.system.parts]

    def add(self, column: Array) -> int:
        self.columns.append(column)
        return len(self.columns) - 1

    def kind(self, kind: EffectKind) -> None:
        """Add all forms of one kind."""
        usable = self.turning if kind.joints == "turning" else np.ones_like(self.turning)
        if self.motion not in kind.motions or not usable.any():
            return
        if kind.name == "gain":
            usable = usable & ~self._free_ratio()
        on, missing = self._recorded(kind, usable)
        if missing:
            self.untestable.append(Untestable(kind.name, missing, "not recorded"))
        if not on.any():
            return
        for constants in self._grids(kind):
            self._forms(kind, on, constants)

    def _forms(self, kind: EffectKind, on: Bools, constants: dict[str, float]) -> None:
        specs = [s for s in kind.parameters(self.motion)
                 if not s.constant and s.name not in constants]
        values = {s.name: 0.0 for s in kind.parameters(self.motion)} | constants
        values |= {s.name: 1.0 for s in specs if s.reciprocal}
        specs = [s for s in specs if self._varies(kind, s.name)]
        if not specs:
            return
        low = tuple(0.0 if s.reciprocal else s.low for s in specs)
        high = tuple(s.high for s in specs)
        shown = {n: v for n, v in constants.items() if np.isfinite(v)}
        searched = int(kind.name in ("periodic", "tilt"))
        names = tuple(s.name for s in specs)
        if not kind.per_actuator:
            where = tuple(self._column(kind, on, values, s.name, s.reciprocal) for s in specs)
            self.forms.append(Form(kind.name, (), True, names, low, high, where, shown,
                                   searched=searched))
            return
        own: dict[int, tuple[int, ...]] = {}
        for a in np.flatnonzero(on):
            one = np.arange(on.size) == a
            ends = self._ends(int(a)) if "low" in constants else {}
            own[int(a)] = tuple(self._column(kind, one, values | ends, s.name, s.reciprocal)
                                for s in specs)
            self.forms.append(Form(kind.name, (self.actuators[a],), True, names, low, high,
                                   own[int(a)], shown | ends, searched=searched))
        same = len(set(self.turning[on].tolist())) == 1
        if len(own) > 1 and same:
            where = tuple(self._column(kind, on, values, s.name, s.reciprocal) for s in specs)
            on_names = tuple(self.actuators[a] for a in own)
            self.forms.append(Form(kind.name, on_names, True, names, low, high, where, shown,
                                   searched=searched))
            self.forms.append(Form(
                kind.name, on_names, False,
                tuple(f"{self.actuators[a]}:{n}" for a in own for n in names), low * len(own),
                high * len(own), tuple(c for cs in own.values() for c in cs), shown,
                searched=searched))

    def _column(self, kind: EffectKind, on: Bools, values: dict[str, float], name: str,
                reciprocal: bool) -> int:
        sign = -1.0 if reciprocal else 1.0  # d/d(1/k) at k = 1
        return self.add(sign * self.system.column(self.shifts(kind, on, values, name)))

    def _varies(self, kind: EffectKind, name: str) -> bool:
        """Whether the wrench component of a frame compliance is ever applied."""
        if kind.needs != ("wrench",):
            return True
        at = ("fx", "fy", "fz", "mx", "my", "mz").index(name.rsplit("_", 1)[1])
        return any(np.nanmax(np.abs(p.setting.wrench[:, at]), initial=0.0) > 0.0
                   for p in self.system.parts)

    def _recorded(self, kind: EffectKind, usable: Bools) -> tuple[Bools, tuple[str, ...]]:
        """Return the actuators whose columns are there in every part, and missing columns."""
        on = usable.copy()
        missing: list[str] = []
        for part in self.system.parts:
            for a in np.flatnonzero(usable):
                gone = lacking(kind.needs, (self.actuators[a],), (int(a),), part.response.rows)
                if gone:
                    on[a] = False
                    missing += gone
        return on, tuple(dict.fromkeys(missing))

    def _free_ratio(self) -> Bools:
        out = np.zeros(self.turning.size, dtype=bool)
        mechanism = self.system.problem.mechanism
        for limb in mechanism.limbs:
            for slot, p in limb.slots.direct:
                if slot == "ratio" and p in self.system.problem.free:
                    out[limb.actuator] = True
        return out

    def _grids(self, kind: EffectKind) -> list[dict[str, float]]:
        """Return the values of a kind's nonlinear parameters that are tried."""
        if kind.name == "periodic":
            stroke, poses = self._stroke(), np.unique(self.system.group).size
            highest = min(MOST_PERIODS, float(poses))
            return [{"period": float(stroke / f)} for f in np.arange(FEWEST_PERIODS, highest, 0.4)]
        if kind.name == "tilt":
            return [{"direction": np.pi * i / DIRECTIONS} for i in range(DIRECTIONS)]
        if kind.name == "curvature":
            return [self._ends()]
        return [{}]

    def _ends(self, actuator: int | None = None) -> dict[str, float]:
        """Return the stroke of one joint, or the range of all: limits, else as measured."""
        travel = np.concatenate([p.setting.travel for p in self.system.parts])
        limits = self.system.parts[0].setting.stroke
        some = slice(None) if actuator is None else [actuator]
        ends = limits[some] if np.isfinite(limits[some]).all() else np.stack(
            [travel.min(axis=0), travel.max(axis=0)], axis=-1)[some]
        return {"low": float(ends[:, 0].min()), "high": float(ends[:, 1].max())}

    def _stroke(self) -> float:
        travel = np.concatenate([p.setting.travel for p in self.system.parts])
        return float(np.ptp(travel, axis=0).max()) or 1.0

    def shapes(self) -> None:
        """Add anonymous shapes: bumps and kinks along each joint, distortion of positions.

        They are what local damage, a bent guide or a lens does, and more; what they fit has no
        name here.
        """
        everything = np.ones_like(self.turning)
        for a, name in enumerate(self.actuators):
            one = np.arange(everything.size) == a
            travel = np.concatenate([p.setting.travel[:, a] for p in self.system.parts])
            low, length = float(travel.min()), float(np.ptp(travel)) or 1.0
            for at, width in SHAPES:
                shifts = [p.setting.at_joints(_shape(p.setting.travel, low + at * length,
                                                     width * length), one)
                          for p in self.system.parts]
                self.forms.append(Form(
                    LOCAL, (name,), True, ("height",), (-np.inf,), (np.inf,),
                    (self.add(self.system.column(shifts)),), anonymous=True,
                    searched=2 if width else 1))
        middle = np.concatenate([p.response.seen.point for p in self.system.parts]).mean(axis=0)
        shifts = []
        for p in self.system.parts:
            away = p.response.seen.point - middle
            swell = np.sum(away**2, axis=1) / max(float(np.sum(middle**2)), 1e-12)
            shifts.append(Shift(stretch=swell[:, None, None] * np.eye(3)))
        self.forms.append(Form(DISTORTION, (), True, ("cubic",), (-np.inf,), (np.inf,),
                               (self.add(self.system.column(shifts)),), anonymous=True))

    def geometry(self, tried: Sequence[int]) -> None:
        """Add every frozen slot, and those that were freed to be tried."""
        problem = self.system.problem
        effects = {p for e in problem.mechanism.effects for p in e.parameters.values()}
        taken = (set(problem.free) - set(tried)) | effects
        for p, parameter in enumerate(problem.mechanism.parameters):
            if p in taken or parameter.per_unit or is_joint_component(parameter.name):
                continue
            shifts = [slot_shift(self.system, p) for _ in self.system.parts]
            limbs = [limb for limb in problem.mechanism.limbs
                     if any(i == p for _, i in limb.slots.direct)
                     or any(p in (r, a) for _, _, r, a in limb.slots.polar)]
            on = tuple(dict.fromkeys(self.actuators[limb.actuator] for limb in limbs))
            column = self.add(self.system.column(shifts))
            self.forms.append(Form(GEOMETRY, on, True, (parameter.name,), (-np.inf,), (np.inf,),
                                   (column,), slot=parameter.name))


def _shape(travel: Array, at: float, width: float) -> Array:
    """Return a bump of a width, or a kink where the width is 0."""
    away = travel - at
    return np.asarray(np.exp(-0.5 * (away / width) ** 2) if width else np.maximum(away, 0.0))


def slot_shift(system: System, parameter: int) -> Shift:
    """Return the shift of all slots that a parameter feeds, per unit of it."""
    slots: dict[tuple[int, str], Array] = {}
    for i, limb in enumerate(system.problem.mechanism.limbs):
        fed, used = limb.slots.feeds({parameter})
        if not used:
            continue
        chain = limb.slots.jacobian(system.state.g, fed, [parameter])[:, 0]
        for slot, d in zip(fed, chain, strict=True):
            slots[i, slot] = np.array([d])
    return Shift(slots)


def library(system: System, kinds: Sequence[str] | None = None, tried: Sequence[int] = ()
            ) -> Library:
    """Return every hypothesis that these data could test.

    ``kinds``: only these; ``tried``: parameters that the fit frees only under test.
    """
    maker = _Maker(system)
    for name, kind in effect_kinds().items():
        if kinds is None or name in kinds:
            maker.kind(kind)
    if kinds is None or GEOMETRY in kinds:
        maker.geometry(tried)
    if kinds is None:
        maker.shapes()
    shape = (*system.residual.shape, 0)
    columns = np.stack(maker.columns, axis=-1) if maker.columns else np.zeros(shape)
    return Library(columns, tuple(maker.forms), tuple(maker.untestable))
