"""Output folders on one page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.api.inputs import Path_, recorded, source_of
from ppmcal.api.result import Result
from ppmcal.io import csv_text, json_text
from ppmcal.report import collect, to_html, to_json
from ppmcal.report.records import ReportData


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
        rows = self.content["attention"]
        return {self.TABLE: csv_text(["where", "what"], [[r["where"] for r in rows],
                                                         [r["what"] for r in rows]])}

    def headline(self) -> str:
        """Return the page's first sentences."""
        return " ".join(self.content["headline"])


@recorded
def make_report(*folders: Path_) -> ReportResult:
    """Gather output folders into one page.

    Args:
        *folders: folders that commands, or ``save`` of their results, wrote.

    Raises:
        BadInput: a folder without results, or a file there that cannot be read.
    """
    data = collect([Path(f) for f in folders])
    content = to_json(data)
    return ReportResult(source_of("make_report", [], None), (), data, content)
