"""The contents of a machine's certificate: figures of its accuracy, and the budget of the GUM.

All SI; files use their own units.
"""

from __future__ import annotations

import math
from dataclasses import InitVar, dataclass, field

from scipy.special import stdtrit

from ppmcal.units import Finite, Length, OfUnit, OrNull

COVERED = 0.95


@dataclass(frozen=True)
class Figure:
    """One figure of ``unit``; ``value`` is None if the rows do not allow it, and ``why``.

    ``unit``: length or angle, or an actuator's quantity; once set, the unit itself; ``expanded``:
    its expanded uncertainty; ``repeats``: fewest behind it, ``asked``: number required;
    ``where``: joint or coordinate; ``file``: which of several.
    """

    symbol: str
    name: str
    value: OfUnit[Finite | None]
    expanded: OfUnit[Finite | None] = field(default=None, kw_only=True)
    unit: str = "length"
    norm: str = ""
    repeats: int = 0
    asked: int = 0
    where: str = ""
    why: str = ""
    file: str = ""

    @property
    def place(self) -> str:
        """Joint or coordinate, and the file."""
        return f"{self.where} ({self.file})".strip() if self.file else self.where

    @property
    def label(self) -> str:
        """Its name, with its symbol."""
        return f"{self.name}, {self.symbol}" if self.symbol else self.name

    @property
    def of_position(self) -> bool:
        """Whether the budget's expanded uncertainty applies to it, SI."""
        return (self.value is not None and self.unit == "length"
                and self.symbol in ("", "AP_p"))


@dataclass(frozen=True)
class Contribution:
    """One line of the budget; ``degrees`` inf if taken as known.

    ``sensitivity``: of the measurand to it, bare; ``part``: its contribution to the
    measurand; ``note``: source of the number.
    """

    source: str
    kind: str
    distribution: str
    standard: Length[Finite]
    degrees: Finite
    sensitivity: OrNull[Finite] = 1.0
    part: Length[Finite] = field(init=False, default=math.nan)
    note: str = ""

    def __post_init__(self) -> None:
        """Compute its contribution."""
        self.__dict__["part"] = abs(self.sensitivity) * self.standard


@dataclass(frozen=True)
class Budget:
    """The uncertainty by the GUM, ``of`` a position along any one direction, or of a closure.

    ``combined``: the standard uncertainty; ``degrees``: effective ones by Welch and Satterthwaite,
    inf if all are known; ``factor``: coverage factor, 2 if ``twice``, or else Student's t of
    whole degrees for 95 %.
    """

    of: str
    lines: tuple[Contribution, ...]
    combined: Length[Finite] = field(init=False, default=math.nan)
    degrees: Finite = field(init=False, default=math.nan)
    factor: Finite = field(init=False, default=math.nan)
    coverage: OrNull[Finite] = field(init=False, default=COVERED)
    expanded: Length[Finite] = field(init=False, default=math.nan)
    twice: InitVar[bool] = False

    def __post_init__(self, twice: bool) -> None:
        """Combine and expand the lines."""
        combined = math.sqrt(sum(c.part**2 for c in self.lines))
        below = sum(c.part**4 / c.degrees for c in self.lines if math.isfinite(c.degrees))
        degrees = combined**4 / below if below > 0.0 else math.inf
        whole = max(math.floor(degrees), 1) if math.isfinite(degrees) else 1e9
        factor = 2.0 if twice else float(stdtrit(whole, 0.5 * (1.0 + COVERED)))
        self.__dict__.update(combined=combined, degrees=degrees, factor=factor,
                             expanded=factor * combined)


@dataclass(frozen=True)
class PlacedError:
    """A place (base frame) and the error there, for the map."""

    place: Length[tuple[Finite | None, ...]]
    error: Length[Finite]
