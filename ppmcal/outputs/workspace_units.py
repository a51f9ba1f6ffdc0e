"""Units of what ``workspace`` found, its rows of modes, and why poses are left out."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

from ppmcal.design.assembly_modes import Modes
from ppmcal.design.workspace import Workspace
from ppmcal.linalg import Array


@dataclass(frozen=True, eq=False)
class ModeRow:
    """Assembly modes at one row of joint values.

    ``row``: its number in the user's file from 1, 0 for home's joints; ``q`` (k,);
    ``modes`` None where they could not be had, with the ``reason``.
    """

    row: int
    q: Array
    modes: Modes | None
    reason: str = ""


def distance_unit(found: Workspace) -> tuple[float, str]:
    """Return SI value and name of the unit of distances to singularities."""
    units = found.mechanism.units
    return units.factor(found.distance_quantity), units.name(found.distance_quantity)


def size_unit(found: Workspace) -> tuple[float, str]:
    """Return SI value and name of the unit of the reachable part: ``mm^2``, ``mm^2 deg``."""
    units = found.mechanism.units
    factor, parts = 1.0, []
    turns = sum(c >= 3 for c in found.grid.coordinates)
    for quantity, count in (("length", len(found.grid.coordinates) - turns), ("angle", turns)):
        factor *= units.factor(quantity) ** count
        if count:
            parts.append(units.name(quantity) + (f"^{count}" if count > 1 else ""))
    return factor, " ".join(parts)


def size_word(found: Workspace) -> str:
    """Return what the size of the reachable part is called; ``extent`` where angles are in it."""
    if any(c >= 3 for c in found.grid.coordinates):
        return "extent"
    return {1: "length", 2: "area", 3: "volume"}.get(len(found.grid.coordinates), "extent")


def why(found: Workspace) -> dict[str, int]:
    """Return why poses of the grid are left out, and how many for each reason."""
    words: Counter[str] = Counter()
    for status, reason in zip(found.table.status, found.table.reason, strict=True):
        if status == "singular":
            reason = "next to a singularity"
        elif status == "limits":
            reason = re.sub(r" = \S+( \w+)? is outside", " is outside", reason)
        elif status == "unreachable":
            reason = re.sub(r" by \S+ \w+$", "", reason.partition(":")[0])
        if status != "ok":
            words[reason] += 1
    return dict(words.most_common())
