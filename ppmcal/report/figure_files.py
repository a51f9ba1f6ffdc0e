"""The pictures of a diagnosis, of other measurements and of kinematics as files of their own."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

from ppmcal.calibration.fit import pictures_beside
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import headline
from ppmcal.io.results.kinematics import KinematicsRecord
from ppmcal.io.results.validation import ValidatedDataset, ValidationRecord
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.picture import sheet
from ppmcal.plotting.style import png as to_png
from ppmcal.plotting.svg import svg
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.kinematics_figures import drawn_columns, kinematics_figures
from ppmcal.report.validation import drawings, lead

PNG_SCALE = 2.5
"""Pixels of a PNG for one point of the drawing."""
TITLES = {"gap": "How the gap closes", "actuators": "Where it is",
          "inputs": "What the residuals follow",
          "alternatives": "What these data cannot tell apart",
          "terms": "What was learned from the rest",
          "days": "Each session, predicted by a fit of the others",
          "validation": "On other measurements"}


def validation_files(record: ValidationRecord, png: bool = False) -> dict[str, str | bytes]:
    """Return file name -> SVG text, and PNG bytes where wanted, of a validation's pictures."""
    return _sheets(_of_days("validation", record.datasets),
                   f"{record.name or 'ppmcal'}: {lead(record)}", png)


def diagnosis_files(record: DiagnosisRecord, png: bool = False) -> dict[str, str | bytes]:
    """Return file name -> SVG text, and PNG bytes where wanted, of a diagnosis's pictures."""
    return _sheets({**pictures(record), **_of_days("days", record.validation)},
                   f"{record.name or 'ppmcal'}: {headline(record)}", png)


def _of_days(name: str, days: Sequence[ValidatedDataset]) -> dict[str, list[Drawing]]:
    """Return the pictures of predicted data sets under a name, nothing where there are none."""
    found = pictures_beside({name: partial(drawings, days)})
    return {n: drawings for n, drawings in found.items() if drawings}


def kinematics_pictures(record: KinematicsRecord, columns: Mapping[str, Any], name: str
                        ) -> dict[str, bytes]:
    """Return file name -> PNG of a table of kinematics; ``columns``: of kinematics.csv (N,)."""
    found = pictures_beside({"of the path": lambda: kinematics_figures(
        record, drawn_columns(columns))}).get("of the path", {})
    head = f"{name}: {record.which} kinematics"
    return pictures_beside({f"{key}.png": partial(_png, head, drawings)
                            for key, drawings in found.items()})


def _png(title: str, drawings: Sequence[Drawing]) -> bytes:
    return to_png(sheet(title, drawings), dpi=72.0 * PNG_SCALE)


def _svg(name: str, title: str, drawings: Sequence[Drawing]) -> str:
    return svg(sheet(title, drawings), TITLES[name], " ".join(p.description for p in drawings))


def _sheets(found: Mapping[str, Sequence[Drawing]], title: str, png: bool
            ) -> dict[str, str | bytes]:
    makers: dict[str, Callable[[], str | bytes]] = {}
    for name, shown in found.items():
        makers[f"{name}.svg"] = partial(_svg, name, title, shown)
        if png:
            makers[f"{name}.png"] = partial(_png, title, shown)
    return pictures_beside(makers)
