"""What tests of several packages share: report files."""

from __future__ import annotations

import json
import re
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.report.section import Section, placed

VOID = {"meta", "br", "wbr", "path", "circle", "rect", "polyline", "link", "img", "hr"}

class Checker(HTMLParser):
    """Checks that tags nest, and gathers text and addresses."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.text: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.scripts = self.held = 0

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, k, v or "") for k, v in attrs]
        self.scripts += tag == "script"
        self.held += tag == "script" and ("type", "application/json") in attrs
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, k, v or "") for k, v in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data: str) -> None:
        if not {"script", "style"} & set(self.open):
            self.text.append(data)


def read(html: str) -> Checker:
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert not checker.open
    return checker


def own(page: str) -> str:
    """Return a page without the library that draws its plots."""
    return re.sub(r"<script>/\* plotly.*?</script>", "", page, flags=re.S)


def specs(page: str) -> dict[str, dict[str, Any]]:
    """Return what each plot of a page is drawn from, by its title."""
    figures = re.findall(r'<figure class="plot">.*?</figure>', page, re.S)
    found = [(unescape(re.search(r"<figcaption><b>(.*?)\.</b>", f)[1]),
              json.loads(re.search(r'<script type="application/json">(.*?)</script>', f, re.S)[1]))
             for f in figures]
    assert len(found) == page.count('<figure class="plot">')
    return dict(found)


def cells(page: str, caption: str) -> list[list[str]]:
    """Return the rows of the table whose caption begins so, or whose part does; heads first."""
    at = next(page.index(t) for t in (f"<caption>{caption}", f"<h3>{caption}") if t in page)
    body = page[page.index("<thead>", at):page.index("</table>", at)]
    rows = re.findall(r"<tr[ >].*?</tr>", body)
    return [[unescape(re.sub(r"<[^>]*>", "", c))
             for c in re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row)] for row in rows]


def html_of(section: Section) -> str:
    """Return a chapter as it stands on a page."""
    (one,) = placed([section])
    return one.html


def write_csv(path: Path, columns: dict[str, Any]) -> None:
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(str(c) for c in r) for r in rows)]
    path.write_text("\n".join(lines) + "\n")


def identification(name: str = "bench", inputs: dict[str, str] | None = None) -> dict[str, Any]:
    figures = {"mean": 0.5, "rms": 0.5121, "p95": 0.9, "max": 1.1, "unit": "mm"}
    after = {"mean": 0.005, "rms": 0.00612, "p95": 0.01, "max": 0.013, "unit": "mm"}
    turn = {"mean": 0.05, "rms": 0.0611, "p95": 0.1, "max": 0.12, "unit": "deg"}
    gap = {"rms": 0.4, "max": 0.8, "unit": "mm"}
    return {
        "format": "ppmcal/identification/1", "name": name, "method": "prior",
        "parameters": [
            {"name": "leg1.base.point.x", "nominal": 10.0, "value": 10.5012, "error": 0.5012,
             "sigma": 0.004, "sigma_data": 0.0041, "low": 10.4934, "high": 10.509,
             "tolerance": 0.5, "unit": "mm", "status": "identified"},
            {"name": "leg1.offset", "nominal": 0.0, "value": 2.0, "error": 2.0, "sigma": 0.3,
             "sigma_data": None, "tolerance": 0.4, "unit": "mm", "status": "redundant",
             "far": True},
            {"name": "leg1.lateral", "nominal": 0.0, "value": 0.0, "error": 0.0, "sigma": None,
             "tolerance": None, "unit": "mm", "status": "fixed"}],
        "rank": 4, "columns": 5,
        "redundant": [{"name": "leg1.offset", "depends_on": {"leg2.offset": -0.5, "frame.x": 1.0}}],
        "iterations": 5, "converged": True,
        "residual": {"before": {"position": figures, "rotation": turn, "closure": gap},
                     "after": {"position": after, "rotation": turn, "closure": gap},
                     "holdout": {"position": {**after, "rms": 0.00655}}},
        "noise": {"sigma_ratio": 1.02, "chi2": 50.5, "degrees": 49.0, "chi2_p": 0.4},
        "excluded": [{"dataset": "run", "row": 3, "reason": "outlier: 7.0 times the noise"}],
        "findings": ["run: 1 of 12 rows left out"],
        "datasets": [{"name": "run", "source": "measurements.csv", "kind": "pose", "rows": 12,
                      "used": 11}],
        "units": {"length": "mm", "angle": "deg"},
        "provenance": {"version": "0.1.0", "command": "ppmcal identify m.yaml", "seed": 4,
                       "inputs": inputs or {}},
    }


def write_fit(folder: Path, record: dict[str, Any], rows: int = 12) -> Path:
    folder.mkdir()
    (folder / "identification.json").write_text(json.dumps(record))
    rng = np.random.default_rng(1)
    columns: dict[str, Any] = {"row": range(1, rows + 1), "dataset": ["run"] * rows}
    for c in ("x", "y", "rz"):
        columns |= {f"before_{c}": rng.normal(0.5, 0.1, rows), f"after_{c}":
                    rng.normal(0.0, 0.005, rows), f"sigma_{c}": [0.005] * rows}
    columns["used"] = [int(i != 2) for i in range(rows)]
    columns["reason"] = ["outlier" if i == 2 else "" for i in range(rows)]
    write_csv(folder / "residuals.csv", columns)
    return folder
