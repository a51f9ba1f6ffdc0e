"""The hidden folder in which a run prepares its files, and its lock.

For results in ``DIR`` it is ``.ppmcal.DIR.part`` beside it. It is ``DIR/.ppmcal.part`` where
nothing can or should be renamed beside: a mount point, the working folder (whose shell would be
left in the old one), a folder whose parent cannot be written. In it are ``lock``, held by flock,
which the kernel lets go of when the process ends, with who holds it; ``new`` and ``old``; and the
journal of :mod:`ppmcal.store.transaction`.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import platform
import shutil
import time
import weakref
from dataclasses import dataclass, field
from pathlib import Path

from ppmcal.errors import BadInput

try:
    import fcntl
except ImportError:    # no POSIX system: runs are not kept apart
    fcntl = None    # type: ignore[assignment]

HIDDEN, PART = ".ppmcal.", ".part"
INSIDE = ".ppmcal.part"
LOCK = "lock"
JOURNAL, NEW, OLD = "journal.json", "new", "old"
"""Names in the stage: what is to be moved, where the new files are, and those they replace."""
LONGEST = 200
"""Bytes of a folder's name that its stage's may have in it."""
TRIES = 100
"""Times that a stage may be taken away by a run that is done while it is being locked."""
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL)


class Busy(BadInput):
    """Another run is writing into the folder."""


@dataclass(eq=False)
class Staging:
    """A hidden folder that this process has locked.

    Attributes:
        place: its path.
        target: the folder that files go to, links followed.
        lock: descriptor of its lock.
        made: folders above it that were not there before.
    """

    place: Path
    target: Path
    lock: int = -1
    made: list[Path] = field(default_factory=list)

    @property
    def inside(self) -> bool:
        """Whether it is in the folder that it is for, from where files are moved one by one."""
        return self.place.parent == self.target

    @property
    def new(self) -> Path:
        """Folder of the files to come."""
        return self.place / NEW

    @property
    def moving(self) -> bool:
        """Whether files are on their way into the folder."""
        return os.path.lexists(self.place / JOURNAL)

    def clear(self) -> None:
        """Throw away everything but the lock, and a journal that is still to be done."""
        if not self.moving:
            for folder in (self.place / NEW, self.place / OLD):
                shutil.rmtree(folder, ignore_errors=True)
            with contextlib.suppress(OSError):
                (self.place / f"{JOURNAL}.part").unlink(missing_ok=True)

    def release(self) -> None:
        """Take it away, with the folders that were made for it and hold nothing."""
        _HELD.discard(self)
        self.clear()
        if fcntl is None:    # nothing that is open can be taken away there
            os.close(self.lock)
        if not self.moving:
            with contextlib.suppress(OSError):
                (self.place / LOCK).unlink()
        if fcntl is not None:
            os.close(self.lock)
        # last: file systems far away keep what is taken away until it is closed
        _remove([*self.made, self.place])


_HELD: weakref.WeakSet[Staging] = weakref.WeakSet()


def _let_go_in_a_fork() -> None:
    """Close locks in a child that was forked, which would hold them longer than its parent."""
    for stage in list(_HELD):
        with contextlib.suppress(OSError):
            os.close(stage.lock)


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go_in_a_fork)


def plain_name(name: str) -> bool:
    """Whether a name leads nowhere but into the folder that it is of."""
    return name not in ("", ".", "..") and Path(name).name == name


def hidden(name: str) -> str:
    """Return how the stage of a file or folder is called."""
    raw = os.fsencode(name)
    if len(raw) > LONGEST:
        name = hashlib.sha256(raw).hexdigest()
    return f"{HIDDEN}{name}{PART}"


def not_written(folder: str | os.PathLike[str], error: OSError | ValueError) -> BadInput:
    """Return the refusal of a folder that cannot be written."""
    reason = getattr(error, "strerror", None) or error
    return BadInput(f"cannot be written ({reason})", os.fspath(folder),
                    "Check permissions and space, or name another folder in --out")


def locked(place: Path, target: Path, command: str) -> Staging:
    """Make a stage and lock it.

    Raises:
        Busy: another run has it.
        OSError: it cannot be made.
    """
    made: list[Path] = []
    for _ in range(TRIES):
        try:
            lock = _opened(place, made)
        except FileNotFoundError:
            continue    # taken away this moment
        except OSError:
            _remove([*made, place])
            raise
        if not _got(lock):
            told = _holder(place / LOCK)
            os.close(lock)
            raise Busy(f"another run is writing there{told}", str(target),
                       "Wait until it is done, or name another folder in --out")
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(lock), os.stat(place / LOCK)):
                stage = Staging(place, target, lock, made)
                _HELD.add(stage)
                _sign(stage, command)
                return stage
        os.close(lock)
    _remove(made)
    raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT))


def _opened(place: Path, made: list[Path]) -> int:
    """Return the lock's descriptor; add to ``made`` the folders that this took."""
    for folder in reversed([p for p in place.parents if not p.exists()]):
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            made.append(folder)
    with contextlib.suppress(FileExistsError):
        place.mkdir()
    if place.is_symlink():    # never to where somebody else points
        raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
    return os.open(place / LOCK, os.O_RDWR | os.O_CREAT, 0o666)


def _sign(stage: Staging, command: str) -> None:
    """Write into the lock who holds it."""
    try:
        os.ftruncate(stage.lock, 0)
        os.write(stage.lock, json.dumps({
            "command": command, "process": os.getpid(), "host": platform.node(),
            "since": time.strftime("%Y-%m-%d %H:%M:%S")}).encode())
    except OSError:
        stage.release()
        raise


def _holder(lock: Path) -> str:
    """Return who holds a lock, as the end of a sentence."""
    try:
        held = json.loads(lock.read_text(encoding="utf-8"))
        where = "" if held["host"] == platform.node() else f" on {held['host']}"
        name = f"ppmcal {held['command']}, " if held["command"] else ""
        return f": {name}process {held['process']}{where}, since {held['since']}"
    except (OSError, ValueError, TypeError, KeyError):
        return ""


def _got(lock: int) -> bool:
    """Whether the lock is ours now; where a file system has no locks, it always is."""
    if fcntl is None:
        return True
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        return error.errno in _NO_LOCKS
    return True


def _remove(folders: list[Path]) -> None:
    """Take away those that hold nothing, the last first."""
    for folder in reversed(folders):
        with contextlib.suppress(OSError):
            folder.rmdir()
