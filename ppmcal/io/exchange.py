"""Files put into a folder: the whole folder in one step, or its files by a journal.

On Linux the new folder is built beside the old one, with all that stays as hard links, and the two
change places by one system call, ``renameat2`` with ``RENAME_EXCHANGE``. Where that cannot be (see
:mod:`ppmcal.io.stage`; a folder in the folder, which cannot be linked; a file system without it),
files are moved one by one by :mod:`ppmcal.io.journal`.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ppmcal.io.journal import move_back, move_in, sync, write_journal
from ppmcal.io.stage import Staging, staged

AT_FDCWD, EXCHANGE = -100, 2
MOST = 1000
"""Files of a folder that are worth linking."""
Fill = Callable[[Path], None]
"""Writes the new files into a folder."""


def install(stage: Staging, fill: Fill, files: Sequence[str], gone: Sequence[str], command: str
            ) -> None:
    """Put files into the folder of a stage, all or none.

    Args:
        stage: of the folder.
        fill: writes the new files.
        files: their names.
        gone: names of files in the folder that are taken away.
        command: for the lock, where another stage is needed.

    Raises:
        OSError: it cannot be done; nothing has changed.
    """
    if not stage.inside:
        if _as_a_whole(stage, fill, {*files, *gone}):
            return
        with staged(stage.target, command, inside=True) as inner:
            install(inner, fill, files, gone, command)
        return
    stage.clear()
    stage.new.mkdir()
    fill(stage.new)
    try:
        write_journal(stage.place, files, gone)
        move_in(stage.place, stage.target)
    except BaseException:
        if stage.moving:
            move_back(stage.place, stage.target)
        raise


def _as_a_whole(stage: Staging, fill: Fill, replaced: set[str]) -> bool:
    """Put a new folder in the place of the old one; False where that cannot be."""
    stage.clear()
    target, new = stage.target, stage.new
    new.mkdir()
    if not target.is_dir():
        fill(new)
        sync(new)
        new.rename(target)
        with contextlib.suppress(OSError):
            sync(target.parent)
        return True
    held = _carried_over(target, new, replaced)
    if held is None:
        return False
    fill(new)
    sync(new)
    if not _exchanged(new, target):
        return False
    # it is done: what fails from here on changes nothing
    with contextlib.suppress(OSError):
        sync(target.parent)
        _bring_over(new, target, {*os.listdir(new)} - replaced, held)
    return True


def _bring_over(old: Path, target: Path, names: Iterable[str], held: Mapping[str, bool]) -> None:
    """Move over what came into the old folder, or was saved anew in it, since it was looked at."""
    for name in names:
        stays = held.get(name)
        with contextlib.suppress(OSError):
            if (not os.path.lexists(target / name) if stays is None else
                    stays and not _same(os.fspath(old / name), target / name)):
                (old / name).replace(target / name)


def _carried_over(target: Path, new: Path, replaced: Iterable[str]) -> dict[str, bool] | None:
    """Link what stays in a folder into the new one; return of each name whether it stays.

    None where it cannot be.
    """
    away = {name.casefold() for name in replaced}
    found = dict[str, bool]()
    try:
        _like(target, new)
        held = _entries(target)
        if len(held) > MOST or any(e.is_dir(follow_symlinks=False) for e in held):
            return None
        for entry in held:
            found[entry.name] = not (entry.name.casefold() in away and any(
                _same(entry.path, target / name) for name in replaced
                if name.casefold() == entry.name.casefold()))
            if found[entry.name]:
                os.link(entry.path, new / entry.name, follow_symlinks=False)
    except (OSError, NotImplementedError):
        return None
    return found


def _entries(folder: Path) -> list[os.DirEntry[str]]:
    with os.scandir(folder) as entries:
        return list(entries)


def _same(path: str, other: Path) -> bool:
    """Whether two names are one entry, as where case makes no difference."""
    return os.path.lexists(other) and os.path.samestat(os.lstat(path), os.lstat(other))


def _like(old: Path, new: Path) -> None:
    """Give a folder the owner and the permissions of another (OSError where it cannot be)."""
    was, now = old.stat(), new.stat()
    if (was.st_uid, was.st_gid) != (now.st_uid, now.st_gid):
        shutil.chown(new, was.st_uid, was.st_gid)
    shutil.copystat(old, new)
    os.utime(new)


def _exchanged(one: Path, other: Path) -> bool:
    """Let two folders change places; False where there is no such thing."""
    call = _renameat2()
    return call is not None and call(
        AT_FDCWD, os.fsencode(one), AT_FDCWD, os.fsencode(other), EXCHANGE) == 0


@cache
def _renameat2() -> Any:
    """Return the system call, None where there is none."""
    try:
        return getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    except (OSError, TypeError):    # not on Windows
        return None
