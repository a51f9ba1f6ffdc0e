"""The file that says who certifies what: machine, customer, instrument, decision rule."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from datetime import date
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field

from ppmcal.errors import BadInput
from ppmcal.io.json_schema import Schema, finished
from ppmcal.io.results.certificate import ISO_AXES, ISO_POSES
from ppmcal.io.schema import (
    Label,
    Positive,
    Strict,
    UnitsFile,
    check,
    choice,
    is_number,
    refuse,
    show,
)
from ppmcal.io.schema import numbers as numbers_of
from ppmcal.io.yaml import read_yaml

FORMAT = "ppmcal/about/1"
NONE, SIMPLE, GUARDED = "none", "simple acceptance", "guarded acceptance"
T95, K2 = "t", "2"
LARGEST, P95, RMS = "largest error", "95 % point", "rms error"


def _date(value: object) -> str:
    text = value.strip() if isinstance(value, str) else str(value)
    try:
        if not re.fullmatch(r"\d{4}-\d{2}-\d{2}", text):
            raise ValueError
        date.fromisoformat(text)
    except ValueError:
        raise refuse(f"{show(value)} is not a date", "Write it as 2026-03-14") from None
    return text


def _country(value: object) -> str:
    if not isinstance(value, str) or not re.fullmatch("[A-Z]{2}", value):
        raise refuse(f"{show(value)} is not a country code", "Write two capital letters: DE")
    return value


def _interval(value: object) -> list[float]:
    pair: list[Any] = value if isinstance(value, list) else [value, value]
    if len(pair) != 2 or not all(is_number(v) and -274.0 < v < 1e4 for v in pair) or (
            pair[0] > pair[1]):
        raise refuse(f"{show(value)} is not a temperature nor a range of them",
                     "Write °C, such as 20.1 or [19.5, 20.5]")
    return [float(v) for v in pair]


def _coverage(value: object) -> str:
    if str(value) not in (T95, K2):
        raise refuse(f"{show(value)} is not a way to expand the uncertainty",
                     "Write t for 95 % of Student's t, or 2 for k = 2")
    return str(value)


Date = Annotated[str, BeforeValidator(_date)]
Country = Annotated[str, BeforeValidator(_country)]
Celsius = Annotated[list[float], BeforeValidator(_interval,
                                                 json_schema_input_type=float | list[float])]
Coverage = Annotated[str, BeforeValidator(_coverage)]
Repeats = Annotated[int, BeforeValidator(numbers_of(
    lambda v: 3 <= v <= 1000, "a number of repeats", "Write a whole number from 3 on", int))]


class MachineFile(Strict):
    """``machine: {maker: ACME, serial: 0815}``."""

    examples: ClassVar[Mapping[str, str]] = {"maker": "maker: ACME", "serial": "serial: A-0815"}
    maker: Label
    """Who made it."""
    serial: Label
    """Its serial number."""
    model: Label | None = None
    """Its type."""


class PartyFile(Strict):
    """``customer: {name: ACME, country: DE}``: customer or laboratory."""

    examples: ClassVar[Mapping[str, str]] = {"name": "name: ACME", "country": "country: DE"}
    name: Label
    """Of the firm."""
    country: Country
    """Two letters by ISO 3166-1."""
    city: Label | None = None
    """Where it is."""
    accreditation: Label | None = None
    """Number of a laboratory's accreditation."""


class AboutInstrumentFile(Strict):
    """``instrument: {make: ..., serial: ..., certificate: ..., ...}``."""

    examples: ClassVar[Mapping[str, str]] = {
        "make": "make: Leica AT960", "serial": "serial: '750123'",
        "certificate": "certificate: D-K-15000-2026-01", "calibrated": "calibrated: 2026-01-10",
        "uncertainty": "uncertainty: 0.01", "coverage_factor": "coverage_factor: 2"}
    make: Label
    """Maker and type."""
    serial: Label
    """Its serial number."""
    certificate: Label
    """Number of its own calibration certificate."""
    calibrated: Date
    """When it was calibrated, such as 2026-01-10."""
    uncertainty: Positive
    """Expanded uncertainty of a length by that certificate, in `units`."""
    coverage_factor: Positive
    """What that was expanded by: the standard uncertainty is `uncertainty` over it."""


class RepeatsFile(Strict):
    """``repeats: {iso_9283: 10}``: fewer than the standard asks, if customer and laboratory agree.

    They are told beside every figure.
    """

    iso_9283: Repeats = ISO_POSES
    """Attained poses of each commanded pose from one direction."""
    iso_230_2: Repeats = ISO_AXES
    """Approaches of each target position from each side."""


class DecisionFile(Strict):
    """``decision: {rule: guarded acceptance, limit: 0.1}``."""

    examples: ClassVar[Mapping[str, str]] = {"rule": f"rule: {GUARDED}", "limit": "limit: 0.1"}
    rule: Annotated[str, choice("decision rule", NONE, SIMPLE, GUARDED)]
    """Guarded: the limit less the expanded uncertainty has to be kept (ILAC-G8, JCGM 106)."""
    limit: Positive | None = None
    """The largest error that is allowed, in `units`."""
    of: Annotated[str, choice("figure", LARGEST, P95, RMS)] = LARGEST
    """The figure of position that has to keep it."""


class AboutFile(Strict):
    """Who certifies what."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}", "units": "units: {length: mm, angle: deg}",
        "number": "number: C-2026-014", "machine": "machine: {maker: ACME, serial: A-0815}",
        "customer": "customer: {name: ACME, country: DE}",
        "laboratory": "laboratory: {name: Calibration Ltd, country: DE}",
        "date": "date: 2026-03-14", "operator": "operator: A. Smith",
        "temperature": "temperature: [19.5, 20.5]"}
    format: Annotated[str, choice("format", FORMAT)]
    """The kind of file, ppmcal/about/1."""
    units: UnitsFile
    """Units of every number in the file."""
    number: Label
    """Number of the certificate; no other one has it."""
    machine: MachineFile
    """What is certified."""
    customer: PartyFile
    """For whom."""
    laboratory: PartyFile
    """By whom."""
    instrument: AboutInstrumentFile | None = None
    """What measured; left out of a machine that measures itself by its joints alone."""
    date: Date
    """When it was measured, such as 2026-03-14."""
    issued: Date | None = None
    """When the certificate is issued  [default: that day]."""
    operator: Label
    """Who measured."""
    temperature: Celsius
    """Of the air, °C: one value, or the lowest and the highest."""
    conditions: dict[str, Label] = Field(default_factory=dict)
    """Further conditions, name and words."""
    repeats: RepeatsFile = RepeatsFile()
    """Repeats that were agreed, where they are not those of the standards."""
    coverage: Coverage = T95
    """How the uncertainty is expanded: t (95 % of Student's t) or 2 (k = 2)."""
    decision: DecisionFile = DecisionFile(rule=NONE)
    """What the errors have to keep."""

    @property
    def length(self) -> float:
        """The SI value of a length's unit."""
        return self.units.units().factor("length")


def read_about(path: str | os.PathLike[str]) -> AboutFile:
    """Return what such a file says, checked.

    Raises:
        BadInput: anything wrong in it, with file, place and hint.
    """
    file = check(AboutFile, read_yaml(Path(path)), str(path))
    if file.decision.rule != NONE and file.decision.limit is None:
        raise BadInput(f"the rule '{file.decision.rule}' needs a limit", f"{path}: decision",
                       "Add a line such as `limit: 0.1`, or write `rule: none`")
    if (file.issued or file.date) < file.date:
        raise BadInput(f"the certificate is issued on {file.issued}, before the measurement",
                       f"{path}: issued", f"Write {file.date} or a later day")
    return file


def about_schema() -> Schema:
    """Return the JSON Schema of such a file."""
    return finished(AboutFile.model_json_schema(), "ppmcal certify (who certifies what)")
