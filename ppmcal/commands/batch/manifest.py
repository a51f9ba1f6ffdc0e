"""The manifest of ``ppmcal batch``: which campaigns of which machines, and what to do with each.

Paths are relative to the manifest's folder. ``*``, ``?`` and ``**`` find data files; with
``{machine}`` and ``{date}`` in the pattern one entry stands for a campaign of each machine and date
whose files there are.
"""

from __future__ import annotations

import glob
import os
import re
import shlex
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator, Field, create_model

from ppmcal.commands import command
from ppmcal.commands.spec import CONSOLE, Taken, flags, taken
from ppmcal.errors import BadInput
from ppmcal.io.json_schema import Schema, finished
from ppmcal.io.schema import SEED, Count, Flag, Label, Number, Strict, check, choice, refuse, show
from ppmcal.io.yaml import read_yaml

FORMAT = "ppmcal/batch/1"
COMMANDS = ("identify", "diagnose", "compensate")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}(T\d{2}:\d{2}(:\d{2})?)?")
_TOKENS = re.compile(r"(\{machine\}|\{date\}|\*\*/|\*|\?|\[[^\]]+\])")
_MEANING = {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}
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


# ---- the campaigns


@dataclass(frozen=True)
class CampaignJob:
    """One command on the files of one machine and date.

    Attributes:
        name: folder of the results, ``machine/date/command``, unique in the batch.
        machine, date: as in the manifest; the date in the form of ISO 8601.
        design: machines of one are compared with each other, empty for the model's name.
        command: identify, diagnose, compensate, or compare for what changed since last time.
        model: mechanism file, relative to the manifest.
        data: the other files, relative to the manifest.
        options: name -> value of those that were given.
    """

    name: str
    machine: str
    date: str
    design: str
    command: str
    model: str
    data: tuple[str, ...]
    options: tuple[tuple[str, Any], ...] = ()

    def typed(self, out: str) -> str:
        """Return the command line that does the same from the manifest's folder."""
        words = ["ppmcal", self.command, self.model, *self.data]
        known = options_of(self.command) if self.options else {}
        for name, value in self.options:
            flag, *off = flags(known[name])
            if isinstance(value, bool):    # of a pair, the first is what is done unless asked
                words += off * (not value) if off else [flag] * value
            else:
                for one in _each(value):
                    words += [flag, one]
        return shlex.join([*words, "--out", out])


def _each(value: object) -> list[str]:
    """Return the words of an option that may be given several times."""
    if isinstance(value, Mapping):
        return [f"{name}={number!r}" for name, number in value.items()]
    return [str(v) for v in (value if isinstance(value, tuple) else (value,))]


def read_manifest(path: str | os.PathLike[str]) -> tuple[CampaignJob, ...]:
    """Return the campaigns of a manifest, in its order, found ones by machine and date.

    Raises:
        BadInput: anything wrong in the file, with file, place and hint; a pattern with
            ``{machine}`` or ``{date}`` that fits no file; two campaigns with one folder.
    """
    source, folder = str(path), Path(path).absolute().parent
    file = check(ManifestFile, read_yaml(Path(path)), source)
    out: dict[str, tuple[str, CampaignJob]] = {}
    for n, entry in enumerate(file.campaigns):
        place = f"{source}: campaigns[{n + 1}]"
        for one in _expanded(file, entry, folder, source, place):
            if one.name in out:
                raise BadInput(f"its results would go to {one.name}, as those of "
                               f"{out[one.name][0].partition(': ')[2]}", place,
                               "Give one of them a `name`")
            out[one.name] = place, one
    if not out:
        raise BadInput("no campaign is listed", f"{source}: campaigns",
                       f"Add one, such as `- {EXAMPLE}`")
    return tuple(campaign for _, campaign in out.values())


def _expanded(file: ManifestFile, entry: CampaignFile, folder: Path, source: str, place: str
              ) -> Iterator[CampaignJob]:
    """Yield the campaigns of one entry."""
    command = entry.command or file.command
    model = entry.model or file.model
    if model is None:
        raise BadInput("the key 'model' is missing", place,
                       "Add it here, or `model: machine.yaml` for all campaigns")
    given = getattr(file.options, command).model_dump(exclude_unset=True)
    if entry.options is not None:
        own = check(OPTIONS[command], entry.options, source,
                    prefix=f"{place.partition(': ')[2]}.options")
        given |= own.model_dump(exclude_unset=True)
    options = tuple((k, v) for k, v in given.items() if v is not None)
    for machine, date, data in _found(entry, folder, place):
        if command == "compensate" and len(data) != 1:
            raise BadInput(f"compensate takes one file of targets, this has {len(data)}",
                           f"{place}.data", "Name one CSV")
        yield CampaignJob(
            "/".join((machine, date.replace(":", ""), entry.name or command)), machine, date,
            entry.design or file.design or "", command, _filled(model, machine, date), data,
            options)


def _filled(text: str, machine: str, date: str) -> str:
    return text.replace("{machine}", machine).replace("{date}", date)


def _found(entry: CampaignFile, folder: Path, place: str
           ) -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield machine, date and data files of each campaign of an entry."""
    patterns = [_filled(p, entry.machine or "{machine}", entry.date or "{date}")
                for p in entry.data]
    for key, value in (("machine", entry.machine), ("date", entry.date)):
        if value is None and not all(f"{{{key}}}" in p for p in patterns):
            raise BadInput(f"the key '{key}' is missing", place,
                           f"Add it, or write {{{key}}} where the paths in `data` have it")
    if entry.machine is not None and entry.date is not None:
        yield entry.machine, entry.date, tuple(f for p in patterns for f in _files(p, folder))
        return
    groups: dict[tuple[str, str], list[str]] = {}
    for pattern in patterns:
        shape = _shape(pattern)
        for path in _matching(_filled(pattern, "*", "*"), folder):
            if match := shape.fullmatch(path):
                at = match.groupdict()
                key_ = (at.get("machine", entry.machine or ""), at.get("date", entry.date or ""))
                groups.setdefault(key_, []).append(path)
    if not groups:
        raise BadInput(f"no file fits {', '.join(patterns)}", f"{place}.data",
                       f"Check the pattern; looked in {folder}")
    for (machine, date), files in sorted(groups.items()):
        check(_Captured, {"machine": machine, "date": date}, files[0])
        yield machine, date, tuple(files)


class _Captured(Strict):
    """Machine and date as a path has them."""

    machine: Folder
    date: Date


def _files(pattern: str, folder: Path) -> list[str]:
    """Return the files of a pattern, sorted; what fits none stands for itself, and is missed."""
    return (_matching(pattern, folder) if glob.has_magic(pattern) else []) or [pattern]


def _matching(pattern: str, folder: Path) -> list[str]:
    found = sorted(glob.glob(pattern, root_dir=folder, recursive=True))
    return [p.replace(os.sep, "/") for p in found if (folder / p).is_file()]


def _shape(pattern: str) -> re.Pattern[str]:
    """Return what takes machine and date out of a path that fits a pattern."""
    seen, text = set[str](), ""
    for token in _TOKENS.split(pattern):
        name = token[1:-1]
        if token in ("{machine}", "{date}"):
            text += f"(?P={name})" if name in seen else f"(?P<{name}>[^/]+)"
            seen.add(name)
        elif token.startswith("[") and token.endswith("]"):
            text += token.replace("[!", "[^")
        else:
            text += _MEANING.get(token) or re.escape(token)
    return re.compile(text)
