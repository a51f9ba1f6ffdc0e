"""Runs that folders record: where their inputs are now, and a place to do them again."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from glob import escape
from pathlib import Path
from typing import Annotated, Any

from ppmcal.codec import decoded
from ppmcal.errors import BadInput, cleaned_up, uninterrupted
from ppmcal.limits import FOLDERS
from ppmcal.store.folder import RECORD, read_record
from ppmcal.store.inputs import digest_of
from ppmcal.store.output import KEPT
from ppmcal.store.provenance import IN_MEMORY, Provenance
from ppmcal.store.stage import plain_name
from ppmcal.store.transaction import recover
from ppmcal.units import Key

SHORT = 12
"""Characters of a SHA-256 that people are shown."""
DEEPEST = 6
"""Folders below the one that is named in which results are looked for."""
MOST = 100_000
"""Files of the folder of inputs that are looked at."""


@dataclass(frozen=True)
class RecordedProvenance(Provenance):
    """Where results come from, as their folder records it.

    Attributes:
        folder: the way from their folder to the one that the run's paths begin in.
        name: that their folder had.
    """

    folder: Annotated[str, Key("from")] = ""
    name: str = ""


@dataclass(frozen=True)
class InputCheck:
    """An input that is not there, or not as it was."""

    file: str = ""
    then: str = ""
    now: str = ""

    def words(self) -> str:
        """Return what is wrong with it."""
        if not self.now:
            return f"{self.file} is not there (SHA-256 {self.then[:SHORT]}...)"
        return (f"{self.file} has changed: SHA-256 {self.then[:SHORT]}... then, "
                f"{self.now[:SHORT]}... now")


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
    source: RecordedProvenance
    digests: Mapping[str, str]

    @property
    def in_memory(self) -> bool:
        """Whether an argument was an object of Python, which no file holds."""
        return any(isinstance(v, Mapping) and IN_MEMORY in v
                   for value in self.source.options.values()
                   for v in (value if isinstance(value, list | tuple) else [value]))

    @property
    def data(self) -> list[Any]:
        """The measurement files that it was given."""
        given = self.source.options.get("data") or []
        return given if isinstance(given, list) else [given]

    @property
    def whole(self) -> bool:
        """Whether it wrote into the folders within too, as it was told where to write."""
        return "out" in self.source.options

    @property
    def working_folder(self) -> str:
        """The folder that its paths begin in, as far as that is recorded."""
        return os.path.abspath(self.folder / (self.source.folder or ".."))

    @property
    def name(self) -> str:
        """The name that its folder had: data sets may be called after it."""
        name = self.source.name
        return name if plain_name(name) else self.folder.resolve().name


class FoundInputs:
    """The inputs of a run: where each is now, and what is wrong with the others."""

    def __init__(self, run: RecordedRun, folder: Path | None) -> None:
        """Look for them where they were, kept beside, from here, and in ``folder``."""
        self.places: dict[str, Path] = {}
        self.wrong: list[InputCheck] = []
        self._folder = folder
        for path, digest in run.source.inputs.items():
            near = [one for p in (Path(run.working_folder, path), Path(path))
                    for one in (p, *sorted(p.parent.glob(f"{escape(p.name)}{KEPT}*")))]
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
    record = read_record(folder)
    for command in dict.fromkeys([*record.runs, *(w.command for w in record.files.values())]):
        yield RecordedRun(folder, command, _provenance(record.runs.get(command)),
                          record.of(command))
    if not record.files and not record.runs:
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


def _provenance(content: Any) -> RecordedProvenance:
    """Return a recorded provenance, an empty one of what is none."""
    try:
        return decoded(RecordedProvenance, content or {}, Path())
    except BadInput:
        return RecordedProvenance()


# ---- done again


RESULTS = "results.of.verify"
"""Folder within the sandbox's root for what a run writes, where nothing says more of it."""


@dataclass(frozen=True)
class Sandbox:
    """A temporary folder that stands for the whole file system while a run is done again.

    The run's own paths hold in it: relative ones from its working folder, absolute ones from its
    root. So what comes out names the same paths, once the root's own is taken away.

    Attributes:
        root: the folder.
        base: the working folder that it stands for, absolute.
    """

    root: Path
    base: str

    @property
    def cwd(self) -> Path:
        """The working folder."""
        return self.place(self.base)

    def place(self, path: str) -> Path:
        """Return where a path of the run is within."""
        whole = Path(os.path.normpath(os.path.join(self.base, path)))
        return self.root / whole.relative_to(whole.anchor)

    def inside(self, value: Any) -> Any:
        """Return an option as it is said within: absolute paths below the root.

        Raises:
            BadInput: a relative path leads out of it.
        """
        if isinstance(value, list):
            return [self.inside(v) for v in value]
        if not isinstance(value, str) or not value:
            return value
        if os.path.isabs(value):
            return str(self.place(value))
        if not Path(os.path.normpath(self.cwd / value)).is_relative_to(self.root):
            raise BadInput("leads out of the folder of the run", value, "Run the command by hand")
        return value

    def lay_out(self, inputs: Mapping[str, Path]) -> None:
        """Put the inputs where the run had them."""
        self.cwd.mkdir(parents=True, exist_ok=True)
        for path, here in inputs.items():
            there = self.place(path)
            there.parent.mkdir(parents=True, exist_ok=True)
            if there.exists():
                continue
            try:
                there.symlink_to(here.absolute())
            except OSError:    # not every system lets everybody
                shutil.copyfile(here, there)


@contextlib.contextmanager
def sandbox(base: str) -> Iterator[Sandbox]:
    """Make one that stands for the file system as seen from the folder ``base``."""
    root = None
    with cleaned_up():
        try:
            with uninterrupted():    # what is there is known, and taken away whole
                root = Path(os.path.realpath(tempfile.mkdtemp(prefix="ppmcal-verify-")))
            yield Sandbox(root, base)
        finally:
            if root is not None:
                with uninterrupted():
                    shutil.rmtree(root, ignore_errors=True)
