"""Units of the columns of a fit, and arrays as plain numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

from ppmcal.calibration.fit import HomingShift
from ppmcal.calibration.validation import DoubtfulStretch
from ppmcal.codec import in_units
from ppmcal.io.results.record import Finite
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import COLUMN, JOINTS, PARAMETERS, Units, coordinate_quantity

Numbers = tuple[Finite | None, ...]
JOINT = COLUMN + "homing."
"""Before the name of a joint: its own quantity."""


@dataclass(frozen=True)
class MachineUnits(Units):
    """Units of a machine's file, in which a column of a fit or a joint is a quantity too."""

    mechanism: Mechanism
    parameters: Sequence[str] = ()

    @classmethod
    def of(cls, mechanism: Mechanism, parameters: Sequence[str] = ()) -> MachineUnits:
        """Return the units of a machine's file, and of these ``parameters`` that were fitted."""
        return cls(mechanism.units.length, mechanism.units.angle, mechanism, parameters)

    def factors(self, quantities: Sequence[str]) -> list[float]:
        """Return the SI value of one file unit of each number along an axis of an array."""
        several = {JOINTS: [f for f, _ in self.mechanism.joint_units],
                   PARAMETERS: [column_factor(self.mechanism, p) for p in self.parameters]}
        return [f for q in quantities for f in (
            several[q] if q in several else [self.factor(q)])]

    def factor(self, quantity: str) -> float:
        """Return the SI value of one file unit of a quantity, or of :data:`COLUMN` and a name."""
        column = quantity.removeprefix(COLUMN)
        return super().factor(quantity) if column == quantity else column_factor(self.mechanism,
                                                                                 column)

    def name(self, quantity: str) -> str:
        """Return the name of the unit, empty for a bare number."""
        column = quantity.removeprefix(COLUMN)
        return super().name(quantity) if column == quantity else column_unit(self.mechanism, column)


J = TypeVar("J", HomingShift, DoubtfulStretch)


def of_joints(found: Iterable[J], mechanism: Mechanism) -> tuple[J, ...]:
    """Return findings about joints in file units, each in its joint's."""
    units = MachineUnits.of(mechanism)
    return tuple(in_units(replace(f, unit=JOINT + f.actuator), units) for f in found)


def error_words(mechanism: Mechanism, position: float, rotation: float, digits: int = 4) -> str:
    """Return an error of position, SI, in file units and, where the platform turns, of rotation."""
    text = mechanism.units.words(position, "length", digits)
    return f"{text} and {mechanism.units.words(rotation, 'angle', digits)}" if (
        mechanism.motion.turns) else text


def column_factor(mechanism: Mechanism, name: str) -> float:
    """Return the SI value of one file unit of a parameter or of an open quantity."""
    return _column(mechanism, name)[0]


def column_unit(mechanism: Mechanism, name: str) -> str:
    """Return the unit of a parameter or of an open quantity, in file units."""
    return parameter_unit(mechanism, name) if name in mechanism.names else _column(
        mechanism, name)[1]


def _column(mechanism: Mechanism, name: str) -> tuple[float, str]:
    """Return the SI value of one unit of a column, and the unit, of a parameter its quantity's."""
    head = name.split(" of ")[0]
    quantity = next((p.quantity for p in mechanism.parameters if p.name == name), None)
    if quantity is None and head.startswith("homing."):
        return mechanism.joint_units[mechanism.actuators.index(head.removeprefix("homing."))]
    if quantity is None and head == "scale":
        return 1e-6, "ppm"
    if quantity is None:
        quantity = _of_effect(mechanism, head) or coordinate_quantity(head.split(".")[-1])
    return mechanism.units.factor(quantity), mechanism.units.name(quantity)


def _of_effect(mechanism: Mechanism, head: str) -> str:
    """Return the quantity of ``rope_stretch.c1+c2.strain``, empty of what is no effect's."""
    kind = effect_kinds().get(head.split(".")[0])
    return "" if kind is None else next(s.quantity for s in kind.parameters(mechanism.motion)
                                        if s.name == head.split(".")[-1])


def parameter_unit(mechanism: Mechanism, name: str) -> str:
    """Return the unit of a parameter in the mechanism file."""
    p = mechanism.parameters[mechanism.names.index(name)]
    return mechanism.units.name(p.quantity) + ("/unit" if p.per_unit else "")
