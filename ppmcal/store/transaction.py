"""Files put into a folder, all or none: the whole folder in one step, or file by file by a journal.

On Linux the new folder is built beside the old one, with all that stays as hard links, and the two
change places by one system call, ``renameat2`` with ``RENAME_EXCHANGE``. Where that cannot be (see
:mod:`ppmcal.store.stage`; a folder in the folder, which cannot be linked; a file system without
it), files are moved one by one. They lie whole in ``new`` before the journal that names them
appears, by one rename. As long as it is there, each of them is either still in ``new`` or in its
place: moving on from anywhere ends with all of them in their places. Whoever gets the lock of a run
that was killed moves in what the journal names or, where there is none, throws the new files away.
"""

from __future__ import annotations

import contextlib
import ctypes
import json
import os
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput, cleaned_up, uninterrupted
from ppmcal.store.stage import (
    HIDDEN,
    INSIDE,
    JOURNAL,
    NEW,
    OLD,
    PART,
    Busy,
    Staging,
    hidden,
    locked,
    not_written,
    plain_name,
)

AT_FDCWD, EXCHANGE = -100, 2
MOST = 1000
"""Files of a folder that are worth linking."""
PATIENCE = 10.0
"""Seconds that a reader waits for files that are being moved."""
Fill = Callable[[Path], None]
"""Writes the new files into a folder."""


@contextlib.contextmanager
def staged(folder: Path, command: str, beside: str = "", inside: bool = False) -> Iterator[Staging]:
    """Lock the stage of a folder; finish or sweep first what a killed run left.

    Args:
        folder: that files will go to; need not be there.
        command: told to others that want the same folder.
        beside: name of a single file among others, whose stage is the file's own.
        inside: have it in the folder, wherever else it might be.

    Raises:
        Busy: another run is writing there.
        BadInput: nothing can be written there.
    """
    stage = None
    with cleaned_up():
        try:
            with uninterrupted():    # a lock that is half taken would be given back by nobody
                stage = _prepared(folder, command, beside, inside)
                _move_in_what_is_left(stage)
            yield stage
        finally:
            if stage is not None:
                with uninterrupted():
                    stage.release()


def _prepared(folder: Path, command: str, beside: str, inside: bool) -> Staging:
    """Return the locked stage of a folder."""
    target = Path(os.path.realpath(folder))
    try:
        place = target / (hidden(beside) if beside else INSIDE)
        if not (beside or inside):
            _finish(place, target)
            if _may_be_renamed(target):
                place = target.parent / hidden(target.name)
        return locked(place, target, command)
    except (OSError, ValueError) as error:
        raise not_written(folder, error) from None


def recover(folder: Path) -> None:
    """Move in what a killed run was moving into a folder, before something is read from it.

    Raises:
        BadInput: it cannot be done: files in the folder are old and new ones.
    """
    try:
        with os.scandir(folder) as entries:
            left = [Path(e.path) for e in entries
                    if e.name.startswith(HIDDEN) and e.name.endswith(PART)
                    and os.path.lexists(os.path.join(e.path, JOURNAL))]
    except (OSError, ValueError):
        return
    end = time.monotonic() + PATIENCE
    while left:
        try:
            with uninterrupted():
                _finish(left[-1], Path(os.path.realpath(folder)))
            left.pop()
        except Busy:
            if time.monotonic() > end:
                raise
            time.sleep(0.02)
        except OSError as error:
            raise BadInput("holds a result half old, half new: ppmcal was killed while it "
                           f"replaced it, and it cannot be finished ({error.strerror or error})",
                           str(folder), "Run ppmcal on it with permission to write there"
                           ) from None


def clean_up(folder: Path) -> None:
    """Finish or throw away what a killed run left for a folder, where nothing runs for it again."""
    target = Path(os.path.realpath(folder))
    for place in (target.parent / hidden(target.name), target / INSIDE):
        with contextlib.suppress(OSError, ValueError, BadInput), uninterrupted():
            _finish(place, target)


def _finish(place: Path, target: Path) -> None:
    """Do what is left to do in another stage whose run was killed; none: nothing.

    Raises:
        Busy: its run is alive.
        OSError: what it left cannot be moved.
    """
    if os.path.isdir(place):
        stage = locked(place, target, "")
        try:
            _move_in_what_is_left(stage)
        finally:
            stage.release()


def _move_in_what_is_left(stage: Staging) -> None:
    """Finish what a killed run began to move, or throw away what it prepared."""
    if stage.moving:
        move_in(stage.place, stage.target)
    stage.clear()


def _may_be_renamed(target: Path) -> bool:
    """Whether a new folder may come in the place of this one."""
    parent = target.parent
    if not os.path.isdir(target):
        return True
    if target == parent or os.path.ismount(target) or not os.access(parent, os.W_OK | os.X_OK):
        return False
    homes = (os.curdir, os.environ.get("PWD", os.curdir))
    return not any(os.path.isdir(h) and os.path.samefile(h, target) for h in homes)


# ---- all or none


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
        with os.scandir(target) as entries:
            held = list(entries)
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


# ---- the journal


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
    if not all(map(plain_name, (*files, *gone))) or any(
            (stage / name).is_symlink() for name in (NEW, OLD)):
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
