"""Output folders on one page."""

from __future__ import annotations

import webbrowser
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.inputs import imports_behind, load
from ppmcal.commands.report.options import ReportArguments
from ppmcal.commands.result import Result
from ppmcal.controllers import uses
from ppmcal.errors import BadInput
from ppmcal.io import csv_text
from ppmcal.plain import json_text
from ppmcal.report import collect, to_html, to_json
from ppmcal.report.records import Identified, ReportData
from ppmcal.report.verdict import to_compensate
from ppmcal.store.provenance import source_of
from ppmcal.wording.told import Told


@dataclass(frozen=True, eq=False, repr=False)
class ReportResult(Result):
    """A report.

    Attributes:
        data: what the folders hold.
        content: the content of report.json.
    """

    COMMAND: ClassVar[str] = "report"
    TABLE: ClassVar[str] = "attention.csv"

    data: ReportData
    content: Mapping[str, Any]

    def files(self) -> Mapping[str, str | bytes]:
        """Return report.html and report.json."""
        return {"report.html": to_html(self.data), "report.json": json_text(self.content)}

    def tables(self) -> Mapping[str, str | bytes]:
        """Return what needs a look, as a table besides the files."""
        heads = ("where", "what")
        return {self.TABLE: csv_text(heads, [[r[h] for r in self.content["attention"]]
                                             for h in heads])}

    def told(self) -> Iterator[Told]:
        """Yield nothing: the page says it."""
        return iter(())

    def finished(self, written: Sequence[Path], asked: Any) -> Iterator[Told]:
        """Yield where the page is, which is opened where that is wanted and can be done."""
        yield from super().finished(written, asked)
        page = next(p for p in written if p.suffix == ".html")
        if not (asked.open_page and webbrowser.open(page.resolve().as_uri())):
            yield f"Open {page} in a browser."

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        return self.content

    def headline(self) -> str:
        """Return the page's first sentences."""
        return " ".join(self.content["headline"])


def run(asked: ReportArguments) -> ReportResult:
    """Gather output folders into one page."""
    data = collect([Path(f) for f in asked.folders])
    by_folder = {one.folder: one for one in data.identified}
    data = replace(data, use=cache(lambda folder: _use(by_folder[folder])))
    content = to_json(data)
    return ReportResult(source_of("make_report", [], None), (), data, content)


def _use(one: Identified) -> str:
    """Return what may be done with a calibrated machine, empty where that cannot be said.

    A printer gets its firmware's numbers, which it computes with; to others commands may be sent.
    """
    model = Path(one.folder) / "identified.yaml"
    imports = [run.source.options for run in imports_behind(Path(one.folder))]
    form, old = next(((str(o["form"]), str(o["file"])) for o in imports
                      if {"form", "file"} <= o.keys()), ("", ""))
    try:
        found = uses(load(model), one.folder, form, old)
    except BadInput:
        return ""
    own = [] if old else [to_compensate(one.folder)]
    return "; ".join([*own, *found])
