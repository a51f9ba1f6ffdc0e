"""The models of the manifest of ``ppmcal batch``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator

from ppmcal.io.schema import SEED, Count, Flag, Label, Number, Strict, choice, refuse, show

FORMAT = "ppmcal/batch/1"
COMMANDS = ("identify", "diagnose", "compensate")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}(T\d{2}:\d{2}(:\d{2})?)?")
EXAMPLE = "data: runs/{machine}/{date}/*.csv"


def _date(value: object) -> str:
    text = value.strip() if isinstance(value, str) else value
    try:
        # one form, so that the order of dates is that of their texts
        if not isinstance(text, str) or not _DATE.fullmatch(text):
            raise ValueError
        datetime.fromisoformat(text)
    except ValueError:
        raise refuse(f"{show(value)} is not a date", "Write it as 2026-03-14, or with the time: "
                     "2026-03-14T08:30") from None
    return text


def _folder(value: object) -> str:
    name = str(value) if isinstance(value, int) and not isinstance(value, bool) else value
    if not isinstance(name, str) or not re.fullmatch(r"[\w-][\w.-]*", name):
        raise refuse(f"{show(value)} cannot be the name of a folder", "Use letters, digits, _, - "
                     "and ., and no . at the beginning: results are written there")
    return name


def _several(value: object) -> tuple[str, ...]:
    values = value if isinstance(value, list) else [value]
    if not values or not all(isinstance(v, str) and v.strip() for v in values):
        raise refuse(f"{show(value)} is not a path nor a list of paths",
                     f"Write a line such as `{EXAMPLE}`")
    return tuple(values)


def _held_out(value: object) -> float | str:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise refuse(f"{show(value)} is neither a fraction nor a CSV", "Write holdout: 0.2")
    return value


Several = Annotated[tuple[str, ...], BeforeValidator(
    _several, json_schema_input_type=str | list[str])]
Date = Annotated[str, BeforeValidator(_date)]
Folder = Annotated[str, BeforeValidator(_folder)]
Seed = Annotated[int, BeforeValidator(SEED)]
Command = Annotated[str, choice("command of a batch", *COMMANDS)]


class IdentifyOptions(Strict):
    """Options of ``ppmcal identify``."""

    method: Annotated[str, choice("method", "prior", "gcv", "damped")] | None = None
    """Tolerances as prior, their common scale by cross-validation, or the damped scheme."""
    prior: Annotated[str, choice("prior", "tolerances", "flat")] | None = None
    """flat: no prior at all."""
    damping: Number | None = None
    """Of the method damped."""
    iterations: Count | None = None
    """Stop after so many and write what was reached."""
    free: Several | None = None
    """Patterns of the parameters that may change, in place of the file's."""
    holdout: Annotated[float | str, BeforeValidator(_held_out)] | None = None
    """Part of the poses to hold out, or other measurements to test on."""
    leave_out: Annotated[str, choice("part to leave out", "session")] | None = None
    """Predict each session by the others."""
    sigma: Annotated[str, choice("sigma", "stated", "estimated")] | None = None
    """Noise as the files state it, or as residuals show it."""
    start: Label | None = None
    """Start from an earlier calibration: its folder or identified.yaml."""
    keep: Flag | None = None
    """Carry that calibration on."""
    keep_outliers: Flag | None = None
    """Use every row as it is."""
    seed: Seed | None = None
    """Of everything drawn at random."""


class DiagnoseOptions(Strict):
    """Options of ``ppmcal diagnose``."""

    free: Several | None = None
    """Geometry that the fit may change, in place of the file's choice."""
    kind: Several | None = None
    """Try only these kinds of effect."""
    holdout: Number | None = None
    """Part of the poses that no fit sees."""
    leave_out: Annotated[str, choice("part to leave out", "session")] | None = None
    """Predict each session by the others."""
    png: Flag | None = None
    """Write the pictures as PNG too."""
    seed: Seed | None = None
    """Of everything drawn at random."""


class CompensateOptions(Strict):
    """Options of ``ppmcal compensate``."""

    frame: Label | None = None
    """Data set whose measuring frame the targets are in, or base."""
    knowledge: Label | None = None
    """identification.json of the model."""
    approach: Annotated[str, choice("approach", "columns", "sequence")] | None = None
    """Directions of approach: from dir_ columns, or from the order of the targets."""
    path: Flag | None = None
    """Targets are visited in their order: judge the ways between them too  [default: true]."""
    assume: dict[str, Number] | None = None
    """Conditions of all targets that have no column, such as {temperature: 22}."""
    regardless: Flag | None = None
    """Lift the refusals of a model that is not fit for use, and of corrections worse than none."""


class OptionsFile(Strict):
    """``options: {identify: {seed: 3}, diagnose: {holdout: 0.2}}``: as on the command line."""

    identify: IdentifyOptions = IdentifyOptions()
    """Options of every identify."""
    diagnose: DiagnoseOptions = DiagnoseOptions()
    """Options of every diagnose."""
    compensate: CompensateOptions = CompensateOptions()
    """Options of every compensate."""


class CampaignFile(Strict):
    """One campaign, or with ``{machine}`` and ``{date}`` in ``data`` one for each found."""

    examples: ClassVar[Mapping[str, str]] = {"data": EXAMPLE}
    data: Several
    """Measurement files; of compensate the CSV of targets. Patterns are allowed."""
    machine: Folder | None = None
    """Name of the machine, a folder of the results."""
    date: Date | None = None
    """When it was measured, such as 2026-03-14."""
    command: Command | None = None
    """identify, diagnose or compensate."""
    model: Label | None = None
    """Mechanism file; {machine} and {date} are filled in."""
    design: Label | None = None
    """Machines of one design are compared with each other  [default: the model's name]."""
    name: Folder | None = None
    """Folder of the results within machine and date  [default: the command]."""
    options: dict[str, Any] | None = None
    """Options of the command, over those of the whole batch."""


class ManifestFile(Strict):
    """What a batch is to do."""

    examples: ClassVar[Mapping[str, str]] = {
        "format": f"format: {FORMAT}", "campaigns": f"campaigns: [{{{EXAMPLE}}}]"}
    format: Annotated[str, choice("format", FORMAT)]
    """The kind of file, ppmcal/batch/1."""
    campaigns: list[CampaignFile]
    """The campaigns."""
    command: Command = "identify"
    """What is done where a campaign does not say."""
    model: Label | None = None
    """Mechanism file where a campaign does not say."""
    design: Label | None = None
    """Design where a campaign does not say."""
    options: OptionsFile = OptionsFile()
    """Options of each command."""


OPTIONS: Mapping[str, type[Strict]] = {
    "identify": IdentifyOptions, "diagnose": DiagnoseOptions, "compensate": CompensateOptions}
ON_BY_DEFAULT = ("path",)
"""Options that are a pair on the command line, ``--path/--no-path``, and on unless said."""
