"""Figures and tables of output folders as files for papers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.figures.options import FORMATS, FiguresArguments
from ppmcal.commands.result import Result
from ppmcal.errors import refuse_unknown
from ppmcal.io import csv_text
from ppmcal.notes import Note
from ppmcal.report import collect, results_of
from ppmcal.report.paper import Sheet, captions, entries, sheets
from ppmcal.store.provenance import source_of
from ppmcal.wording import pluralize
from ppmcal.wording.progress import stage


@dataclass(frozen=True, eq=False, repr=False)
class FiguresResult(Result):
    """Figures and tables for papers.

    Attributes:
        sheets: what they show, with their names.
        width: of the figures, mm.
        form: their format: pdf, svg or png.
    """

    COMMAND: ClassVar[str] = "figures"
    TABLE: ClassVar[str] = "captions.csv"

    sheets: tuple[Sheet, ...]
    width: float
    form: str

    @cached_property
    def _drawn(self) -> Mapping[str, str | bytes]:
        out: dict[str, str | bytes] = {}
        with stage("drawing", len(self.sheets), "figures") as work:
            for sheet in self.sheets:
                out |= sheet.files(self.width, self.form)
                work.done()
        return out

    def files(self) -> Mapping[str, str | bytes]:
        """Return each figure, each table as .tex and .md, captions.md and captions.tex."""
        return {**self._drawn, **captions(self.sheets)}

    def tables(self) -> Mapping[str, str | bytes]:
        """Return names and captions as a table besides the files."""
        rows = entries(self.sheets)
        heads = ["name", "kind", "group", "caption"]
        return {self.TABLE: csv_text(heads, [[r[h] for r in rows] for h in heads])}

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        return {"format": "ppmcal/figures/1", "width": self.width, "form": self.form,
                "figures": entries(self.sheets), "findings": list(self.findings)}

    def headline(self) -> str:
        """Return how many figures and tables there are, and how wide they are."""
        tables = sum(s.group == "tables" for s in self.sheets)
        drawn = pluralize(len(self.sheets) - tables, "figure")
        return f"{drawn} of {self.width:.4g} mm, {pluralize(tables, 'table')}."


def run(asked: FiguresArguments) -> FiguresResult:
    """Draw the figures of output folders for papers."""
    width = asked.millimetres
    refuse_unknown("format", [asked.form], FORMATS, "--format")
    notes = list[Note]()
    folders = results_of([Path(f) for f in asked.folders])
    found = sheets(collect(folders), notes, tuple(asked.only))
    return FiguresResult(source_of("make_figures", [], None), tuple(notes), tuple(found), width,
                         asked.form)
