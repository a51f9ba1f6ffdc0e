"""Numbers of a diagnosis as people like to read them, and its tables: gap, tried, next poses."""

from __future__ import annotations

import math

import numpy as np

from ppmcal.diagnosis.plot_data import SelectionStep
from ppmcal.io.csv import Table
from ppmcal.io.results.diagnosis import DiagnosisRecord, gap_steps
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect
from ppmcal.io.results.diagnosis_wording import name_of, onset
from ppmcal.model.effects import effect_kinds
from ppmcal.report.html import (
    count,
    csv_cell,
    number,
    number_cell,
    paragraph,
    sig,
    table,
    text_cell,
    to_sigma,
    whole,
    with_unit,
)
from ppmcal.wording import actuator_list, rate

INPUTS = {
    "direction": "direction of approach (+: joint increasing)", "load": "load on the joint",
    "wound load": "load on the joint, its sign that of the approach",
    "temperature": "temperature", "time": "time since the first row", "velocity": "joint velocity",
    "last move": "move from the row before",
    "travel": "joint position", "phase": "joint position within one period",
    "wrench": "load on the platform", "pose": "platform", "point": "measured",
}
"""Names of inputs in diagnosis.json -> words."""
_FINER = {"m": ((1e-4, 1e6, "µm"), (0.1, 1e3, "mm")), "mm": ((0.1, 1e3, "µm"),),
          "deg": ((0.1, 3600.0, "arcsec"),), "rad": ((1e-4, 1e6, "µrad"), (0.1, 1e3, "mrad")),
          "s": ()}
_NAMES = {"deg C": "°C", "um": "µm"}


def left_out(record: DiagnosisRecord) -> str:
    """Return that rows are plotted which the fit has left out, empty where none are."""
    n = record.plot_data.left_out_rows
    return f"With {count(n, 'row')} that the fit took for outliers." if n else ""


def finer(unit: str, largest: float) -> tuple[float, str]:
    """Return factor and name of the unit in which a number of that size is easy to read."""
    for limit, factor, name in _FINER.get(unit, ()):
        if largest < limit:
            return factor, name
    if unit == "s" and largest > 7200.0:
        return 1.0 / 3600.0, "h"
    if unit == "s" and largest > 600.0:
        return 1.0 / 60.0, "min"
    return 1.0, _NAMES.get(unit, unit)


def power(log10: float) -> str:
    """Return a power of ten."""
    return "10" + str(round(log10)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def odds_to(odds: float) -> str:
    """Return the first of odds to one: ``2.8``, ``48 000``, ``> 10⁶``."""
    if odds >= 1e6:
        return "> 10⁶"
    return sig(odds, 2) if odds < 100.0 else whole(int(float(f"{odds:.1e}")))


def amounts(effect: DiagnosedEffect) -> list[tuple[str, str]]:
    """Return (parameter, value with its 95 % interval and unit) of a named effect.

    Before the parameters comes the row of an event, without a name; behind them the figures that
    follow from them, ``phase at mid-stroke`` say.
    """
    kind, when = effect_kinds().get(effect.kind), onset(effect)
    out = [("", when)] if when else []
    derived = {n.replace("_mid_stroke", " at mid-stroke"): v for n, v in effect.derived.items()}
    for name, v in {**effect.parameters, **derived}.items():
        value, half = number(v.value), number(v.half)
        if value is None or (when and kind is not None and name == kind.onset):
            continue
        factor, unit = rate(v.unit, value)
        value, half = value * factor, None if half is None else half * factor
        text = sig(value, 4) if half is None or half <= 0.0 else _interval(value, half)
        out.append((name, f"{text} {_NAMES.get(unit, unit) or '(no unit)'}"))
    return out


def _interval(value: float, half: float) -> str:
    """Return ``0.0303 ± 0.0013``, with a common power of ten where numbers are tiny."""
    if 0.0 < max(abs(value), half) < 1e-3:
        exponent = -6 if max(abs(value), half) >= 1e-7 else -9
        scale = 10.0**-exponent
        return (f"({to_sigma(value * scale, half * scale)} ± {sig(half * scale, 2)})"
                f"·{power(exponent)}")
    if max(abs(value), half) >= 1e5:
        return f"{sig(value, 4)} ± {sig(half, 2)}"
    if half >= 100.0:  # no more digits than the interval deserves
        ten = 10.0 ** (math.floor(math.log10(half)) - 1)
        value, half = round(value / ten) * ten, round(half / ten) * ten
    return f"{to_sigma(value, half)} ± {sig(half, 2)}"


def in_unit(value: float | None, unit: str) -> str:
    """Return a number with its unit in plain letters."""
    return with_unit(value, _NAMES.get(unit, unit))


TRIED = 60
"""Hypotheses that are shown, the likeliest; effects.csv has them all."""
LEAST = 0.001
"""Probabilities below this are not told apart, nor those as near to 1."""
POSES = 30
"""Poses to measure next that are shown; the file has them all."""


def step_name(record: DiagnosisRecord, step: SelectionStep) -> str:
    """Return what one step adds to the model."""
    if step.what == "start":
        return "machine as in its file, only frames fitted"
    if step.what == "geometry":
        return "+ geometry identified"
    return "+ " + name_of(record, step.kind, step.on)


def ladder(record: DiagnosisRecord) -> str:
    """Return the gap from nominal through geometry and each effect down to the noise."""
    steps = gap_steps(record.plot_data.steps)
    if len(steps) < 2:
        return ""
    rows = [[text_cell(step_name(record, s.step)), number_cell(s.ratio, f"{sig(s.ratio)} ×"),
             number_cell(s.of_whole, _share(s.of_whole)),
             number_cell(s.of_geometry, _share(s.of_geometry))] for s in steps]
    return table("The gap, step by step", [
        "the model", "residuals over noise, rms", "closes of the whole gap",
        "of what geometry leaves"], rows) + paragraph(
        "Shares are of the squares beyond the noise.", "note")


def _share(part: float | None) -> str:
    if part is None:
        return "–"
    decimals = 1 if abs(part) < 0.1 or 0.99 <= part < 0.9995 else 0
    return f"{100.0 * part:.{decimals}f} %".replace("-", "−")


def _chance(p: float) -> str:
    if p > 1.0 - LEAST:
        return f"> {1.0 - LEAST:g}"
    return sig(p, 2) if p >= LEAST else f"< {LEAST:g}" if p >= 0.0 else "–"


def tried(effects: Table | None) -> str:
    """Return the strongest hypotheses of effects.csv with what became of them."""
    if effects is None or not effects.size:
        return ""
    p = effects.number("probability")
    order = np.argsort(np.where(np.isfinite(p), -p, np.inf), kind="stable")[:TRIED]
    names, on, form, status = (effects.words(c) for c in ("kind", "on", "form", "status"))
    total = len({a for text in on for a in text.split()})
    rows = [[text_cell(names[i]), text_cell(actuator_list(on[i].split(), total) or "machine"),
             text_cell(form[i]), number_cell(float(p[i]), _chance(float(p[i]))),
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
