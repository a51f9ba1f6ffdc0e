"""Chapters of the page and their parts, which fold, and what becomes of one command's output."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Generic, TypeVar

from markupsafe import Markup

from ppmcal import __version__
from ppmcal.calibration.fit import secondary
from ppmcal.io.csv import Table
from ppmcal.io.results.record import Record
from ppmcal.io.results.tables import WrittenTable
from ppmcal.notes import Note
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.html import bullets, part, plot_scripts, template_text, whole_page
from ppmcal.report.machine_section import machine_css, machine_scripts
from ppmcal.report.records import Held, ReportData

C = TypeVar("C")


@dataclass(frozen=True)
class Section:
    """A chapter, or a part of one.

    Attributes:
        title: plain text.
        body: ready HTML, before the parts.
        brief: plain text beside the title; of a part it is seen folded too.
        folded: whether a part is closed when the page opens.
        parts: of a chapter; name: in links, once it has its place on the page.
    """

    title: str
    body: str = ""
    brief: str = ""
    folded: bool = False
    parts: tuple[Section, ...] = ()
    name: str = ""

    @property
    def html(self) -> str:
        """The chapter as HTML."""
        return part("chapter", self)


def filled(parts: Iterable[Section | None]) -> tuple[Section, ...]:
    """Return the parts that hold something."""
    return tuple(p for p in parts if p is not None and (p.body or p.parts))


def chapter(title: str, make: Callable[[], C]) -> C | Section:
    """Return a chapter of a page; where it cannot be made, one that says so.

    ``title``: what it is called then. The other chapters stand whatever one of them meets.
    """
    notes = list[Note]()
    failed = Section(title)
    found = secondary(f"the chapter {title}", make, failed, notes)
    return replace(failed, body=bullets(notes)) if found is failed else found


def slug(text: str) -> str:
    """Return text as small letters, digits and hyphens: of links and of files."""
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-") or "part"


def free_name(stem: str, taken: set[str]) -> str:
    """Return a name that is not taken yet, and take it."""
    name, n = stem, 1
    while name in taken:
        n += 1
        name = f"{stem}-{n}"
    taken.add(name)
    return name


def placed(chapters: Sequence[Section]) -> list[Section]:
    """Return chapters with names that no two of them share.

    >>> [c.name for c in placed([Section("Rows: all"), Section("Rows, all")])]
    ['rows-all', 'rows-all-2']
    """
    taken = set[str]()

    def place(section: Section) -> Section:
        return replace(section, name=free_name(slug(section.title), taken),
                       parts=tuple(map(place, section.parts)))

    return [place(c) for c in chapters]


def page(title: str, chapters: Sequence[Section], **values: Any) -> str:
    """Return a whole page; text among ``values`` is escaped unless it is ``Markup``.

    ``values``: ``lead`` (sentences), ``verdicts``, ``look`` (what needs a look), ``calm`` (whether
    nothing does; default: there is no ``look``), ``folders``.
    """
    names = ("page", "page_tables", "plots", "page_end")
    shown = placed(chapters)
    bodies = [c.html for c in shown]
    plots = plot_scripts(bodies)
    machines = any('<div class="machine"' in body for body in bodies)
    css = "".join(template_text(f"{name}.css") for name in names)
    css += machine_css() if machines else ""
    return whole_page("page.html", title=title, chapters=shown, version=__version__,
                      css=Markup(css), script=Markup(template_text("page.js")), plots=plots,
                      machines=machine_scripts(library=not plots) if machines else "",
                      **{"verdicts": (), "lead": (), "calm": not values.get("look"), **values})


E = TypeVar("E")
R = TypeVar("R", bound=Record)
Drawn = Mapping[str, Sequence[Drawing | None]]
"""Drawings by the part of a chapter that they stand in; None for one that cannot be made."""
Chapter = tuple[str, Callable[[], Section]]
"""What a chapter is called where it cannot be made, and how it is made."""


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
    findings: Callable[[E, ReportData], Iterable[tuple[str, str]]] = lambda _, __: ()
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
