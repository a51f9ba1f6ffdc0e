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
from pathlib import Path
from typing import Any

from ppmcal.commands.batch.schema import (
    EXAMPLE,
    OPTIONS,
    CampaignFile,
    Date,
    Folder,
    ManifestFile,
    options_of,
)
from ppmcal.commands.spec import flags
from ppmcal.errors import BadInput
from ppmcal.io.schema import Strict, check
from ppmcal.io.yaml import read_yaml

_TOKENS = re.compile(r"(\{machine\}|\{date\}|\*\*/|\*|\?|\[[^\]]+\])")
_MEANING = {"**/": "(?:.*/)?", "*": "[^/]*", "?": "[^/]"}


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
