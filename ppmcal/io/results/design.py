"""What the records of sensitivity, tolerances, stiffness, workspace and plan have in common."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, ClassVar

from ppmcal.io.results.record import Part, PlainCell, Record, Text
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Key


class ShownTable(Part):
    """A table for people; units of its columns are in the record's ``units``, by name."""

    title: Text = ""
    columns: tuple[Text, ...] = ()
    rows: tuple[tuple[PlainCell, ...], ...] = ()
    note: Text = ""


class AnalysisRecord(Record):
    """What the records of sensitivity, tolerances, stiffness and plan begin with."""

    FILE: ClassVar[str] = ""
    FORMAT: ClassVar[str] = ""

    name: Text = ""
    summary: Annotated[tuple[Text, ...], Key("said")] = ()
    units: Mapping[str, Text] = field(default_factory=dict)
    findings: tuple[Text, ...] = ()


def geometry_note(mechanism: Mechanism) -> list[str]:
    """Return that an analysis of geometry leaves the file's effects out, if it has any."""
    kinds = ", ".join(dict.fromkeys(e.kind.name for e in mechanism.effects))
    return [f"Geometry only: the file's effects ({kinds}) are left out."] if kinds else []
