"""The bytes of an input: of a file, no pipe, device or folder, and no more than a limit."""

from __future__ import annotations

import difflib
import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ppmcal.errors import BadInput
from ppmcal.io.folder import note_content, track_input
from ppmcal.io.limits import TABLE_BYTES, Limit

_KINDS = ((stat.S_ISDIR, "is a folder"), (stat.S_ISFIFO, "is a pipe"),
          (stat.S_ISCHR, "is a device"), (stat.S_ISBLK, "is a device"),
          (stat.S_ISSOCK, "is a socket"))
_FLAGS = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0)
"""A pipe without a writer must not be waited for."""


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
        BadInput: it does not exist, is not a file, cannot be read, is larger than ``limit``,
            changed while it was read, or would be replaced.
    """
    track_input(path)
    try:
        handle = os.open(path, _FLAGS)
        with os.fdopen(handle, "rb") as stream:
            before = os.fstat(handle)
            refuse_no_file(before, path)
            limit.refuse(before.st_size, str(path))
            data = stream.read(limit.most + 1)
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
    limit.refuse(len(data), str(path))
    if (before.st_size, before.st_mtime_ns) != (after.st_size, after.st_mtime_ns):
        raise BadInput("changed while it was read", str(path),
                       "Wait until it is written, or copy it first")
    note_content(path, data)
    return data


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
