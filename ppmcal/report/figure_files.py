"""The pictures of a diagnosis as files of their own."""

from __future__ import annotations

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import headline
from ppmcal.plotting.canvas import sheet
from ppmcal.plotting.style import png as to_png
from ppmcal.plotting.svg import svg
from ppmcal.report.diagnosis_figures import pictures

PNG_SCALE = 2.5
"""Pixels of a PNG for one point of the drawing."""
TITLES = {"gap": "How the gap closes", "ranking": "What could be missing",
          "actuators": "Where it is", "inputs": "What the residuals follow",
          "alternatives": "What these data cannot tell apart",
          "terms": "What was learned from the rest"}


def diagnosis_files(record: DiagnosisRecord, png: bool = False) -> dict[str, str | bytes]:
    """Return file name -> SVG text, and PNG bytes where wanted, of a diagnosis's pictures."""
    out: dict[str, str | bytes] = {}
    for name, drawings in pictures(record).items():
        drawn = sheet(f"{record.name or 'ppmcal'}: {headline(record)}", drawings)
        out[f"{name}.svg"] = svg(drawn, TITLES[name], " ".join(p.description for p in drawings))
        if png:
            out[f"{name}.png"] = to_png(drawn, dpi=72.0 * PNG_SCALE)
    return out
