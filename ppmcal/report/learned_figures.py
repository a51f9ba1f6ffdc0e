"""Each learned shape with its 95 % band over what single rows say of it."""

from __future__ import annotations

import numpy as np

from ppmcal.calibration.fit import Z95
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import learned_name
from ppmcal.io.results.learned_parts import LearnedEntry
from ppmcal.linalg import Array
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Between, Marks, Polyline, Zero
from ppmcal.plotting.plot import Plot, span
from ppmcal.report.diagnosis_format import INPUTS, finer
from ppmcal.report.format import number, sig, with_label

SHOWN = 0.99
"""This part of the rows is within the axis; the others are drawn at its edge."""


def term_pictures(record: DiagnosisRecord) -> list[Drawing]:
    """Return one picture for each shape that was learned."""
    found = [_picture(record, e) for e in record.learned]
    return [p for p in found if p is not None]


def _columns(*columns: tuple[float | None, ...]) -> Array | None:
    """Return columns of numbers (c, n), None where there are none or they are not alike."""
    table = [[np.nan if (n := number(v)) is None else n for v in c] for c in columns]
    if len({len(c) for c in table}) != 1 or len(table[0]) < 2:
        return None
    found = np.array(table)
    return found if np.isfinite(found).all() else None


def _picture(record: DiagnosisRecord, entry: LearnedEntry) -> Drawing | None:
    curve, rows = _columns(entry.x, entry.value, entry.sigma), _columns(entry.at, entry.partial)
    if curve is None or rows is None:
        return None
    half = (record.coverage or Z95) * curve[2]
    factor, unit = finer(entry.unit, float(np.max(np.abs(curve[1]) + half)))
    ends = factor * np.quantile(rows[1], [1.0 - SHOWN, SHOWN])
    up = span(np.concatenate([ends, factor * (curve[1] - half), factor * (curve[1] + half)]))
    other = _columns(entry.x, entry.other) if entry.by_ends else None
    both = [] if other is None else [Polyline(
        other[0], factor * other[1],
        f"learned, {entry.by} = {sig(entry.by_ends[0], 4)} {entry.by_unit}")]
    at = "" if other is None else f" Two lines: {entry.by} = " + " and ".join(
        f"{sig(e, 4)} {entry.by_unit}" for e in entry.by_ends) + "; the band is the second one's."
    what = "joint" if entry.on else entry.acts
    name = learned_name(record, entry)
    return Plot(
        span(curve[0], margin=0.02), up,
        (with_label(INPUTS.get(entry.input, entry.input), entry.input_unit),
         with_label(f"error of {what}", unit)),
        [Zero(), Marks(rows[0], factor * rows[1], "before", "o", 3.0),
         Between(curve[0], factor * (curve[1] - half), factor * (curve[1] + half)),
         Polyline(curve[0], factor * curve[1], "what was learned"), *both],
        (entry.input_unit, unit)).drawing(
        f"Learned: {name}",
        "Line: what was learned, with its 95 % band; rings: what single rows say of it, all else "
        f"taken out. It is a shape, not a cause; nothing is known beyond the ends.{at}",
        f"{name}: {number(entry.rms)} {entry.unit} rms.")
