"""The inputs of a run: what it reads, what that held, and how a file's bytes are read.

An input is a file, no pipe, device or folder, and no larger than a limit. Whatever reads one says
so here first: results name its SHA-256, and nothing that a run has read is replaced by it.
"""

from __future__ import annotations

import difflib
import errno
import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.limits import TABLE_BYTES, Limit
from ppmcal.store.stage import Staging
from ppmcal.store.transaction import recover

Identity = tuple[int, int]
_KINDS = ((stat.S_ISDIR, "is a folder"), (stat.S_ISFIFO, "is a pipe"),
          (stat.S_ISCHR, "is a device"), (stat.S_ISBLK, "is a device"),
          (stat.S_ISSOCK, "is a socket"))
_FLAGS = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
"""A pipe without a writer must not be waited for."""


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
def under_way(run: Run | None) -> Iterator[None]:
    """Make a run the one whose inputs are tracked in the block; None: read in it what is none.

    Such as what a command has noted for itself.
    """
    token = _RUN.set(run)
    try:
        yield
    finally:
        _RUN.reset(token)


@contextmanager
def reading() -> Iterator[Run]:
    """Note what is read in the block, where no run is under way that does."""
    run = _RUN.get()
    if run is not None:
        yield run
        return
    with under_way(run := Run()):
        yield run


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
    run, identity = _RUN.get(), identity_of(Path(path))
    if run is None or identity is None:
        return
    run.read[identity] = str(path)
    if identity in run.to_be_overwritten:
        raise own_input(run.to_be_overwritten[identity])


def note_content(path: str | os.PathLike[str], digest: str) -> None:
    """Remember the SHA-256 of an input of the run that is under way, as it was read.

    Results name that, whatever becomes of the file while they are made.

    Raises:
        BadInput: it was read before in this run, and held something else.
    """
    run = _RUN.get()
    if run is not None and run.sums.setdefault(str(path), digest) != digest:
        raise BadInput("changed while ppmcal was at work on it", str(path),
                       "Wait until it is written, and run it again")


def content_of(path: str | os.PathLike[str], run: Run) -> str:
    """Return the SHA-256 of what a run has read of a file, else of what it holds now."""
    return run.sums.get(str(Path(path))) or digest_of(Path(path))


def own_input(path: str, hint: str = "Name another folder in --out") -> BadInput:
    """Return the refusal of a file that a run has read and would replace."""
    return BadInput("is an input of this run, and its results would replace it", path, hint)


def identity_of(path: Path) -> Identity | None:
    """Return device and inode of a file, links followed; None where there is none."""
    try:
        status = path.stat()
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


@contextmanager
def path_errors() -> Iterator[None]:
    """Refuse a path that is longer than the system takes, wherever it is first looked at.

    Raises:
        BadInput: with its beginning.
    """
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENAMETOOLONG:
            raise
        path = os.fsdecode(error.filename or "")
        raise BadInput(f"a path of {len(path)} characters is too long", f"{path[:40]}...",
                       "Give the path of a file or a folder") from None


def read_bytes(path: Path, limit: Limit = TABLE_BYTES) -> bytes:
    """Return a file's bytes, and note it as an input of the run.

    Raises:
        BadInput: as :func:`read_pieces`.
    """
    return b"".join(read_pieces(path, limit.most + 1, limit))


def read_pieces(path: Path, size: int, limit: Limit = TABLE_BYTES) -> Iterator[bytes]:
    """Yield a file's bytes, ``size`` at a time, and note it as an input of the run at the end.

    Raises:
        BadInput: it does not exist, is not a file, cannot be read, is larger than ``limit``,
            changed while it was read, or would be replaced.
    """
    track_input(path)
    digest, count = hashlib.sha256() if _RUN.get() else None, 0
    try:
        handle = os.open(path, _FLAGS)
        with os.fdopen(handle, "rb") as stream:
            before = os.fstat(handle)
            refuse_no_file(before, path)
            limit.refuse(before.st_size, str(path))
            while count <= limit.most and (piece := stream.read(min(size, limit.most + 1 - count))):
                count += len(piece)
                if digest:
                    digest.update(piece)
                yield piece
            after = os.fstat(handle)
    except FileNotFoundError:
        near = _near(path)
        hint = f" Did you mean '{near}'?" if near else ""
        raise BadInput("there is no such file", str(path),
                       f"Check the name; looked in {path.parent.absolute()}.{hint}") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise BadInput(f"cannot be read ({reason})", str(path),
                       "Give the path of a readable file") from None
    limit.refuse(count, str(path))
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise BadInput("changed while it was read", str(path),
                       "Wait until it is written, or copy it first")
    if digest:
        note_content(path, digest.hexdigest())


def first_bytes(path: Path, count: int) -> bytes:
    """Return how a file begins, nothing where it cannot be read."""
    try:
        handle = os.open(path, _FLAGS)
        with os.fdopen(handle, "rb") as stream:
            return stream.read(count) if stat.S_ISREG(os.fstat(handle).st_mode) else b""
    except (OSError, ValueError):
        return b""


def refuse_no_file(found: os.stat_result, path: Path) -> None:
    """Refuse what is not a file: a pipe may end nowhere, and can be read once only.

    Raises:
        BadInput: with what it is.
    """
    for is_kind, what in _KINDS:
        if is_kind(found.st_mode):
            raise BadInput(f"{what}, not a file", str(path),
                           "Give the path of a file; save there first what comes from elsewhere")


def _near(path: Path) -> str:
    """Return the name of the file nearest to one that is not there."""
    try:
        names = [p.name for p in path.parent.iterdir()]
    except OSError:
        return ""
    found = difflib.get_close_matches(path.name, names, n=1)
    return found[0] if found else ""
