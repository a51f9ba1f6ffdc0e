"""Units of the columns of a fit, and arrays as plain numbers."""

from __future__ import annotations

from ppmcal.io.results.record import Finite
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

Numbers = tuple[Finite | None, ...]


def numbers(values: Array) -> Numbers:
    """Return an array (N,) as plain numbers."""
    return tuple(values.tolist())


def column_factor(mechanism: Mechanism, name: str) -> float:
    """Return the SI value of one file unit of a parameter or of an open quantity."""
    for p in mechanism.parameters:
        if p.name == name:
            return mechanism.units.factor(p.quantity)
    head = name.split(" of ")[0]
    if head.startswith("homing."):
        return mechanism.joint_units[mechanism.actuators.index(head.removeprefix("homing."))][0]
    if head == "scale":
        return 1e-6
    return mechanism.units.factor("angle" if head.split(".")[-1].startswith("r") else "length")


def column_unit(mechanism: Mechanism, name: str) -> str:
    """Return the unit of a parameter or of an open quantity, in file units."""
    if name in mechanism.names:
        return parameter_unit(mechanism, name)
    head = name.split(" of ")[0]
    if head.startswith("homing."):
        return mechanism.joint_units[mechanism.actuators.index(head.removeprefix("homing."))][1]
    if head == "scale":
        return "ppm"
    return mechanism.units.name("angle" if head.split(".")[-1].startswith("r") else "length")


def parameter_unit(mechanism: Mechanism, name: str) -> str:
    """Return the unit of a parameter in the mechanism file."""
    p = mechanism.parameters[mechanism.names.index(name)]
    return mechanism.units.name(p.quantity) + ("/unit" if p.per_unit else "")
