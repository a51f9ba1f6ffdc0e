"""Hypotheses: a kind of effect on some actuators, and the columns that say what it does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.library_columns import LibraryColumns, Products
from ppmcal.diagnosis.linear_system import System
from ppmcal.linalg import Array
from ppmcal.model.effects import GEOMETRY, EffectKind, Shift
from ppmcal.model.parameters import is_joint_component

UNLIKE = ", not the same in all sessions"


@dataclass(frozen=True)
class Hypothesis:
    """One hypothesis: a kind of effect on some actuators.

    Attributes:
        kind: name; ``geometry`` for a frozen slot.
        on: actuator names, empty for the whole machine.
        shared: one value for all of ``on``, else one for each.
        names: parameters by column; with one value for each actuator ``leg1:width``.
        constants: values of parameters that are not linear, and ends of the stroke.
        slot: the frozen parameter's name, for ``geometry``.
        anonymous: a shape without a cause; it takes part so that no kind has to imitate
            it, and is never named.
        follows: what such a shape follows; of misread columns the rows in which they are.
        strokes: which constants are ends of the stroke: each joint may have its own.
        choices: logarithm of the number of stretches of rows that it was chosen from.
        low, high: physical range of each column's coefficient.
        usual: the range in which machines have it, by column; empty: any.
        columns: where its columns are in the library.
        misread: how columns would have to be read for it; empty: as they are.
        stretch: of the system the rows in which they are, from the first to the one before the
            second; empty: all.
        sessions: those where it has a size of its own in each, columns session by session;
            empty: it is the same in all.
        starts: where it has a memory, columns of what that may have been before the first row,
            each with the place among ``columns`` of the one whose coefficient, times a standard
            normal, its own is.
        effect: the kind with its traits; None for a frozen slot or a shape without a cause.
        part: of a kind whose parameters are causes of their own, the one that it has; of a shape
            without a cause what moves along what.
        requires: kind and actuators of what gives way to the load, which has to be chosen too; its
            coefficient is the parameter times that of the other.
        ratio: of what leans, the range in which machines have the parameter, by column.
        begins: of an event the session with whose first row it begins; empty: any row.
        beside: whether it is only there beside one that begins with another session.
    """

    kind: str
    on: tuple[str, ...]
    shared: bool
    names: tuple[str, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    columns: tuple[int, ...]
    usual: tuple[tuple[float, float], ...] = ()
    constants: dict[str, float] = field(default_factory=dict)
    slot: str = ""
    anonymous: bool = False
    follows: str = ""
    strokes: tuple[str, ...] = ()
    choices: float = 0.0
    effect: EffectKind | None = None
    part: str = ""
    requires: tuple[str, tuple[str, ...]] | None = None
    ratio: tuple[tuple[float, float], ...] = ()
    misread: str = ""
    sessions: tuple[str, ...] = ()
    stretch: tuple[int, ...] = ()
    starts: tuple[tuple[int, int], ...] = ()
    begins: str = ""
    beside: bool = False

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self.columns)

    @property
    def sort(self) -> str:
        """What a frozen slot is, whichever the limb: ``base.point.z``; empty where it is none."""
        return self.slot.partition(".")[2] or self.slot

    @property
    def scanned(self) -> bool:
        """Whether a grid has chosen constants of it, or might have chosen others."""
        return len(self.constants) > len(self.strokes)

    @cached_property
    def family(self) -> str:
        """What distinguishes it: the kind, the frozen slot, the shape's place, a misreading."""
        if self.misread:
            return self.misread
        if self.anonymous:
            return self.label
        return f"{GEOMETRY} {self.slot}" if self.slot else f"{self.called} {self.part}".rstrip()

    @property
    def called(self) -> str:
        """What people call its kind: ``base_compliance about base``."""
        return self.effect.label if self.effect else self.kind

    def apart(self, other: Hypothesis) -> float:
        """Return by how much the constants of two hypotheses of a grid differ, part by part.

        A constant that only one of them has is 0 in the other.
        """
        names = sorted({*self.constants, *other.constants} - {*self.strokes, *other.strokes})
        pairs = [(self.constants.get(n, 0.0), other.constants.get(n, 0.0)) for n in names]
        return sum(abs(a - b) / (abs(a) + abs(b)) for a, b in pairs if a != b)

    @cached_property
    def label(self) -> str:
        """Return words for people: ``backlash on leg2``."""
        if self.slot:
            return f"{GEOMETRY} {self.slot}"
        if self.anonymous:
            return (f"a distortion of the {self.follows}" if self.kind == DISTORTION else
                    f"an unknown shape along {self.part or self.follows}")
        if self.misread:
            where = f" in {self.follows}" if self.follows else ""
            return f"{self.misread}{where}: {replace(self, misread='', follows='').label}"
        what = f"{self.called} on {', '.join(self.on)}" if self.on else self.family
        if self.begins:
            return f"{what} {'in' if self.beside else 'from'} session {self.begins}"
        return f"{what}{UNLIKE}" if self.sessions else what


SOME_FILES = "not recorded in some files"
"""The topic of a reason that names the files."""


@dataclass(frozen=True)
class Untestable:
    """A kind that the data cannot test, and what they lack."""

    kind: str
    missing: tuple[str, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class Library:
    """All hypotheses: over white columns as ``products`` (N, m, T), and what is untestable.

    ``misread``: effects of columns that are not what they are read as.
    """

    products: Products
    hypotheses: tuple[Hypothesis, ...]
    untestable: tuple[Untestable, ...]
    misread: tuple[Hypothesis, ...] = ()

    @property
    def count(self) -> int:
        """How many columns there are."""
        return self.products.shape[0]

    @property
    def columns(self) -> Array:
        """All columns (N, m, T), made where they are asked for."""
        return self.some(range(self.count))

    def some(self, which: Sequence[int]) -> Array:
        """Return some columns (N, m, k)."""
        return self.products.some(which)


class Collector:
    """Collects columns and hypotheses over the rows of a system."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.columns = LibraryColumns(system)
        self.hypotheses: list[Hypothesis] = []
        self.untestable: list[Untestable] = []
        self.misread: list[Hypothesis] = []
        mechanism = system.problem.mechanism
        self.actuators = mechanism.actuators
        self.motion = mechanism.motion
        self.turning = np.array([q == "angle" for q in mechanism.actuator_quantity])

    def library(self) -> Library:
        """Return what was collected."""
        return Library(self.columns.made(), tuple(self.hypotheses), tuple(self.untestable),
                       tuple(self.misread))


def frozen_slots(to: Collector, tried: Sequence[int]) -> None:
    """Add every frozen slot, and those that were freed to be tried."""
    problem = to.system.problem
    effects = {p for e in problem.mechanism.effects for p in e.parameters.values()}
    taken = (set(problem.free) - set(tried)) | effects
    unseen = _as_free_ones(to.system) if all(d.kind.inside for d in problem.datasets) else None
    for p, parameter in enumerate(problem.mechanism.parameters):
        if p in taken or parameter.per_unit or is_joint_component(parameter.name):
            continue
        shifts = [slot_shift(to.system, p) for _ in to.system.parts]
        if unseen is not None and unseen(shifts):
            continue    # it moves the frame, which no joint value shows
        limbs = [limb for limb in problem.mechanism.limbs
                 if any(i == p for _, i in limb.slots.direct)
                 or any(p in (r, a) for _, _, r, a in limb.slots.polar)]
        on = tuple(dict.fromkeys(to.actuators[limb.actuator] for limb in limbs if limb.driven))
        column = to.columns.shifted(shifts)
        to.hypotheses.append(
            Hypothesis(
                GEOMETRY,
                on,
                True,
                (parameter.name,),
                (-np.inf,),
                (np.inf,),
                (column,),
                slot=parameter.name,
            )
        )


AS_ROUND_OFF = 1e-7
"""Part of a column that others do not explain, and it is one of them."""


def _as_free_ones(system: System) -> Callable[[Sequence[Shift]], bool]:
    """Return who tells whether shifts do nothing that free parameters could not do as well."""
    free = linalg.column_basis(system.jacobian.reshape(system.observed.size, -1)
                               * system.observed.reshape(-1, 1))

    def told(shifts: Sequence[Shift]) -> bool:
        column = (system.column(shifts) * system.observed).reshape(-1)
        rest = column - free @ (free.T @ column)
        return bool(np.linalg.norm(rest) <= AS_ROUND_OFF * np.linalg.norm(column))

    return told


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


LOCAL, DISTORTION = "local", "distortion"
SHAPES = (*((i / 12.0, w) for i in range(13) for w in (0.05, 0.1)),
          *((i / 24.0, 0.0) for i in range(2, 23)))
"""Anonymous shapes: place and width in parts of the stroke; width 0 is a kink."""


def shapes(to: Collector) -> None:
    """Add anonymous shapes: bumps and kinks along each joint, distortion of positions.

    They are what local damage, a bent guide or a lens does, and more; what they fit has no
    name here.
    """
    everything = np.ones_like(to.turning)
    for a, name in enumerate(to.actuators):
        one = np.arange(everything.size) == a
        travel = np.concatenate([p.setting.travel[:, a] for p in to.system.parts])
        low, length = float(travel.min()), float(np.ptp(travel)) or 1.0
        slope = to.columns.shifted([p.setting.at_joints(p.setting.travel, one)
                                    for p in to.system.parts])
        for at, width in SHAPES:
            shifts = [p.setting.at_joints(_shape(p.setting.travel, low + at * length,
                                                 width * length), one)
                      for p in to.system.parts]
            # a kink has a slope on either side
            own = (to.columns.shifted(shifts), *(() if width else (slope,)))
            to.hypotheses.append(Hypothesis(
                LOCAL, (name,), True, ("height", "slope")[:len(own)], (-np.inf,) * len(own),
                (np.inf,) * len(own), own, anonymous=True, follows=name))
    points = [p.response.seen.points[p.response.end] for p in to.system.parts]
    middle = np.concatenate(points).mean(axis=0)
    shifts = []
    for point in points:
        swell = np.sum((point - middle) ** 2, axis=1)
        # a stretch that carries each point along its own way from the middle
        along = np.maximum(np.sum(point**2, axis=1), 1e-12)[:, None, None]
        turn = np.eye(3) - middle[:, None] * point[:, None, :] / along
        shifts.append(Shift(stretch=swell[:, None, None] * turn))
    to.hypotheses.append(Hypothesis(DISTORTION, (), True, ("cubic",), (-np.inf,), (np.inf,),
                           (to.columns.shifted(shifts),), anonymous=True,
                           follows="position"))


def _shape(travel: Array, at: float, width: float) -> Array:
    """Return a bump of a width, or a kink where the width is 0."""
    away = travel - at
    return np.asarray(np.exp(-0.5 * (away / width) ** 2) if width else np.maximum(away, 0.0))
