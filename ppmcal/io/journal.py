"""Files moved into a folder one by one, so that a kill in between can be made good.

The new files lie whole in ``new`` before the journal that names them appears, by one rename. As
long as it is there, each of them is either still in ``new`` or in its place: moving on from
anywhere ends with all of them in their places.
"""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path

from ppmcal.errors import BadInput

JOURNAL, NEW, OLD = "journal.json", "new", "old"
"""Names in the stage: what is to be moved, where the new files are, and those they replace."""


def write_journal(stage: Path, files: Sequence[str], gone: Sequence[str]) -> None:
    """Say which files go in and which go away: from now on that happens, killed or not.

    Args:
        stage: folder with the files in ``new``, which are on the disk.
        files: their names.
        gone: names of files that are taken away.
    """
    part = stage / f"{JOURNAL}.part"
    with part.open("w", encoding="utf-8", errors="surrogateescape") as stream:
        json.dump({"files": list(files), "gone": list(gone)}, stream)
        stream.flush()
        os.fsync(stream.fileno())
    sync(stage / NEW)
    (stage / OLD).mkdir(exist_ok=True)
    part.replace(stage / JOURNAL)
    sync(stage)


def move_in(stage: Path, target: Path) -> None:
    """Do what the journal says; what was done of it before is not done again.

    Raises:
        OSError: something could not be moved; the journal is still there.
        BadInput: it is not a journal of ppmcal.
    """
    files, gone = read_journal(stage)
    for name in files:
        if os.path.lexists(stage / NEW / name):
            _keep(target / name, stage / OLD / name)
            (stage / NEW / name).replace(target / name)
    for name in gone:
        if os.path.lexists(target / name):
            (target / name).replace(stage / OLD / name)
    sync(target)
    (stage / JOURNAL).unlink()


def move_back(stage: Path, target: Path) -> None:
    """Undo what :func:`move_in` has done so far; stopped in between, either can be done again.

    Raises:
        OSError: something could not be moved; the journal is still there.
    """
    files, gone = read_journal(stage)
    for name in (*gone, *files):
        if name in files and not os.path.lexists(stage / NEW / name):
            (target / name).replace(stage / NEW / name)
        if os.path.lexists(stage / OLD / name):
            (stage / OLD / name).replace(target / name)
    (stage / JOURNAL).unlink()


def read_journal(stage: Path) -> tuple[list[str], list[str]]:
    """Return names of files to come and to go.

    Raises:
        BadInput: it names, or would lead to, other places than the folder's own.
    """
    path = stage / JOURNAL
    try:
        content = json.loads(path.read_text(encoding="utf-8", errors="surrogateescape"))
        files, gone = ([str(name) for name in content[key]] for key in ("files", "gone"))
    except (ValueError, KeyError, TypeError, RecursionError):
        raise _no_journal(path) from None
    plain = all(os.path.basename(n) == n and n not in ("", ".", "..") for n in (*files, *gone))
    if not plain or (stage / NEW).is_symlink() or (stage / OLD).is_symlink():
        raise _no_journal(path)
    return files, gone


def sync(folder: Path) -> None:
    """Have the names in a folder on the disk before anything that comes later."""
    if os.name != "posix":
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _keep(path: Path, old: Path) -> None:
    """Keep a file under a second name, so that its place is never empty."""
    if not os.path.lexists(path) or os.path.lexists(old):
        return
    try:
        os.link(path, old, follow_symlinks=False)
    except (OSError, NotImplementedError):    # no links here
        path.replace(old)


def _no_journal(path: Path) -> BadInput:
    return BadInput("is not a journal of ppmcal", str(path), f"Delete {path.parent}")
