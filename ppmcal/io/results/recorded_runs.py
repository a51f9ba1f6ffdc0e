"""What folders of results say of the runs that wrote them, and where the inputs are now."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ppmcal.errors import BadInput
from ppmcal.io.folder import RECORD, digest_of, read_record, read_runs
from ppmcal.io.limits import FOLDERS
from ppmcal.io.results.record import Provenance
from ppmcal.io.results.verification import InputCheck
from ppmcal.io.stage import recover

DEEPEST = 6
"""Folders below the one that is named in which results are looked for."""
MOST = 100_000
"""Files of the folder of inputs that are looked at."""


@dataclass(frozen=True)
class RecordedRun:
    """What is recorded of one run that wrote into a folder.

    Attributes:
        folder: of its results.
        command: its name.
        source: inputs, options and what else decides the results.
        digests: name -> SHA-256 of its files as they were written.
    """

    folder: Path
    command: str
    source: Provenance
    digests: Mapping[str, str]

    @property
    def whole(self) -> bool:
        """Whether it wrote into the folders within too, as it was told where to write."""
        return "out" in self.source.options

    @property
    def working_folder(self) -> str:
        """The folder that its paths begin in, as far as that is recorded."""
        way = str(self.source.more.get("from") or "..")
        return os.path.abspath(self.folder / way)

    @property
    def name(self) -> str:
        """The name that its folder had: data sets may be called after it."""
        name = str(self.source.more.get("name") or "")
        return name if Path(name).name == name and name else self.folder.resolve().name


class FoundInputs:
    """The inputs of a run: where each is now, and what is wrong with the others."""

    def __init__(self, run: RecordedRun, folder: Path | None) -> None:
        """Look for them where they were, from here, and in ``folder``."""
        self.places: dict[str, Path] = {}
        self.wrong: list[InputCheck] = []
        self._folder = folder
        for path, digest in run.source.inputs.items():
            near = [Path(run.working_folder, path), Path(path)]
            sums = {p: digest_of(p) for p in near}
            here = next((p for p in near if sums[p] == digest), None) or self._elsewhere(
                Path(path).name, digest)
            if here is None:
                now = next((s for s in sums.values() if s), "")
                self.wrong.append(InputCheck(file=path, then=digest, now=now))
            else:
                self.places[path] = here

    def _elsewhere(self, name: str, digest: str) -> Path | None:
        """Return a file of the folder of inputs: of that name if there is one, else any."""
        named = sorted(self._files, key=lambda p: (p.name != name, p))
        return next((p for p in named if digest_of(p) == digest), None)

    @cached_property
    def _files(self) -> list[Path]:
        if self._folder is None:
            return []
        every = (Path(top, n) for top, _, names in os.walk(self._folder) for n in sorted(names))
        return [p for p, _ in zip(every, range(MOST), strict=False)]


def recorded_runs(folder: Path) -> Iterator[RecordedRun]:
    """Yield the runs that wrote into a folder and into those within.

    Raises:
        BadInput: there is no such folder.
    """
    if not folder.is_dir():
        raise BadInput("is not a folder", str(folder), "Give a folder that a command wrote")
    own = list(runs_of(folder))
    yield from own
    if not any(run.whole for run in own):
        for within in folders_within(folder):
            yield from runs_of(within)


def folders_within(folder: Path) -> Iterator[Path]:
    """Yield the folders within that hold a record.

    Raises:
        BadInput: there are too many folders to look through.
    """
    for seen, (top, names, files) in enumerate(os.walk(folder)):
        if seen > FOLDERS.most:
            raise FOLDERS.error(str(folder))
        place = Path(top)
        deep = len(place.relative_to(folder).parts)
        names[:] = sorted(n for n in names if not n.startswith(".")) if deep < DEEPEST else []
        if deep and RECORD in files:
            yield place


def runs_of(folder: Path) -> Iterator[RecordedRun]:
    """Yield the runs that wrote into one folder; a killed one's move is finished first."""
    recover(folder)
    files = read_record(folder) or {}
    runs = read_runs(folder)
    for command in dict.fromkeys([*runs, *(w.command for w in files.values())]):
        digests = {n: w.digest for n, w in files.items() if w.command == command}
        yield RecordedRun(folder, command, _provenance(runs.get(command)), digests)
    if not files and not runs:
        yield from _runs_of_results(folder)


def _runs_of_results(folder: Path) -> Iterator[RecordedRun]:
    """Yield the run that the JSON files of a folder name, where its hidden record is lost."""
    for path in sorted(folder.glob("*.json")):
        try:
            source = _provenance(json.loads(path.read_bytes()).get("provenance"))
        except (OSError, ValueError, AttributeError, RecursionError):
            continue
        if source.function:
            yield RecordedRun(folder, source.function.partition(".")[2], source, {})
            return


def _provenance(content: Any) -> Provenance:
    """Return a recorded provenance, an empty one of what is none."""
    try:
        return Provenance.checked(content or {})
    except BadInput:
        return Provenance()
