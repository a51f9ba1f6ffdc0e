"""Limbs as read, before their slots are tied into parameters."""

from __future__ import annotations

from dataclasses import dataclass, field

from ppmcal.linalg import Array
from ppmcal.model.limbs import LimbKind


@dataclass(frozen=True)
class Entry:
    """What the file says about one slot; SI, None where it says nothing.

    ``default`` is the value without one; ``standing`` whether the entry is fixed at its
    default because the file does not mention it (``lateral``).
    """

    path: str
    place: str
    quantity: str
    tolerance_class: str
    default: float | None = None
    value: float | None = None
    nominal: float | None = None
    tolerance: float | None = None
    sigma: float | None = None
    fixed: bool | None = None
    share: str | None = None
    standing: bool = False


@dataclass
class Draft:
    """One limb as read: entries in parameter order, and how slots follow from them.

    ``direct``: slot names that take an entry's value; ``polar``: (slot x, slot y, path of
    the radius, path of the angle). ``numbers``: lengths and angles as printed in the file.
    """

    name: str
    kind: LimbKind
    actuator: str
    entries: list[Entry] = field(default_factory=list)
    direct: list[str] = field(default_factory=list)
    polar: list[tuple[str, str, str, str]] = field(default_factory=list)
    constants: dict[str, Array] = field(default_factory=dict)
    shared_directions: dict[str, str] = field(default_factory=dict)
    branch: int | None = None
    numbers: list[tuple[str, float]] = field(default_factory=list)

    @property
    def has_ratio(self) -> bool:
        """Whether the file gives the limb a drive ratio."""
        return "ratio" in self.direct
