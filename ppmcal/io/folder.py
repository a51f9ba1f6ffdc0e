"""Which files a run may replace: never its own inputs, nothing that it did not write itself.

A hidden file in every folder that a command wrote holds the names, the command and the SHA-256
of what was written; it may come from anywhere, with the folder: nothing in it is trusted. A folder
without it, or a file that is not as it says, is somebody else's, and so is a folder of another
command, where old and new results would pass for one. What the command itself wrote there before
and does not write again is stale: it goes.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.io.stage import Staging, recover, staged

RECORD = ".ppmcal.json"
FORM = "ppmcal/folder/1"
HINT = "Name another folder in --out, or replace with {}"
SHOWN = 3
Identity = tuple[int, int]


@dataclass(frozen=True)
class Written:
    """What the record says of one file: the command that wrote it, and the SHA-256."""

    command: str
    digest: str


def read_runs(folder: Path) -> dict[str, dict[str, Any]]:
    """Return command -> where its results in a folder come from, as far as that is recorded."""
    runs = _content(folder).get("runs")
    return ({str(k): v for k, v in runs.items() if isinstance(v, dict)}
            if isinstance(runs, dict) else {})


def read_record(folder: Path) -> dict[str, Written] | None:
    """Return what ppmcal wrote into a folder, None where there is no sound record.

    A record may come from anywhere: what it says of other places than the folder is left out.
    """
    try:
        return {name: Written(str(entry["command"]), str(entry["sha256"]))
                for name, entry in _content(folder)["files"].items()
                if name not in ("", ".", "..") and Path(name).name == name}
    except (TypeError, KeyError, AttributeError):
        return None


def owners_of(folder: Path) -> list[str]:
    """Return the commands that wrote into a folder, none where there is no sound record."""
    files, named = read_record(folder), _content(folder).get("commands")
    if files is None:
        return []
    return list(dict.fromkeys([*(map(str, named) if isinstance(named, list) else ()),
                               *(w.command for w in files.values())]))


def _content(folder: Path) -> dict[str, Any]:
    """Return what the record of a folder holds, nothing where it is not there or none of ours."""
    path = folder / RECORD
    try:
        content = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    except (OSError, ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) and content.get("format") == FORM else {}


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a plain file, empty where there is none: a pipe would never end."""
    try:
        if not path.is_file():
            return ""
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    except (OSError, ValueError):
        return ""


@dataclass(frozen=True)
class Run:
    """One run of a command: what it has read, by device and inode, and what it may replace.

    Attributes:
        command: its name.
        force: whether it may replace what it did not write.
        read: device and inode -> path of every file read so far.
        sums: path -> SHA-256 of what was read of it.
        to_be_overwritten: device and inode -> path of the files that it wrote into ``--out``
            before, and will write again.
        typed: the command line that does the same  [default: that of the process].
        stage: where its files are prepared, which keeps other runs out of ``--out``.
        source: provenance of what it writes, as far as that is known.
        option: what a message names to replace what it did not write.
    """

    command: str = ""
    force: bool = False
    typed: str = ""
    read: dict[Identity, str] = field(default_factory=dict)
    sums: dict[str, str] = field(default_factory=dict)
    to_be_overwritten: dict[Identity, str] = field(default_factory=dict)
    stage: Staging | None = None
    source: dict[str, Any] = field(default_factory=dict)
    option: str = "--force"


_RUN: ContextVar[Run | None] = ContextVar("run", default=None)


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
            check_folder(folder, run)
            for name, written in (read_record(folder) or {}).items():
                if written.command == command and (identity := _identity(folder / name)):
                    run.to_be_overwritten[identity] = str(folder / name)
        token = _RUN.set(run)
        try:
            yield run
        finally:
            _RUN.reset(token)


@contextmanager
def reading() -> Iterator[Run]:
    """Note what is read in the block, where no run is under way that does."""
    run = _RUN.get()
    if run is not None:
        yield run
        return
    token = _RUN.set(run := Run())
    try:
        yield run
    finally:
        _RUN.reset(token)


@contextmanager
def untracked() -> Iterator[None]:
    """Read in the block what is not an input of the current run, such as its own notes."""
    token = _RUN.set(None)
    try:
        yield
    finally:
        _RUN.reset(token)


def current() -> Run:
    """Return the run that is under way, or one without a name outside of any."""
    return _RUN.get() or Run()


def track_input(path: str | os.PathLike[str]) -> None:
    """Remember a file that will be read as an input of the run that is under way, if there is one.

    What a killed run was moving into its folder is moved in first.

    Raises:
        BadInput: the run would replace it, or it is one of files that are half old, half new.
    """
    recover(Path(path).parent)
    run, identity = _RUN.get(), _identity(Path(path))
    if run is None or identity is None:
        return
    run.read[identity] = str(path)
    if identity in run.to_be_overwritten:
        raise _own_input(run.to_be_overwritten[identity])


def note_content(path: str | os.PathLike[str], data: bytes) -> None:
    """Remember what an input of the run that is under way held when it was read.

    Results name that, whatever becomes of the file while they are made.

    Raises:
        BadInput: it was read before in this run, and held something else.
    """
    run = _RUN.get()
    if run is None:
        return
    digest = hashlib.sha256(data).hexdigest()
    if run.sums.setdefault(str(path), digest) != digest:
        raise BadInput("changed while ppmcal was at work on it", str(path),
                       "Wait until it is written, and run it again")


def content_of(path: str | os.PathLike[str], run: Run) -> str:
    """Return the SHA-256 of what a run has read of a file, else of what it holds now."""
    return run.sums.get(str(Path(path))) or digest_of(Path(path))


def check_folder(folder: Path, run: Run) -> None:
    """Refuse a folder that is not this command's to write into.

    Raises:
        BadInput: it is not empty and ppmcal did not write it, or what this command wrote there
            was edited since; ``force`` allows both. Or it cannot be read.
    """
    if run.force or not os.path.isdir(folder):
        return
    try:
        held = sorted(p.name for p in folder.iterdir() if not p.name.startswith("."))
    except OSError as error:
        raise BadInput(f"cannot be read ({error.strerror})", str(folder),
                       "Check permissions, or name another folder in --out") from None
    known, owners = read_record(folder), owners_of(folder)
    if known is None and held:
        raise BadInput(f"holds files that ppmcal did not write, or an older version of it "
                       f"({_some(held)})", str(folder), HINT.format(run.option))
    if held and owners and run.command not in owners:
        raise BadInput(f"holds results of another command, {', '.join(owners)} ({_some(held)})",
                       str(folder), HINT.format(run.option))
    edited = [n for n, w in (known or {}).items() if w.command == run.command
              and _is_there(folder / n) and digest_of(folder / n) != w.digest]
    if edited:
        raise BadInput(f"{_some(edited)} {'were' if len(edited) > 1 else 'was'} edited since "
                       "ppmcal wrote it", str(folder), HINT.format(run.option))


def check_files(folder: Path, names: Iterable[str], run: Run) -> None:
    """Refuse to replace inputs of the run, and what this command did not write.

    Raises:
        BadInput: a file of that name is an input; or, without ``force``, somebody else's.
    """
    there = refuse_inputs(folder, names, run)
    check_folder(folder, run)
    known = {} if run.force else read_record(folder) or {}
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
    there = [name for name in names if _is_there(folder / name)]
    for name in there:
        if _identity(folder / name) in run.read:
            raise _own_input(str(folder / name))
    return there


def stale_files(folder: Path, names: Iterable[str], run: Run) -> list[str]:
    """Return what an earlier run of the command wrote and this one, with ``names``, does not.

    What was edited since, or is an input, stays.
    """
    written = set(names)
    if not (run.command and written):
        return []
    return [n for n, w in (read_record(folder) or {}).items()
            if w.command == run.command and n not in written and _is_there(folder / n)
            and digest_of(folder / n) == w.digest and _identity(folder / n) not in run.read]


def record_text(folder: Path, digests: Mapping[str, str], run: Run, gone: Iterable[str] = ()
                ) -> str:
    """Return the text of the record of a folder when files of these SHA-256 are written to it.

    Args:
        folder: with the record that it has now.
        digests: name -> SHA-256.
        run: that writes them.
        gone: names of files that are taken away.
    """
    away = set(gone)
    known = {name: w for name, w in (read_record(folder) or {}).items()
             if _is_there(folder / name) and name not in away}
    known |= {name: Written(run.command, digest) for name, digest in digests.items()}
    owners = dict.fromkeys([*owners_of(folder), run.command])
    runs = {name: source for name, source in read_runs(folder).items() if name in owners}
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


def _own_input(path: str) -> BadInput:
    return BadInput("is an input of this run, and its results would replace it", path,
                    "Name another folder in --out")


def _some(names: list[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _is_there(path: Path) -> bool:
    return os.path.lexists(path)


def _identity(path: Path) -> Identity | None:
    """Return device and inode of a file, links followed; None where there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino
