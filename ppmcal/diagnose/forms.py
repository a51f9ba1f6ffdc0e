"""Hypotheses: a kind of effect on some actuators, and the columns that say what it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal.diagnose.system import System
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift

GEOMETRY = "geometry"


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
        turns: periods per stroke of a periodic error.
        choices: logarithm of the number of sets of actuators that it was chosen from.
        low, high: physical range of each column's coefficient.
        usual: the range in which machines have it, by column; empty: any.
        columns: where its columns are in the library.
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
    searched: int = 0
    turns: float = 0.0
    choices: float = 0.0

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

    def apart(self, other: Form) -> float:
        """Return by how much the constants of two forms of a grid differ."""
        return sum(abs(v - other.constants.get(n, v)) for n, v in self.constants.items())

    def alike(self, other: Form) -> bool:
        """Whether the constants are the same; each joint may have a stroke of its own."""
        return self.constants == other.constants or "low" in self.constants

    @property
    def label(self) -> str:
        """Return words for people: ``backlash on leg2``."""
        if self.slot:
            return f"{GEOMETRY} {self.slot}"
        if self.anonymous:
            return f"an unknown shape along {' '.join(self.on) or 'the position'}"
        return f"{self.kind} on {', '.join(self.on)}" if self.on else self.kind


def united(forms: Sequence[Form]) -> Form:
    """Return forms of one kind on one actuator each as one, with values of its own for each."""
    if len(forms) == 1:
        return forms[0]
    return replace(
        forms[0], on=tuple(a for f in forms for a in f.on), shared=False,
        names=tuple(f"{f.on[0]}:{n}" for f in forms for n in f.names),
        low=sum((f.low for f in forms), ()), high=sum((f.high for f in forms), ()),
        columns=sum((f.columns for f in forms), ()), usual=sum((f.usual for f in forms), ()))


@dataclass(frozen=True)
class Untestable:
    """A kind that the data cannot test, and what they lack."""

    kind: str
    missing: tuple[str, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class Library:
    """All hypotheses: ``columns`` (N, m, T) white, ``forms`` over them, and what is untestable.

    ``unrecorded``: what might be there too, but cannot be tested for want of a column.
    """

    columns: Array
    forms: tuple[Form, ...]
    untestable: tuple[Untestable, ...]
    unrecorded: tuple[Form, ...] = ()


class Collector:
    """Collects columns and forms over the rows of a system."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.columns: list[Array] = []
        self.forms: list[Form] = []
        self.untestable: list[Untestable] = []
        self.unrecorded: list[Form] = []
        mechanism = system.problem.mechanism
        self.actuators = mechanism.actuators
        self.motion = mechanism.motion
        self.turning = np.array([q == "angle" for q in mechanism.actuator_quantity])

    def add(self, column: Array) -> int:
        """Add one white column (N, m); return where it is."""
        self.columns.append(column)
        return len(self.columns) - 1

    def shifted(self, shifts: list[Shift]) -> int:
        """Add the column of one shift per part; return where it is."""
        return self.add(self.system.column(shifts))

    def library(self) -> Library:
        """Return what was collected."""
        shape = (*self.system.residual.shape, 0)
        columns = np.stack(self.columns, axis=-1) if self.columns else np.zeros(shape)
        return Library(columns, tuple(self.forms), tuple(self.untestable),
                       tuple(self.unrecorded))
