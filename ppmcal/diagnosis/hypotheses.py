"""Hypotheses: a kind of effect on some actuators, and the columns that it adds."""

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

UNLIKE = ", different between sessions"


@dataclass(frozen=True)
class Hypothesis:
    """One hypothesis: a kind of effect on some actuators.

    Attributes:
        kind: name; ``geometry`` for a frozen slot.
        on: actuator names, empty for the whole machine.
        shared: one value for all of ``on``, otherwise one for each.
        names: parameters by column; with one value for each actuator ``leg1:width``.
        constants: values of nonlinear parameters, and ends of the stroke.
        slot: the frozen parameter's name, for ``geometry``.
        anonymous: a shape without a cause; included so that no kind has to mimic it, and never
            named.
        follows: the variable that such a shape depends on; for misread columns, their rows.
        strokes: which constants are ends of the stroke: each joint may have its own.
        choices: logarithm of the number of row ranges that it was chosen from.
        low, high: physical range of each column's coefficient.
        usual: the range found in machines, by column; empty: any.
        columns: indices of its columns in the library.
        misread: how columns would have to be read for it; empty: as they are.
        stretch: the misread rows of the system, from the first index to before the second; empty:
            all.
        sessions: those in each of which it has its own size, columns session by session; empty:
            the same in all.
        starts: for an effect with memory, columns of its possible states before the first row, each
            with an index into ``columns``: its coefficient is that column's times a standard
            normal.
        effect: the kind with its traits; None for a frozen slot or a shape without a cause.
        part: for a kind whose parameters are separate causes, the parameter; for a shape without a
            cause, what moves along what.
        requires: kind and actuators of a compliance that has to be chosen too; this coefficient is
            the parameter times that of the compliance.
        ratio: with ``requires``, the range of the parameter found in machines, by column.
        begins: for an event, the session at whose first row it begins; empty: any row.
        beside: whether it occurs only along with one that begins with another session.
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
        """A frozen slot's name without its limb: ``base.point.z``; empty if not a slot."""
        return self.slot.partition(".")[2] or self.slot

    @property
    def scanned(self) -> bool:
        """Whether it has constants chosen from a grid."""
        return len(self.constants) > len(self.strokes)

    @cached_property
    def family(self) -> str:
        """Its distinguishing name: the kind, frozen slot, place of a shape, or misreading."""
        if self.misread:
            return self.misread
        if self.anonymous:
            return self.label
        return f"{GEOMETRY} {self.slot}" if self.slot else f"{self.called} {self.part}".rstrip()

    @property
    def called(self) -> str:
        """The usual name of its kind: ``base_compliance about base``."""
        return self.effect.label if self.effect else self.kind

    def apart(self, other: Hypothesis) -> float:
        """Return the sum of relative differences of two hypotheses' grid constants.

        A constant that only one of them has counts as 0 in the other.
        """
        names = sorted({*self.constants, *other.constants} - {*self.strokes, *other.strokes})
        pairs = [(self.constants.get(n, 0.0), other.constants.get(n, 0.0)) for n in names]
        return sum(abs(a - b) / (abs(a) + abs(b)) for a, b in pairs if a != b)

    @cached_property
    def label(self) -> str:
        """Readable name: ``backlash on leg2``."""
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
"""The topic of a reason that names files."""


@dataclass(frozen=True)
class Untestable:
    """A kind that the data cannot test, and what is missing."""

    kind: str
    missing: tuple[str, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class Library:
    """All hypotheses, their whitened columns as ``products`` (N, m, T), and untestable kinds.

    ``misread``: effects of misinterpreted columns.
    """

    products: Products
    hypotheses: tuple[Hypothesis, ...]
    untestable: tuple[Untestable, ...]
    misread: tuple[Hypothesis, ...] = ()

    @property
    def count(self) -> int:
        """Number of columns."""
        return self.products.shape[0]

    @property
    def columns(self) -> Array:
        """All columns (N, m, T), computed on access."""
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
    """Add every frozen slot, and those freed for the test."""
    problem = to.system.problem
    effects = {p for e in problem.mechanism.effects for p in e.parameters.values()}
    taken = (set(problem.free) - set(tried)) | effects
    unseen = _as_free_ones(to.system) if all(d.kind.inside for d in problem.datasets) else None
    for p, parameter in enumerate(problem.mechanism.parameters):
        if p in taken or parameter.per_unit or is_joint_component(parameter.name):
            continue
        shifts = [slot_shift(to.system, p) for _ in to.system.parts]
        if unseen is not None and unseen(shifts):
            continue    # it only moves the frame, to which joint values are blind
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
"""Independent part of a column below which it counts as a combination of others."""


def _as_free_ones(system: System) -> Callable[[Sequence[Shift]], bool]:
    """Return a test whether shifts are a linear combination of free parameters."""
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
"""Anonymous shapes: place and width as fractions of the stroke; width 0 is a kink."""


def shapes(to: Collector) -> None:
    """Add anonymous shapes: bumps and kinks along each joint, distortion of positions.

    They represent local damage, a bent guide, a lens and the like; whatever they fit has no name
    here.
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
        # a stretch that moves each point along its direction from the middle
        along = np.maximum(np.sum(point**2, axis=1), 1e-12)[:, None, None]
        turn = np.eye(3) - middle[:, None] * point[:, None, :] / along
        shifts.append(Shift(stretch=swell[:, None, None] * turn))
    to.hypotheses.append(Hypothesis(DISTORTION, (), True, ("cubic",), (-np.inf,), (np.inf,),
                           (to.columns.shifted(shifts),), anonymous=True,
                           follows="position"))


def _shape(travel: Array, at: float, width: float) -> Array:
    """Return a bump of a width, or a kink if the width is 0."""
    away = travel - at
    return np.asarray(np.exp(-0.5 * (away / width) ** 2) if width else np.maximum(away, 0.0))
