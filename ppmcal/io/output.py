"""What commands write: JSON, provenance, and files that appear whole or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import platform
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ppmcal import __version__
from ppmcal.errors import BadInput
from ppmcal.io.csv_writer import Content, encoded
from ppmcal.io.environment import environment
from ppmcal.io.exchange import install
from ppmcal.io.folder import (
    RECORD,
    Run,
    check_files,
    content_of,
    current,
    record_text,
    refuse_inputs,
    stale_files,
    track_input,
)
from ppmcal.io.stage import Staging, not_written, staged
from ppmcal.notes import Note
from ppmcal.wording.progress import note


class Output:
    """Several files that appear together in a folder, or not at all.

    They replace neither inputs of the run under way nor, unless it is forced to, what its
    command did not write: see :mod:`ppmcal.io.folder`. How they come into the folder:
    :mod:`ppmcal.io.exchange`.

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
        if name in ("", ".", "..", RECORD) or Path(name).name != name:
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


def _written(path: Path, content: Content) -> str:
    """Write a file piece by piece, onto the disk; return its SHA-256."""
    digest = hashlib.sha256()
    with path.open("wb") as stream:
        for part in encoded(content):
            stream.write(part)
            digest.update(part)
        stream.flush()
        os.fsync(stream.fileno())
    return digest.hexdigest()


def json_text(obj: object) -> str:
    """Return JSON: nan and inf become null, numpy and dataclasses plain data."""
    return json.dumps(plain(obj), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(obj: object) -> Any:
    """Return ``obj`` as what JSON can hold."""
    if isinstance(obj, str):
        return obj if isinstance(obj, Note) else str(obj)
    if obj is None or isinstance(obj, bool | int):
        return obj
    if isinstance(obj, np.bool_):
        return bool(obj)
    if isinstance(obj, np.integer):
        return int(obj)
    if isinstance(obj, float | np.floating):
        return float(obj) if math.isfinite(obj) else None
    if isinstance(obj, np.ndarray):
        return [plain(v) for v in obj.tolist()] if obj.ndim else plain(obj.item())
    if isinstance(obj, Mapping):
        return {str(k): plain(v) for k, v in obj.items()}
    if dataclasses.is_dataclass(obj) and not isinstance(obj, type):
        return {f.name: plain(getattr(obj, f.name)) for f in dataclasses.fields(obj)}
    if isinstance(obj, Sequence | set | frozenset):
        return [plain(v) for v in obj]
    return str(obj)


def provenance(inputs: Sequence[str | os.PathLike[str]], command: str, seed: int | None,
               function: str = "", options: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return where results come from: all that decides what is in them.

    Args:
        inputs: files that were read.
        command: as it was typed.
        seed: of what is drawn at random.
        function: that made the result, as ``verify`` knows it.
        options: all that it was called with, defaults too.
    """
    sums, run = {}, current()
    for path in inputs:
        track_input(path)
        sums[str(path)] = content_of(path, run)
        if not sums[str(path)]:
            raise BadInput("is not there any more, or cannot be read", str(path),
                           "Give the path of a readable file")
    return {"version": __version__, "inputs": sums, "command": command, "seed": seed,
            "function": function, "options": dict(options or {}), "environment": environment(),
            "numpy": np.__version__, "python": platform.python_version()}


def origin_comment(source: Mapping[str, Any]) -> str:
    """Return the provenance of a file that stands alone, as comments at the head of a YAML file."""
    lines = [f"made by ppmcal {source['version']}: {source['command']}",
             *(f"from {path}, sha256 {digest}" for path, digest in source["inputs"].items()),
             f"with Python {source['python']}, NumPy {source['numpy']}"]
    return "".join(f"# {_on_one_line(line)}\n" for line in lines)


def _on_one_line(text: str) -> str:
    """Return text without what would end a comment: a name may have a line break in it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii")
                   for c in text)
