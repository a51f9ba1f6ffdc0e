"""What a page makes of one command's output: one declaration beside its section, in ``kinds``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from ppmcal.io.csv import Table
from ppmcal.io.results.record import Record
from ppmcal.io.results.tables import WrittenTable
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.records import Held, ReportData
from ppmcal.report.section import Section

E = TypeVar("E")
R = TypeVar("R", bound=Record)
Drawn = Mapping[str, Sequence[Drawing]]
"""Drawings by the part of a chapter that they stand in."""
Chapter = tuple[str, Callable[[], Section]]
"""What a chapter is called where it cannot be made, and how it is made."""


def _nothing(_: Any, __: ReportData) -> Iterable[tuple[str, str]]:
    return ()


@dataclass(frozen=True)
class Kind(Generic[E]):
    """What becomes of one command's output.

    Attributes:
        place: what :class:`ReportData` holds its entries as.
        key: that of the list in report.json.
        noun: what one of them is called.
        order: of its chapters in the page, that of the work.
        files: any of them makes a folder one of this kind.
        read: the entries of a folder.
        chapters: of the page, those of an entry.
        shown: an entry as report.json has it.
        records: of an entry the commands and what they wrote, for "Where this comes from".
        findings: what the user must look at, as (where, sentence); whatever the page warns of.
        drawings: of an entry, which its chapter has as figures and ``figures`` as files.
        lead: the entry in a sentence for the head of the page, empty for none.
    """

    place: str
    key: str
    noun: str
    order: int
    files: tuple[str, ...]
    read: Callable[[Folder], Iterable[E]]
    chapters: Callable[[E, ReportData], Iterable[Chapter]]
    shown: Callable[[E, ReportData], Mapping[str, Any]]
    records: Callable[[E], Iterable[tuple[str, Record]]]
    findings: Callable[[E, ReportData], Iterable[tuple[str, str]]] = _nothing
    drawings: Callable[[E, ReportData], Drawn] = lambda _, __: {}
    lead: Callable[[E, ReportData], Iterable[str]] = lambda _, __: ()

    def of(self, data: ReportData) -> tuple[E, ...]:
        """Return the entries of a report."""
        found: tuple[E, ...] = getattr(data, self.place, None) or data.held.get(self.place, ())
        return found


class Folder:
    """A folder of results, each table read once."""

    def __init__(self, path: Path) -> None:
        """Take a folder that is there."""
        self.path, self.name = path, str(path)
        self._whole = cache(lambda spec: spec.read(path / spec.file))

    def has(self, *files: str) -> bool:
        """Whether any of some files is there."""
        return any((self.path / f).is_file() for f in files)

    def record(self, kind: type[R]) -> R:
        """Return the JSON of one kind, an empty one if it is not there."""
        return kind.read(self.path / kind.FILE) if self.has(kind.FILE) else kind()

    def table(self, spec: WrittenTable, wanted: Callable[[str], bool] | None = None
              ) -> Table | None:
        """Return the ``wanted`` columns of a table (default: all), None where it is not there."""
        if not self.has(spec.file):
            return None
        if wanted is None:
            found: Table = self._whole(spec)
            return found
        return spec.read(self.path / spec.file, wanted)


def recorded(kind: type[R]) -> Callable[[Folder], Iterator[Held[R]]]:
    """Return how a folder is read whose output is all in one record."""
    def read(folder: Folder) -> Iterator[Held[R]]:
        if folder.has(kind.FILE):
            yield Held(folder.name, folder.record(kind))

    return read
