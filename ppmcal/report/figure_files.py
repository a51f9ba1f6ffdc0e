"""The pictures of a diagnosis, of other measurements and of kinematics as files of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import headline
from ppmcal.io.results.kinematics import KinematicsRecord
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.plotting.canvas import Drawing, sheet
from ppmcal.plotting.style import png as to_png
from ppmcal.plotting.svg import svg
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.kinematics_figures import kinematics_figures
from ppmcal.report.kinematics_motion import drawn_columns
from ppmcal.report.validation import lead, picture

PNG_SCALE = 2.5
"""Pixels of a PNG for one point of the drawing."""
TITLES = {"gap": "How the gap closes", "ranking": "What could be missing",
          "actuators": "Where it is", "inputs": "What the residuals follow",
          "alternatives": "What these data cannot tell apart",
          "terms": "What was learned from the rest",
          "days": "Each session, predicted by a fit of the others",
          "validation": "On other measurements"}


def validation_files(record: ValidationRecord, png: bool = False) -> dict[str, str | bytes]:
    """Return file name -> SVG text, and PNG bytes where wanted, of a validation's pictures."""
    drawings = [p for d in record.datasets if (p := picture(d)) is not None]
    return _sheets({"validation": drawings} if drawings else {},
                   f"{record.name or 'ppmcal'}: {lead(record)}", png)


def diagnosis_files(record: DiagnosisRecord, png: bool = False) -> dict[str, str | bytes]:
    """Return file name -> SVG text, and PNG bytes where wanted, of a diagnosis's pictures."""
    days = [p for d in record.validation if (p := picture(d)) is not None]
    return _sheets({**pictures(record), **({"days": days} if days else {})},
                   f"{record.name or 'ppmcal'}: {headline(record)}", png)


def kinematics_pictures(record: KinematicsRecord, columns: Mapping[str, Any], name: str
                        ) -> dict[str, bytes]:
    """Return file name -> PNG of a table of kinematics; ``columns``: of kinematics.csv (N,)."""
    found = kinematics_figures(record, drawn_columns(columns))
    head = f"{name}: {record.which} kinematics"
    return {f"{key}.png": to_png(sheet(head, drawings), dpi=72.0 * PNG_SCALE)
            for key, drawings in found.items()}


def _sheets(found: Mapping[str, Sequence[Drawing]], title: str, png: bool
            ) -> dict[str, str | bytes]:
    out: dict[str, str | bytes] = {}
    for name, drawings in found.items():
        drawn = sheet(title, drawings)
        out[f"{name}.svg"] = svg(drawn, TITLES[name], " ".join(p.description for p in drawings))
        if png:
            out[f"{name}.png"] = to_png(drawn, dpi=72.0 * PNG_SCALE)
    return out
