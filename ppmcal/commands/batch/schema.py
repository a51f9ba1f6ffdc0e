"""The models of the manifest of ``ppmcal batch``: its options are those of the commands."""

from __future__ import annotations

import re
from collections.abc import Mapping
from datetime import datetime
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, create_model

from ppmcal.commands import command
from ppmcal.commands.spec import CONSOLE, Taken, flags, taken
from ppmcal.io.json_schema import Schema, finished
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
HeldOut = Annotated[float | str, BeforeValidator(_held_out)]
Seed = Annotated[int, BeforeValidator(SEED)]
Command = Annotated[str, choice("command of a batch", *COMMANDS)]

def options_of(name: str) -> dict[str, Taken]:
    """Return key in a manifest -> option of a command, in their order."""
    own = [one for one in taken(command(name).arguments, CONSOLE) if not one.option.argument]
    return {flags(one)[0].lstrip("-").replace("-", "_"): one
            for one in sorted(own, key=lambda one: one.option.common)}


def _kind(key: str, one: Taken) -> Any:
    """Return how the value of an option is read."""
    if one.option.choices:
        return Annotated[str, choice(one.option.words or key, *one.option.choices)]
    if one.kind.startswith("Mapping["):
        return dict[str, Number]
    if one.several:
        return Several
    return {"bool": Flag, "float": Number, "int": Seed if one.option.least == 0 else Count,
            }.get(one.base, HeldOut if one.kind.startswith("float") else Label)


def _options(name: str) -> type[Strict]:
    """Return the model of the options of a command."""
    fields: dict[str, Any] = {
        key: (_kind(key, one) | None, Field(None, description=one.option.key or one.option.text))
        for key, one in options_of(name).items()}
    return create_model(f"{name.capitalize()}Options", __base__=Strict, __module__=__name__,
                        __doc__=f"Options of ``ppmcal {name}``.", **fields)


OPTIONS: Mapping[str, type[Strict]] = {name: _options(name) for name in COMMANDS}
_EACH: dict[str, Any] = {name: (model, Field(model(), description=f"Options of every {name}."))
                         for name, model in OPTIONS.items()}
OptionsFile = create_model(
    "OptionsFile", __base__=Strict, __module__=__name__, **_EACH,
    __doc__="``options: {identify: {seed: 3}, diagnose: {holdout: 0.2}}``: as on the command line.")


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
    options: OptionsFile = OptionsFile()    # type: ignore[valid-type]
    """Options of each command."""


def manifest_schema() -> Schema:
    """Return the JSON Schema of a manifest."""
    out = ManifestFile.model_json_schema()
    for name, options in OPTIONS.items():
        out["$defs"].setdefault(options.__name__, options.model_json_schema())
        out["$defs"][options.__name__]["title"] = f"Options of {name}"
    out["$defs"]["CampaignFile"]["properties"]["options"] |= {"anyOf": [
        {"$ref": f"#/$defs/{options.__name__}"} for options in OPTIONS.values()]}
    out["properties"]["campaigns"]["minItems"] = 1
    return finished(out, "ppmcal batch (a manifest of campaigns)")
