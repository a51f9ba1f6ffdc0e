"""What every result has in common: typed parts, written to and read from JSON by themselves.

A record is the content of one JSON file of a command, in the units that it names. The engine's
result is turned into it once (``Record.of``); console, report and later commands use it alike, so
that what is read back is what was written. A file may be cut off, edited by hand or written by
another version: keys that are missing or unknown pass, and so does null, which counts as missing
where a field knows no null; a value of the wrong kind is refused with file and place.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Self

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    InstanceOf,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic_core import PydanticCustomError

from ppmcal.errors import BadInput
from ppmcal.io.csv_writer import LongText, csv_lines
from ppmcal.io.json import AGAIN, LARGEST, read_object
from ppmcal.io.output import json_text, plain
from ppmcal.units import Units, as_now

LARGEST_WHOLE = 2 ** 53
_READ = "read"
"""The context in which data come out of JSON, as they are."""

Shown = Annotated[float, Field(strict=True)]
"""A number that is only shown: of any size."""


def _bounded(value: float, info: ValidationInfo) -> float:
    if info.context == _READ and not abs(value) <= LARGEST:
        raise PydanticCustomError("too_large", "too large")
    return value


def _exact(value: int, info: ValidationInfo) -> int:
    if info.context == _READ and not abs(value) <= LARGEST_WHOLE:
        raise PydanticCustomError("too_large_whole", "too large")
    return value


Finite = Annotated[float, Field(strict=True, json_schema_extra={
    "minimum": -LARGEST, "maximum": LARGEST}), AfterValidator(_bounded)]
"""A number that is calculated with: of what is read, :data:`LARGEST` at most."""
Text = InstanceOf[str]
"""A text; of a file's name it may hold what UTF-8 cannot, as ``\\udcff``."""
UnitText = Annotated[Text, AfterValidator(as_now)]
"""A unit's name, whichever version wrote it."""
Whole = Annotated[int, Field(strict=True), AfterValidator(_exact)]
"""A whole number; of what is read one that a float holds exactly."""
Flag = Annotated[bool, Field(strict=True)]

_KINDS = {"float_type": "a number", "int_type": "a whole number",
          "int_from_float": "a whole number", "is_instance_of": "text",
          "bool_type": "true or false", "cell_type": "a number or text", "dict_type": "an object",
          "mapping_type": "an object",
          "list_type": "a list", "tuple_type": "a list", "model_type": "an object",
          "model_attributes_type": "an object",
          "too_large": f"a number, {LARGEST:g} at most",
          "too_large_whole": f"a whole number, {LARGEST_WHOLE} at most"}


class Part(BaseModel):
    """A part of a record: plain data, nothing but what JSON can hold; nan and inf are None."""

    model_config = ConfigDict(frozen=True, extra="allow")

    @model_validator(mode="before")
    @classmethod
    def _plain(cls, data: Any, info: ValidationInfo) -> Any:
        """Turn what the engine hands over into plain data; JSON is plain already."""
        if not isinstance(data, Mapping):
            return data
        if info.context != _READ:
            data = {k: _parts(v) for k, v in data.items()}
        return {k: v for k, v in data.items() if v is not None or cls._nullable(k)}

    @classmethod
    def _nullable(cls, key: str) -> bool:
        """Whether null says something else than that a key is missing."""
        field = cls.model_fields.get(key)
        return field is not None and field.default is None and field.default_factory is None


def _parts(value: Any) -> Any:
    if isinstance(value, Part):
        return value
    if isinstance(value, Mapping):
        return {str(k): _parts(v) for k, v in value.items()}
    if isinstance(value, list | tuple) and value and not isinstance(value[0], float | int):
        return [_parts(v) for v in value]
    return plain(value)


class Provenance(Part):
    """Where results come from: version, SHA-256 of each input, command, options, arithmetic."""

    version: Text = ""
    inputs: Mapping[Text, Text] = Field(default_factory=dict)
    command: Text = ""
    seed: Whole | None = None
    function: Text = ""
    options: Mapping[Text, Any] = Field(default_factory=dict)
    environment: Mapping[Text, Any] = Field(default_factory=dict)
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
        return json_text(self.model_dump(exclude_unset=True, by_alias=True))

    def entries(self) -> dict[str, Any]:
        """Return the content as plain data."""
        return self.model_dump(exclude_unset=True, by_alias=True)

    @classmethod
    def read(cls, path: Path, mend: str = AGAIN) -> Self:
        """Return what a file holds.

        Raises:
            BadInput: not readable, no JSON object, another format, or a value of another kind.
        """
        return cls.checked(read_object(path, mend), path, mend)

    @classmethod
    def checked(cls, data: Mapping[str, Any], path: Path, mend: str = AGAIN) -> Self:
        """Return plain data, read from a file, as a record.

        Raises:
            BadInput: another format, or a value of another kind.
        """
        try:
            found = cls.model_validate(data, context=_READ)
        except ValidationError as error:
            raise _refusal(error, path, mend) from None
        if cls.FORMAT and found.format not in ("", cls.FORMAT):
            raise BadInput(f"is no {cls.FILE} of this version of ppmcal", str(path), mend)
        return found


class AnyRecord(Record):
    """What any command may have written: findings, and where they come from; format as it is."""

    FILE: ClassVar[str] = ""
    FORMAT: ClassVar[str] = ""

    name: Text = ""
    findings: tuple[Any, ...] | None = None
    units: Mapping[Text, Text] = Field(default_factory=dict)
    provenance: Provenance = Provenance()


def _refusal(error: ValidationError, path: Path, mend: str) -> BadInput:
    """Return the first problem in our own words."""
    first = error.errors()[0]
    place = ""
    for part in first["loc"]:
        place += f"[{part}]" if isinstance(part, int) else f".{part}" if place else part
    kind = _KINDS.get(first["type"], "something else")
    if first.get("input") is None:
        kind = "something, not null"
    return BadInput(f"should be {kind}", f"{path}: {place}", mend)


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
