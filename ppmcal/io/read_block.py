"""The sidecar's block ``read``: its keys, and the units that columns may be in."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from ppmcal.io.clock import ORDERS as ORDERS_OF_DATES
from ppmcal.io.schema import PULSES, ROW_COUNT, SIGN, Label, Strict, choice, refuse, show
from ppmcal.kinematics.pose_readings import AXES, QUATERNIONS
from ppmcal.kinematics.rotations import ORDERS
from ppmcal.linalg import Array
from ppmcal.model.dataset import PAYLOADS, POUND, STANDARD_GRAVITY, ZERO_CELSIUS
from ppmcal.units import ANGLES, LENGTHS, TURN

MATRIX = tuple(f"r{i}{j}" for i in "123" for j in "123")
HOMOGENEOUS: tuple[Mapping[str, str], ...] = tuple(
    {**{f"{letter}{i + low}{j + low}": f"r{i + 1}{j + 1}" for i in range(3) for j in range(3)},
     **{f"{letter}{i + low}{3 + low}": "xyz"[i] for i in range(3)}}
    for letter in "mtrT" for low in (0, 1))
"""Entries of 4 x 4 matrices (m00, t11, ...): header -> our column; the first nine are R's."""
ROTATIONS = ("rotvec", *QUATERNIONS, *(f"euler-{o}" for o in ORDERS), "matrix")
FURTHER: Mapping[str, Mapping[str, float]] = {
    "payload": PAYLOADS,
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0},
    "force": {"N": 1.0, "kN": 1e3, "lbf": POUND * STANDARD_GRAVITY},
    "moment": {"N m": 1.0},
}
TEMPERATURES: Mapping[str, Callable[[Array], Array]] = {
    "C": lambda t: t, "K": lambda t: t - ZERO_CELSIUS, "F": lambda t: (t - 32.0) / 1.8}
ANGULAR = {**ANGLES, "turn": TURN}
UNITS = tuple(dict.fromkeys((*LENGTHS, *ANGULAR, "counts", *TEMPERATURES, *FURTHER["payload"],
                             *FURTHER["time"], *FURTHER["force"], *FURTHER["moment"])))


def _mapping(what: str, one: Callable[[object], object]) -> BeforeValidator:
    def check(value: object) -> dict[str, Any]:
        if not isinstance(value, dict):
            raise refuse(f"{show(value)} is not a mapping", f"Write a column and its {what}, such "
                         "as {q_leg2: ...}")
        return {str(k): one(v) for k, v in value.items()}

    return BeforeValidator(check)


def _header_name(value: object) -> object:
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise refuse(f"{show(value)} is not the name of a column", "Write the file's header there")
    return str(value).strip()


def _names(value: object) -> object:
    counts = [value.count(f"{{{w}}}") for w in ("pose", "target")] if isinstance(value, str) else []
    if sum(counts) == 0 or max(counts) > 1:
        raise refuse(f"{show(value)} does not say where pose and target stand in a name",
                     "Write both once, such as `{pose}_{target}`; `{target}` alone where times "
                     "tell the pose, `{pose}` alone for one target")
    return value


class ReadFile(Strict):
    """How to read the CSV where it is not as the program has it."""

    columns: Annotated[dict[str, str], _mapping("header in the file", _header_name)] = Field(
        default_factory=dict)
    """Our column: the file's header."""
    sheet: Label | None = None
    """Sheet of a spreadsheet  [default: the first]."""
    ignore: list[Label] = Field(default_factory=list)
    """Headers of the file to leave alone."""
    units: Annotated[dict[str, str], _mapping("unit", choice("unit", *UNITS).find)] = Field(
        default_factory=dict)
    """Unit of a column (or of all that a pattern such as q_* names), if not the file's."""
    counts_per_turn: Annotated[float, BeforeValidator(PULSES)] | None = None
    """Counts in a turn of the drive, for columns in counts."""
    signs: Annotated[dict[str, int], _mapping("sign", SIGN)] = Field(default_factory=dict)
    """Sign of a column (or pattern): 1 or -1."""
    rotation: Annotated[str, choice("rotation convention", *ROTATIONS)] | None = None
    """What the rotation columns hold; Euler angles: small letters fixed axes, capitals moving."""
    pose: Annotated[str, choice("pose", "direct", "inverse")] = "direct"
    """inverse: the measuring frame seen from the platform."""
    mirror: Annotated[str, choice("axis", *AXES)] | None = None
    """An axis of the instrument that points the other way (left-handed)."""
    shift: Annotated[int, BeforeValidator(ROW_COUNT)] = 0
    """The measured columns are so many rows behind the joint columns."""
    dates: Annotated[str, choice("order of dates", *ORDERS_OF_DATES)] | None = None
    """Which comes first in a date such as 03/04/2026."""
    zone: Label | None = None
    """Zone of times that name none: UTC, +02:00, Europe/Berlin."""
    names: Annotated[str, BeforeValidator(_names)] | None = None
    """How points are named: {pose} and {target}, such as `{pose}_{target}`."""
    targets: dict[str, Any] = Field(default_factory=dict)
    """Points of the platform by the names in {target}: [x, y, z] or unknown."""
    topics: list[Label] = Field(default_factory=list)
    """Topics of a bag to read  [default: the only ones with joints and poses]."""
