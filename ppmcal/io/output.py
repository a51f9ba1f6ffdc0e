"""What commands write: CSV, JSON, provenance, and files that appear whole or not at all."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import os
import platform
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from ppmcal import __version__
from ppmcal.errors import BadInput
from ppmcal.io.folder import RECORD, check_files, current, note_read, record_text

CHUNK = 20_000


class Output:
    """Several files that appear together in a folder, or not at all.

    They replace neither inputs of the run under way nor, unless it is forced to, what its
    command did not write: see :mod:`ppmcal.io.folder`.

    Use it as ``with Output("out") as out: out.add("a.csv", text)``: the files are written when
    the block ends without an error. Or call :meth:`write`.
    """

    def __init__(self, directory: str | os.PathLike[str]) -> None:
        """Collect for ``directory``, which need not exist yet."""
        self.directory = Path(directory)
        self.files: dict[str, bytes] = {}

    def add(self, name: str, content: str | bytes) -> None:
        r"""Add one file by its name within the folder.

        What UTF-8 cannot hold (bytes of a file's name in another encoding) is written as
        ``\udcff``.
        """
        if name in ("", ".", "..", RECORD) or Path(name).name != name:
            raise ValueError(f"'{name}' is not a plain file name")
        if name in self.files:
            raise ValueError(f"'{name}' was added already")
        self.files[name] = (content.encode("utf-8", "backslashreplace")
                            if isinstance(content, str) else content)

    def write(self) -> list[Path]:
        """Write all files and return their paths.

        Raises:
            BadInput: the folder cannot be written, or what is there must not be replaced;
                nothing has changed then.
        """
        run = current()
        try:
            self._check()
            check_files(self.directory, self.files, run)
            record = record_text(self.directory, self.files, run).encode()
            with self._stage() as stage:
                self._stage_and_move(stage, {**self.files, RECORD: record})
        except (OSError, ValueError) as error:
            raise self._refusal(error) from None
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
    def _stage(self) -> Iterator[Path]:
        """Make a hidden folder on the target's file system: in it, or beside it if it is new."""
        home = self.directory
        if not home.exists():
            home = home.absolute().parent
            home.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(prefix=".ppmcal.", suffix=".part", dir=home))
        try:
            yield stage
        finally:
            shutil.rmtree(stage, ignore_errors=True)

    def _stage_and_move(self, stage: Path, files: Mapping[str, bytes]) -> None:
        new, old = stage / "new", stage / "old"
        new.mkdir()
        old.mkdir()
        for name, content in files.items():
            (new / name).write_bytes(content)
        if not self.directory.exists():
            new.replace(self.directory)
            return
        moved: list[str] = []
        try:
            for name in files:
                if (self.directory / name).exists():
                    (self.directory / name).replace(old / name)
                moved.append(name)
                (new / name).replace(self.directory / name)
        except BaseException:
            for name in moved:
                (self.directory / name).unlink(missing_ok=True)
                if (old / name).exists():
                    (old / name).replace(self.directory / name)
            raise

    def _refusal(self, error: OSError | ValueError) -> BadInput:
        reason = getattr(error, "strerror", None) or error
        return BadInput(f"cannot be written ({reason})", str(self.directory),
                        "Check permissions and space, or name another folder in --out")

    def __enter__(self) -> Self:
        """Begin to collect."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Write, unless the block failed."""
        if kind is None:
            self.write()


def csv_text(header: Sequence[str], columns: Sequence[Any]) -> str:
    """Return a CSV with 17 significant digits.

    Args:
        header: column names.
        columns: one sequence or array (N,) for each; floats, integers, booleans or words
            (None is an empty cell).
    """
    arrays = [_printable(c) for c in columns]
    if len(arrays) != len(header):
        raise ValueError(f"{len(header)} names for {len(arrays)} columns")
    sizes = {len(a) for _, a in arrays}
    if len(sizes) > 1:
        raise ValueError(f"columns of different lengths: {sorted(sizes)}")
    size = sizes.pop() if sizes else 0
    line = ",".join(form for form, _ in arrays) + "\n"
    parts = [",".join(_cell(h) for h in header) + "\n"]
    plain = all(form == "%.17g" for form, _ in arrays)
    block = np.column_stack([a for _, a in arrays]) if plain and size else None
    for start in range(0, size, CHUNK):
        stop = min(start + CHUNK, size)
        if block is not None:
            cells = block[start:stop].ravel().tolist()
        else:
            lists = [a[start:stop].tolist() for _, a in arrays]
            cells = [c for row in zip(*lists, strict=True) for c in row]
        parts.append((line * (stop - start)) % tuple(cells))
    return "".join(parts)


def _printable(values: Any) -> tuple[str, Any]:
    """Return the format of a column and the column as an array (N,)."""
    array = np.asarray(values)
    if array.ndim != 1:
        array = np.array(list(values), dtype=object)
    if array.dtype.kind == "f":
        return "%.17g", array
    if array.dtype.kind in "iu":
        return "%d", array
    words = np.empty(len(array), dtype=object)
    words[:] = [_cell(v) for v in array.tolist()]
    return "%s", words


def _cell(value: object) -> str:
    """Return one cell of text, quoted where it must be."""
    if value is None:
        return ""
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:.17g}"
    text = str(value)
    if any(c in text for c in ',"\n\r'):
        return '"' + text.replace('"', '""') + '"'
    return text


def json_text(obj: object) -> str:
    """Return JSON: nan and inf become null, numpy and dataclasses plain data."""
    return json.dumps(plain(obj), indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def plain(obj: object) -> Any:
    """Return ``obj`` as what JSON can hold."""
    if isinstance(obj, str):
        return str(obj)
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


def provenance(inputs: Sequence[str | os.PathLike[str]], command: str, seed: int | None
               ) -> dict[str, Any]:
    """Return where results come from: version, SHA-256 of each input, command, seed."""
    sums = {}
    for path in inputs:
        try:
            with open(path, "rb") as stream:
                sums[str(path)] = hashlib.file_digest(stream, "sha256").hexdigest()
            note_read(path)
        except OSError as error:
            raise BadInput(f"cannot be read ({error.strerror})", str(path),
                           "Give the path of a readable file") from None
    return {"version": __version__, "inputs": sums, "command": command, "seed": seed,
            "numpy": np.__version__, "python": platform.python_version()}
