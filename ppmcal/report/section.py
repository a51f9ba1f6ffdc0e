"""Chapters of the page and their parts, which fold."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from markupsafe import Markup

from ppmcal import __version__
from ppmcal.calibration.fit import secondary
from ppmcal.notes import Note
from ppmcal.report.html import bullets, part, plot_scripts, template_text, whole_page
from ppmcal.report.machine_section import machine_css, page_scripts

C = TypeVar("C")


@dataclass(frozen=True)
class Section:
    """A chapter, or a part of one.

    Attributes:
        title: plain text.
        body: ready HTML, before the parts.
        brief: plain text beside the title; of a part it is seen folded too.
        folded: whether a part is closed when the page opens.
        parts: of a chapter.
    """

    title: str
    body: str = ""
    brief: str = ""
    folded: bool = False
    parts: tuple[Section, ...] = ()


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


@dataclass(frozen=True)
class Placed:
    """A section with its name in links, and its parts likewise."""

    name: str
    section: Section
    parts: tuple[Placed, ...] = ()

    @property
    def html(self) -> str:
        """The section as HTML."""
        return part("chapter", self)


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


def placed(chapters: Sequence[Section]) -> list[Placed]:
    """Return chapters with names that no two of them share.

    >>> [c.name for c in placed([Section("Rows: all"), Section("Rows, all")])]
    ['rows-all', 'rows-all-2']
    """
    taken = set[str]()

    def place(section: Section) -> Placed:
        name = free_name(slug(section.title), taken)
        return Placed(name, section, tuple(place(p) for p in section.parts))

    return [place(c) for c in chapters]


def page(title: str, chapters: Sequence[Section], **values: Any) -> str:
    """Return a whole page; text among ``values`` is escaped unless it is ``Markup``.

    Args:
        title: of the page.
        chapters: in their order.
        **values: ``lead`` (sentences), ``verdicts``, ``look`` (what needs a look), ``calm``
            (whether nothing does; default: there is no ``look``), ``folders``.
    """
    names = ("page", "page_tables", "plots", "page_end")
    shown = placed(chapters)
    bodies = [c.html for c in shown]
    plots = plot_scripts(bodies)
    machines = page_scripts(bodies, library=not plots)
    css = "".join(template_text(f"{name}.css") for name in names)
    css += machine_css() if machines else ""
    return whole_page("page.html", title=title, chapters=shown, version=__version__,
                      css=Markup(css), script=Markup(template_text("page.js")), plots=plots,
                      machines=machines,
                      **{"verdicts": (), "lead": (), "calm": not values.get("look"), **values})
