"""Files of a result: they appear together in a folder, whole or not at all."""

from __future__ import annotations

import hashlib
import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Literal, Self

from ppmcal.errors import BadInput
from ppmcal.store.folder import RECORD, check_files, record_text, refuse_inputs, stale_files
from ppmcal.store.inputs import Run, current
from ppmcal.store.stage import Staging, not_written, plain_name
from ppmcal.store.transaction import install, staged, sync
from ppmcal.wording.progress import note


@dataclass(frozen=True, eq=False)
class LongText:
    """A text that is made while it is written; ``parts`` makes it, piece by piece."""

    parts: Callable[[], Iterator[str]]

    def __str__(self) -> str:
        """Return it whole."""
        return "".join(self.parts())


Content = str | bytes | LongText
"""What a file holds."""


def encoded(content: Content) -> Iterator[bytes]:
    r"""Yield a file's bytes; what UTF-8 cannot hold becomes ``\udcff``."""
    if isinstance(content, bytes):
        yield content
        return
    for part in content.parts() if isinstance(content, LongText) else (content,):
        yield part.encode("utf-8", "backslashreplace")


class Output:
    """Several files that appear together in a folder, or not at all.

    They replace neither inputs of the run under way nor, unless it is forced to, what its
    command did not write: see :mod:`ppmcal.store.folder`. How they come into the folder:
    :mod:`ppmcal.store.transaction`.

    Use it as ``with Output("out") as out: out.add("a.csv", text)``: the files are written when
    the block ends without an error. Or call :meth:`write`.
    """

    def __init__(self, directory: str | os.PathLike[str], loose: bool = False) -> None:
        """Collect for ``directory``, which need not exist yet.

        With ``loose`` files go among the user's own, and keep no record: whoever writes them has
        asked before what they may replace.
        """
        self.directory, self.loose = Path(directory), loose
        self.files: dict[str, Content] = {}

    def add(self, name: str, content: Content) -> None:
        r"""Add one file by its name within the folder.

        What UTF-8 cannot hold (bytes of a file's name in another encoding) is written as
        ``\udcff``.
        """
        if name == RECORD or not plain_name(name):
            raise ValueError(f"'{name}' is not a plain file name")
        if name in self.files:
            raise ValueError(f"'{name}' was added already")
        self.files[name] = content

    def write(self) -> list[Path]:
        """Write all files and return their paths.

        Raises:
            BadInput: the folder cannot be written, or what is there must not be replaced;
                nothing has changed then.
        """
        run = current()
        try:
            self._check()
            with self._stage(run) as stage:
                if self.loose:
                    refuse_inputs(self.directory, self.files, run)
                else:
                    check_files(self.directory, self.files, run)
                self._put(stage, run)
        except (OSError, ValueError) as error:
            raise not_written(self.directory, error) from None
        return [self.directory / name for name in self.files]

    def _check(self) -> None:
        """Refuse a target that is a file, or that has folders where results should go."""
        target = self.directory
        if target.exists() and not target.is_dir():
            raise BadInput("is a file, not a folder", str(target), "Name another folder in --out")
        for name in (*self.files, RECORD):
            if (target / name).is_dir():
                raise BadInput("is a folder, a result of that name cannot be written",
                               str(target / name), "Move it away, or name another folder in --out")

    @contextmanager
    def _stage(self, run: Run) -> Iterator[Staging]:
        """Take the stage of the run, or lock one for as long as it takes to write."""
        own = run.stage
        if own and not self.loose and own.target == Path(os.path.realpath(self.directory)):
            yield own
            return
        with staged(self.directory, run.command,
                    next(iter(self.files), "") if self.loose else "") as stage:
            yield stage

    def _put(self, stage: Staging, run: Run) -> None:
        stale = [] if self.loose else stale_files(self.directory, self.files, run)

        def fill(folder: Path) -> None:
            digests = {}
            for name, content in self.files.items():
                note(name)
                digests[name] = _written(folder / name, content)
            if not self.loose:
                _written(folder / RECORD, record_text(self.directory, digests, run, stale))

        install(stage, fill, [*self.files] if self.loose else [*self.files, RECORD], stale,
                run.command)

    def __enter__(self) -> Self:
        """Begin to collect."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Write, unless the block failed."""
        if kind is None:
            self.write()


def _written(path: Path, content: Content, mode: Literal["wb", "xb"] = "wb") -> str:
    """Write a file piece by piece, onto the disk; return its SHA-256."""
    digest = hashlib.sha256()
    with path.open(mode) as stream:
        for part in encoded(content):
            stream.write(part)
            digest.update(part)
        stream.flush()
        os.fsync(stream.fileno())
    return digest.hexdigest()


KEPT = ".before-"
"""What stands between a file's name and a number where a copy of it is kept beside."""


def replace_kept(path: Path, text: str, digest: str) -> Path:
    """Replace a file of the user's at once, and return the copy of it that is kept beside.

    Links are followed, the mode stays. Nothing has changed where this fails, but for the copy.

    Args:
        path: the file.
        text: what it is to hold.
        digest: SHA-256 of what it has to hold now.

    Raises:
        BadInput: it has changed, or cannot be written.
    """
    place = Path(os.path.realpath(path))
    try:
        now = place.read_bytes()
        if hashlib.sha256(now).hexdigest() != digest:
            raise BadInput("has changed since it was read", str(path), "Run the command again")
        kept = _kept(place, now)
        new = place.with_name(f"{place.name}.new-{os.getpid()}")
        try:
            _written(new, text.encode(), "xb")
            shutil.copymode(place, new)
            os.replace(new, place)
        finally:
            new.unlink(missing_ok=True)
        sync(place.parent)
    except OSError as error:
        raise not_written(path, error) from None
    return kept if path.is_symlink() else path.with_name(kept.name)


def _kept(place: Path, content: bytes) -> Path:
    """Return a copy beside that holds ``content``, made where there is none; none is replaced."""
    for number in count(1):
        kept = place.with_name(f"{place.name}{KEPT}{number}")
        try:
            _written(kept, content, "xb")
        except FileExistsError:
            if kept.is_file() and kept.read_bytes() == content:
                return kept
            continue
        shutil.copymode(place, kept)
        return kept
    raise AssertionError("numbers do not end")
