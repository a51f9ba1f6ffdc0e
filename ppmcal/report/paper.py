"""The figures of the page, and tables of its numbers, as files for papers with their captions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import partial
from pathlib import Path
from typing import Any

from ppmcal.calibration.fit import secondary
from ppmcal.errors import BadInput, unknown
from ppmcal.notes import Note
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.paper import paper
from ppmcal.report.kinds import IN_ORDER
from ppmcal.report.paper_tables import PaperTable, tables, tex
from ppmcal.report.records import ReportData
from ppmcal.report.section import free_name, slug

LONGEST = 60
"""Letters of a file's name."""


@dataclass(frozen=True)
class Sheet:
    """One figure or table.

    Attributes:
        name: of its file, without an ending.
        own: the name without the folder, which stands before it where there are several.
        group: the part of the page that it is from.
        content: what it shows.
    """

    name: str
    own: str
    group: str
    content: Drawing | PaperTable

    @property
    def caption(self) -> str:
        """What it shows and how to read it."""
        return self.content.caption if isinstance(self.content, PaperTable) else (
            f"{self.content.title.rstrip('.')}. {self.content.caption}".strip())

    def matches(self, pattern: str) -> bool:
        """Whether it is asked for: by its name, with or without the folder, or by its group."""
        return any(fnmatchcase(name, pattern) for name in (self.name, self.own, self.group))

    def files(self, width: float, form: str) -> dict[str, str | bytes]:
        """Return file name -> content; ``width``: of a figure, mm, ``form``: its format."""
        if isinstance(self.content, PaperTable):
            return {f"{self.name}.tex": self.content.tex(), f"{self.name}.md":
                    self.content.markdown()}
        return {f"{self.name}.{form}": paper(self.content, width, form)}


def sheets(data: ReportData, notes: list[Note], only: Sequence[str] = ()) -> list[Sheet]:
    """Return the figures and tables of a report, those that are asked for.

    Args:
        data: the report.
        notes: to which is added what cannot be drawn.
        only: patterns of names or groups, none for all.

    Raises:
        BadInput: there is none, or none of a name.
    """
    found = list(_all(data, notes))
    if not found:
        raise BadInput("hold no figure and no table", ", ".join(data.folders),
                       "Name output folders of identify, diagnose, compensate, kinematics, "
                       "validate, compare or export")
    for pattern in only:
        if not any(s.matches(pattern) for s in found):
            raise unknown("figure", pattern, dict.fromkeys([*(s.group for s in found),
                                                      *(s.name for s in found)]),
                          "--only")
    return [s for s in found if not only or any(s.matches(p) for p in only)]


def _all(data: ReportData, notes: list[Note]) -> Iterator[Sheet]:
    """Yield every figure and table."""
    taken, several = set[str](), len(data.folders) > 1

    def lead(folder: str) -> str:
        return f"{slug(Path(folder).name)}-" if several else ""

    for kind in IN_ORDER:
        for one in kind.of(data):
            folder = str(getattr(one, "folder", "") or getattr(one, "identified", ""))
            make: Callable[[], Mapping[str, Sequence[Drawing]]] = partial(kind.drawings, one, data)
            none: dict[str, Sequence[Drawing]] = {}
            for group, drawings in secondary(f"figures of {folder}", make, none, notes).items():
                for drawing in drawings:
                    own = slug(drawing.title)[:LONGEST].rstrip("-")
                    yield Sheet(free_name(lead(folder) + own, taken), own, group, drawing)
    for fit in data.identified:
        for table in tables(fit):
            yield Sheet(free_name(lead(fit.folder) + table.name, taken), table.name, "tables",
                        table)


def captions(some: Sequence[Sheet]) -> dict[str, str]:
    """Return captions.md, and captions.tex with an environment for each figure and table."""
    lines = [f"**{s.name}**: {s.caption}\n" for s in some]
    return {"captions.md": "\n".join(lines), "captions.tex": "\n".join(map(_environment, some))}


def _environment(s: Sheet) -> str:
    """Return a figure or table of LaTeX."""
    kind, content = ("table", rf"\input{{{s.name}}}") if isinstance(s.content, PaperTable) else (
        "figure", rf"\includegraphics{{{s.name}}}")
    caption = rf"  \caption{{{tex(s.caption)}}}"
    label = rf"  \label{{{kind[:3]}:{s.name}}}"
    parts = [caption, label, f"  {content}"] if kind == "table" else [
        f"  {content}", caption, label]
    return "\n".join([rf"\begin{{{kind}}}", r"  \centering", *parts, rf"\end{{{kind}}}", ""])


def entries(some: Sequence[Sheet]) -> list[dict[str, Any]]:
    """Return name, group and caption of each, as JSON has them."""
    return [{"name": s.name, "group": s.group, "caption": s.caption,
             "kind": "table" if isinstance(s.content, PaperTable) else "figure"} for s in some]
