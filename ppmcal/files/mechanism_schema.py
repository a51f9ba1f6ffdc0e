"""The models of the mechanism file, as far as they do not depend on the limb kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BeforeValidator, Field

from ppmcal.files.schema import (
    Flag,
    Label,
    Number,
    Path,
    Positive,
    Spread,
    Strict,
    UnitsFile,
    choice,
    refuse,
    show,
    vector,
)

FORMAT = "ppmcal/mechanism/1"


def _range(value: list[float]) -> list[float]:
    if value[0] >= value[1]:
        raise refuse(f"the lower limit {value[0]:g} is not below the upper {value[1]:g}",
                     "Write [lower, upper]")
    return value


def _extended(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
        raise refuse(f"{show(value)} is not a number", "Write a number, .inf or -.inf")
    return float(value)


def _pattern(value: object) -> str:
    if not isinstance(value, str) or not value:
        raise refuse(f"{show(value)} is not a pattern",
                     'Write a pattern over parameter names in quotes, such as "*.offset"')
    return value


class SlotFile(Strict):
    """One slot: ``120`` or ``{value: 120, tolerance: 0.2, fixed: true}``."""

    value: Number | None = None
    tolerance: Spread | None = None
    fixed: Flag | None = None
    nominal: Number | None = None
    sigma: Spread | None = None
    share: Path | None = None


def _three_spreads(value: object) -> list[float]:
    values = value if isinstance(value, list) else [value] * 3
    if len(values) != 3:
        raise refuse(f"a number or a list of 3 is needed here, this has {len(values)}",
                     "Write one standard deviation, or [rx, ry, rz]")
    out = []
    for one in values:
        if isinstance(one, bool) or not isinstance(one, int | float) or not one >= 0.0:
            raise refuse(f"{show(one)} is not a standard deviation",
                         "Write a number of 0 or more, or .inf for no prior")
        out.append(float(one))
    return out


class DirectionFile(Strict):
    """A unit vector: ``[0, 0, 1]`` or with its error, a small rotation in base axes.

    The machine's direction is Rot(``rotation``) ``value``; ``nominal`` is the drawing's
    direction; ``sigma`` and ``tolerance`` belong to the rotation's rx, ry, rz.
    """

    value: Annotated[list[float], vector(3)] | None = None
    nominal: Annotated[list[float], vector(3)] | None = None
    rotation: Annotated[list[float], vector(3)] | None = None
    sigma: Annotated[list[float], BeforeValidator(_three_spreads)] | None = None
    tolerance: Annotated[list[float], BeforeValidator(_three_spreads)] | None = None
    fixed: Flag | None = None
    share: Path | None = None


class TolerancesFile(Strict):
    """One standard deviation for each class of slots."""

    point: Spread | None = None
    length: Spread | None = None
    angle: Spread | None = None
    offset: Spread | None = None


class CostFile(Strict):
    """What a tolerance costs: weight / tolerance^exponent, the tolerance in file units."""

    weight: Positive = 1.0
    exponent: Positive = 1.0


def _cost(value: object) -> object:
    return value if isinstance(value, dict | CostFile) else {"weight": value}


class HomeFile(Strict):
    """The pose that selects the assembly mode, and maybe its joint values."""

    examples: ClassVar[Mapping[str, str]] = {"pose": "pose: {x: 0, y: 0, rz: 0}"}
    pose: Any
    q: dict[Label, Number] | None = None


class RegistrationFile(Strict):
    """Frame and target of one data set that was identified."""

    frame: Any = None
    target: Annotated[list[float], vector(3, 2)] | None = None
    target_rotation: Annotated[list[float], vector(3)] | None = None


class MeasurementFile(Strict):
    """``measurement: {datasets: {name: ...}}``, written by identify."""

    datasets: dict[Label, RegistrationFile] = Field(default_factory=dict)


class MechanismFile(Strict):
    """The top of a mechanism file; the limbs are checked against their kinds later."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}",
        "units": "units: {length: mm, angle: deg}",
        "motion": "motion: planar",
        "limbs": "limbs: [{name: leg1, kind: R(P)R, base: {point: [0, 0]}, ...}]",
        "home": "home: {pose: {x: 0, y: 0, rz: 0}}",
    }
    format: Annotated[str, choice("format", FORMAT)]
    units: UnitsFile
    motion: Annotated[str, choice("motion", "planar", "translational", "spatial")]
    limbs: list[dict[Any, Any]]
    home: HomeFile
    name: Label | None = None
    extends: Any = None
    tolerances: TolerancesFile | None = None
    limits: dict[Label, Annotated[list[float], vector(2, of=_extended),
                                  AfterValidator(_range)]] | None = None
    gravity: Annotated[list[float], vector(3, 2)] | None = None
    effects: Any = None
    stiffness: Any = None
    cost: dict[str, Annotated[CostFile, BeforeValidator(_cost)]] | None = None
    measurement: MeasurementFile | None = None
    free: list[Annotated[str, BeforeValidator(_pattern)]] | None = None
