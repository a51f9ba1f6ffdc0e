"""Which files a run may replace: never its own inputs, nothing that it did not write itself.

A hidden file in every folder that a command wrote holds the names, the command and the SHA-256
of what was written; it may come from anywhere, with the folder: nothing in it is trusted. A folder
without it, or a file that is not as it says, is somebody else's, and so is a folder of another
command, where old and new results would pass for one. What the command itself wrote there before
and does not write again is stale: it goes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.store.inputs import Run, content_of, digest_of, identity_of, own_input, under_way
from ppmcal.store.stage import plain_name
from ppmcal.store.transaction import staged
from ppmcal.wording import abbreviate_list

RECORD = ".ppmcal.json"
CAMPAIGNS = "campaigns.parquet"
"""The table that only the folder of a batch has."""
FORM = "ppmcal/folder/1"
HINT = "Name another folder in --out, or replace with {}"


@dataclass(frozen=True)
class Written:
    """What the record says of one file: the command that wrote it, and the SHA-256."""

    command: str
    digest: str


@dataclass(frozen=True)
class FolderRecord:
    """What the record of a folder says.

    It may come from anywhere: what it says of other places than the folder is left out.

    Attributes:
        sound: whether there is one that says what was written.
        files: name -> what was written.
        commands: those that wrote into the folder.
        runs: command -> where its results come from, as far as that is recorded.
    """

    sound: bool = False
    files: Mapping[str, Written] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    runs: Mapping[str, dict[str, Any]] = field(default_factory=dict)

    def of(self, command: str) -> dict[str, str]:
        """Return name -> SHA-256 of what a command wrote."""
        return {n: w.digest for n, w in self.files.items() if w.command == command}


def read_record(folder: Path) -> FolderRecord:
    """Return what the record of a folder says, nothing where there is none of ours."""
    path = folder / RECORD
    try:
        content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError, RecursionError):
        content = {}
    if not isinstance(content, dict) or content.get("format") != FORM:
        return FolderRecord()
    noted, named = content.get("runs"), content.get("commands")
    runs = ({k: v for k, v in noted.items() if isinstance(v, dict)}
            if isinstance(noted, dict) else {})
    try:
        files = {name: Written(str(entry["command"]), str(entry["sha256"]))
                 for name, entry in content["files"].items() if plain_name(name)}
    except (TypeError, KeyError, AttributeError):
        return FolderRecord(runs=runs)
    commands = [*(map(str, named) if isinstance(named, list) else ()),
                *(w.command for w in files.values())]
    return FolderRecord(True, files, tuple(dict.fromkeys(commands)), runs)


@contextmanager
def running(command: str, folder: Path | None, force: bool = False, typed: str = "",
            option: str = "--force") -> Iterator[Run]:
    """Begin a run that will write into ``folder``: what is read from now on is its input.

    Nobody else writes there until it ends. Without ``folder`` it writes single files.

    Raises:
        BadInput: another run is writing there; nothing can be written there; or, without
            ``force``, the folder is somebody else's, or files that this command wrote there were
            edited since.
    """
    with staged(folder, command) if folder else nullcontext() as stage:
        run = Run(command, force, typed, stage=stage, option=option)
        if folder:
            for name in check_folder(folder, run).of(command):
                if identity := identity_of(folder / name):
                    run.to_be_overwritten[identity] = str(folder / name)
        with under_way(run):
            yield run


def check_folder(folder: Path, run: Run) -> FolderRecord:
    """Return the record of a folder that is this command's to write into.

    Raises:
        BadInput: it is not empty and ppmcal did not write it, or what this command wrote there
            was edited since; ``force`` allows both. Or it cannot be read.
    """
    record = read_record(folder)
    if run.force or not os.path.isdir(folder):
        return record
    try:
        held = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", str(folder),
                       "Check permissions, or name another folder in --out") from None
    if held and not record.sound:
        raise BadInput(f"holds files that ppmcal did not write, or an older version of it "
                       f"({abbreviate_list(held)})", str(folder), HINT.format(run.option))
    if held and record.commands and run.command not in record.commands:
        raise BadInput(f"holds results of another command, {', '.join(record.commands)} "
                       f"({abbreviate_list(held)})", str(folder), HINT.format(run.option))
    edited = [n for n, digest in record.of(run.command).items()
              if os.path.lexists(folder / n) and digest_of(folder / n) != digest]
    if edited:
        raise BadInput(f"{abbreviate_list(edited)} {'were' if len(edited) > 1 else 'was'} "
                       "edited since ppmcal wrote it", str(folder), HINT.format(run.option))
    return record


def check_files(folder: Path, names: Iterable[str], run: Run) -> None:
    """Refuse to replace inputs of the run, and what this command did not write.

    Raises:
        BadInput: a file of that name is an input; or, without ``force``, somebody else's.
    """
    there = refuse_inputs(folder, names, run)
    known = check_folder(folder, run).files
    for name in () if run.force else there:
        written = known.get(name)
        if written is None:
            raise BadInput("was there before, and ppmcal did not write it", str(folder / name),
                           HINT.format(run.option))
        if written.command != run.command:
            raise BadInput(f"was written by another command, {written.command}",
                           str(folder / name), HINT.format(run.option))


def refuse_inputs(folder: Path, names: Iterable[str], run: Run) -> list[str]:
    """Return those of the names that are there.

    Raises:
        BadInput: one is an input of the run.
    """
    there = [name for name in names if os.path.lexists(folder / name)]
    for name in there:
        if identity_of(folder / name) in run.read:
            raise own_input(str(folder / name))
    return there


def stale_files(folder: Path, names: Iterable[str], run: Run) -> list[str]:
    """Return what an earlier run of the command wrote and this one, with ``names``, does not.

    What was edited since, or is an input, stays.
    """
    written = set(names)
    if not (run.command and written):
        return []
    return [n for n, digest in read_record(folder).of(run.command).items()
            if n not in written and os.path.lexists(folder / n) and digest_of(folder / n) == digest
            and identity_of(folder / n) not in run.read]


def record_text(folder: Path, digests: Mapping[str, str], run: Run, gone: Iterable[str] = ()
                ) -> str:
    """Return the text of the record of a folder when files of these SHA-256 are written to it.

    Args:
        folder: with the record that it has now.
        digests: name -> SHA-256.
        run: that writes them.
        gone: names of files that are taken away.
    """
    away, record = set(gone), read_record(folder)
    known = {name: w for name, w in record.files.items()
             if os.path.lexists(folder / name) and name not in away}
    known |= {name: Written(run.command, digest) for name, digest in digests.items()}
    owners = dict.fromkeys([*record.commands, run.command])
    runs = {name: source for name, source in record.runs.items() if name in owners}
    if run.source:
        runs[run.command] = {**run.source, "inputs": _all_inputs(run),
                             "from": _working_folder(folder),
                             "name": os.path.basename(os.path.abspath(folder))}
    return json.dumps({"format": FORM, "commands": list(owners), "files": {
        name: {"command": w.command, "sha256": w.digest} for name, w in sorted(known.items())},
        "runs": runs}, indent=1) + "\n"


def _all_inputs(run: Run) -> dict[str, str]:
    """Return path -> SHA-256 of a run's inputs, with what it read while it made its files."""
    known = dict(run.source.get("inputs", {}))
    return known | {p: content_of(p, run) for p in sorted({*run.read.values()} - {*known})}


def _working_folder(folder: Path) -> str:
    """Return the way from a folder of results to the folder that the run's paths begin in."""
    try:
        return os.path.relpath(os.getcwd(), folder)
    except (OSError, ValueError):    # gone, or on another drive
        return ""
