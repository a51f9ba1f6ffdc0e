"""Tables of a diagnosis: the gap step by step, what was tried, the poses to measure next."""

from __future__ import annotations

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.report.diagnosis_figures import step_name
from ppmcal.report.format import number, sig, whole
from ppmcal.report.html import csv_cell, number_cell, paragraph, table, text_cell
from ppmcal.wording import actuator_list

TRIED = 60
"""Hypotheses that are shown, the likeliest; effects.csv has them all."""
LEAST = 0.001
"""Probabilities below this are not told apart."""
POSES = 30
"""Poses to measure next that are shown; the file has them all."""


def ladder(record: DiagnosisRecord) -> str:
    """Return the gap from nominal through geometry and each effect down to the noise.

    A step's share is of the squares that exceed the noise, as effects add in squares.
    """
    steps = [(s, value) for s in record.plot_data.steps
             if (value := number(s.rms_ratio)) is not None]
    if len(steps) < 2:
        return ""
    excess = [max(v**2 - 1.0, 0.0) for _, v in steps]
    fitted = next((e for (s, _), e in zip(steps, excess, strict=True) if s.what == "geometry"),
                  0.0)
    rows = []
    for n, (step, value) in enumerate(steps):
        gone = excess[n - 1] - excess[n] if n else None
        rows.append([text_cell(step_name(record, step)), number_cell(value, f"{sig(value)} ×"),
                     number_cell(gone, _share(gone, excess[0])),
                     number_cell(gone, _share(gone, fitted) if step.what == "effect" else "–")])
    return table("The gap, step by step", [
        "the model", "residuals over noise, rms", "closes of the whole gap",
        "of what geometry leaves"], rows) + paragraph(
        "Shares are of the squares beyond the noise.", "note")


def _share(gone: float | None, whole_gap: float) -> str:
    if gone is None or not whole_gap > 0.0:
        return "–"
    part = gone / whole_gap
    decimals = 1 if abs(part) < 0.1 or 0.99 <= part < 0.9995 else 0
    return f"{100.0 * part:.{decimals}f} %".replace("-", "−")


def tried(effects: Table | None) -> str:
    """Return the strongest hypotheses of effects.csv with what became of them."""
    if effects is None or not effects.size:
        return ""
    p = effects.number("probability")
    order = np.argsort(np.where(np.isfinite(p), -p, np.inf), kind="stable")[:TRIED]
    names, on, form, status = (effects.words(c) for c in ("kind", "on", "form", "status"))
    total = len({a for text in on for a in text.split()})
    rows = [[text_cell(names[i]), text_cell(actuator_list(on[i].split(), total) or "machine"),
             text_cell(form[i]), number_cell(float(p[i]), sig(float(p[i]), 2) if p[i] >= LEAST else
                                             f"< {LEAST:g}" if p[i] >= 0.0 else "–"),
             text_cell(status[i])] for i in order]
    more = f"; the first {TRIED} of {whole(effects.size)}" if effects.size > TRIED else ""
    return table(f"Every hypothesis, the likeliest first{more}; effects.csv has them all",
                 ["effect", "on", "values", "probability", "what became of it"], rows, sort=True)


def next_poses(poses: Table | None) -> str:
    """Return the first poses of next.csv."""
    if poses is None or not poses.size:
        return ""
    rows = [[csv_cell(_cell(poses, h, i)) for h in poses.header]
            for i in range(min(poses.size, POSES))]
    more = (f"The first {POSES} of {whole(poses.size)} rows; next.csv has them all"
            if poses.size > POSES else "next.csv")
    return table(more, poses.header, rows)


def _cell(table_: Table, name: str, row: int) -> str:
    if name in table_.text:
        return table_.text[name][row]
    value = float(table_.numbers[name][row])
    return "" if np.isnan(value) else f"{value:.10g}"
