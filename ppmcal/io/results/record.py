"""What every result has in common: the JSON of a command, where it comes from, and its tables.

A record is the content of one JSON file of a command, in the units that it names. The engine's
result is turned into it once (``Record.of``); console, report and later commands use it alike, so
that what is read back is what was written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Self

from ppmcal.errors import BadInput
from ppmcal.io.csv_writer import LongText, csv_lines
from ppmcal.io.json import AGAIN, read_object
from ppmcal.io.output import json_text
from ppmcal.io.results.codec import Part, Text, Whole
from ppmcal.units import Units


class Provenance(Part):
    """Where results come from: version, SHA-256 of each input, command, options, arithmetic."""

    version: Text = ""
    inputs: Mapping[Text, Text] = field(default_factory=dict)
    command: Text = ""
    seed: Whole | None = None
    function: Text = ""
    options: Mapping[Text, Any] = field(default_factory=dict)
    environment: Mapping[Text, Any] = field(default_factory=dict)
    numpy: Text = ""
    python: Text = ""


class UnitNames(Part):
    """The units of a file."""

    length: Text = ""
    angle: Text = ""

    @classmethod
    def of(cls, units: Units) -> UnitNames:
        """Return the names of units."""
        return cls(length=units.length, angle=units.angle)

    def of_quantity(self, quantity: str) -> str:
        """Return the unit of ``length`` or ``angle``, empty where the file does not say."""
        return self.angle if quantity == "angle" else self.length


class Record(Part):
    """The content of one JSON file.

    Subclasses name the file, its ``format`` and, field by field, its keys in their order. Keys
    that nobody set are not written.
    """

    FILE: ClassVar[str]
    FORMAT: ClassVar[str]

    format: Text = ""

    def text(self) -> str:
        """Return the JSON, keys in the order of the class."""
        return json_text(self.entries())

    @classmethod
    def read(cls, path: Path, mend: str = AGAIN) -> Self:
        """Return what a file holds.

        Raises:
            BadInput: not readable, no JSON object, another format, or a value of another kind.
        """
        return cls.checked(read_object(path, mend), path, mend)

    @classmethod
    def checked(cls, data: Mapping[str, Any], path: Path = Path(), mend: str = AGAIN) -> Self:
        """Return plain data, read from a file, as a record.

        Raises:
            BadInput: another format, or a value of another kind.
        """
        found = super().checked(data, path, mend)
        if cls.FORMAT and found.format not in ("", cls.FORMAT):
            raise BadInput(f"is no {cls.FILE} of this version of ppmcal", str(path), mend)
        return found


class AnyRecord(Record):
    """What any command may have written: findings, and where they come from; format as it is."""

    FILE: ClassVar[str] = ""
    FORMAT: ClassVar[str] = ""

    name: Text = ""
    findings: tuple[Any, ...] | None = None
    units: Mapping[Text, Text] = field(default_factory=dict)
    provenance: Provenance = Provenance()


@dataclass(frozen=True, eq=False)
class Column:
    """One column of a table, in SI: its name, N values, and what quantity they are.

    ``quantity`` is ``length``, ``angle``, a quotient such as ``1/length``, or empty for words,
    counts and bare numbers.
    """

    name: str
    values: Any
    quantity: str = ""


def in_units(columns: Sequence[Column], units: Units) -> dict[str, Any]:
    """Return name -> values of columns in the file's units, converted here and nowhere else."""
    return {c.name: c.values / units.factor(c.quantity) if c.quantity else c.values
            for c in columns}


def table_lines(columns: Sequence[Column], units: Units) -> LongText:
    """Return a long CSV of columns in the file's units."""
    over = [units.factor(c.quantity) if c.quantity else None for c in columns]
    return csv_lines([c.name for c in columns], [c.values for c in columns], over)


def table_text(columns: Sequence[Column], units: Units) -> str:
    """Return a CSV of columns in the file's units."""
    return str(table_lines(columns, units))
