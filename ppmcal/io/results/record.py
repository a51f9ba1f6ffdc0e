"""What every result has in common: the JSON of a command, where it comes from, and its tables.

A record is the content of one JSON file of a command, in the units that it names. The engine's
result is turned into it once (``Record.of``); console, report and later commands use it alike, so
that what is read back is what was written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self, dataclass_transform

from ppmcal import codec
from ppmcal.codec import AGAIN, reader_of
from ppmcal.errors import BadInput
from ppmcal.io.csv import csv_lines
from ppmcal.io.json import read_object
from ppmcal.plain import Reader, WrongKind, json_text, plain
from ppmcal.store.output import LongText
from ppmcal.store.provenance import Provenance
from ppmcal.units import SI, Units, as_now
from ppmcal.units import Finite as Finite


def _cell(value: Any, bounded: bool) -> Any:
    if isinstance(value, list | tuple | Mapping):
        raise WrongKind("a number or text", value)
    return value


Shown = float
"""A number that is only shown: of any size."""
Text = str
"""A text; of a file's name it may hold what UTF-8 cannot, as ``\\udcff``."""
UnitText = Annotated[str, Reader(lambda value, bounded: as_now(reader_of(str).read(value, bounded)),
                                 lambda _: {"type": "string"}, "")]
"""A unit's name, whichever version wrote it."""
Whole = int
"""A whole number; of what is read one that a float holds exactly."""
Flag = bool
PlainCell = Annotated[Any, Reader(_cell, lambda _: {})]
"""A cell of a table: a number, text, true, false or nothing."""


@dataclass_transform(frozen_default=True, kw_only_default=True,
                     field_specifiers=(field,))
class Part:
    """An object of a file: its subclasses are frozen dataclasses that hold what JSON can hold.

    What they are given becomes plain data: nan and inf are None. Keys that nobody gave are not
    written.

    Attributes:
        given: names of the fields that were given.
        more: what a file held beside the fields.
    """

    given: ClassVar[frozenset[str]] = frozenset()
    more: ClassVar[Mapping[str, Any]] = {}

    def __init_subclass__(cls) -> None:
        """Make a dataclass of a subclass."""
        dataclass(frozen=True, kw_only=True)(cls)

    def __new__(cls, **given: Any) -> Self:
        """Note what is given."""
        self = super().__new__(cls)
        self.__dict__["given"] = frozenset(given)
        return self

    def __post_init__(self) -> None:
        """Make plain data of what is given.

        Raises:
            WrongKind: a value of another kind.
        """
        data = {f.key: _parts(getattr(self, f.name)) for f in codec.shape(type(self))
                if f.name in self.given}
        made = codec.reader_of_class(type(self)).read(data, False)
        self.__dict__.update(made.__dict__)

    @classmethod
    def checked(cls, data: Mapping[str, Any], path: Path = Path(), hint: str = AGAIN) -> Self:
        """Return plain data, read from a file, as an object.

        Raises:
            BadInput: a value of another kind.
        """
        return codec.decoded(cls, data, path, hint)

    @classmethod
    def filled(cls, found: object = None, units: Units = SI, /, **own: Any) -> Self:
        """Return the object with the fields of a finding, SI, in the units of a file.

        ``own``: values, SI too, in place of the finding's of the same name, or beside them; of a
        quantity that the object does not say itself as well.
        """
        there = {f.name: getattr(found, f.name) for f in codec.shape(cls)
                 if hasattr(found, f.name)}
        return cls(**codec.fields_in_units(cls, there | own, units))

    def changed(self, **values: Any) -> Self:
        """Return the object with other values."""
        own = type(self)(**{n: getattr(self, n) for n in self.given} | values)
        own.__dict__["more"] = self.more
        return own

    def entries(self, whole: bool = False) -> dict[str, Any]:
        """Return what was given as plain data, or the ``whole`` with what is as it was."""
        out: dict[str, Any] = codec.encoded(self, whole)
        return out


def _parts(value: Any) -> Any:
    """Return what the engine hands over as plain data, but objects as they are."""
    if is_dataclass(value):
        return value
    if isinstance(value, Mapping):
        return {str(k): _parts(v) for k, v in value.items()}
    if isinstance(value, list | tuple) and value and not isinstance(value[0], float | int):
        return [_parts(v) for v in value]
    return plain(value)


class Record(Part):
    """The content of one JSON file.

    Subclasses name the file, its ``format`` and, field by field, its keys in their order. Keys
    that nobody set are not written. ``EARLIER``: formats that are still read.
    """

    FILE: ClassVar[str]
    FORMAT: ClassVar[str]
    EARLIER: ClassVar[tuple[str, ...]] = ()

    format: Text = ""

    def text(self) -> str:
        """Return the JSON, keys in the order of the class."""
        return json_text(self.entries())

    @classmethod
    def read(cls, path: Path, hint: str = AGAIN) -> Self:
        """Return what a file holds.

        Raises:
            BadInput: not readable, no JSON object, another format, or a value of another kind.
        """
        return cls.checked(read_object(path, hint), path, hint)

    @classmethod
    def checked(cls, data: Mapping[str, Any], path: Path = Path(), hint: str = AGAIN) -> Self:
        """Return plain data, read from a file, as a record.

        Raises:
            BadInput: another format, or a value of another kind.
        """
        found = super().checked(data, path, hint)
        if cls.FORMAT and found.format not in ("", cls.FORMAT, *cls.EARLIER):
            raise BadInput(f"is not the {cls.FILE} of this version of ppmcal", str(path), hint)
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
