"""The data of a diagnosis's pictures as diagnosis.json holds them, in the machine's units."""

from __future__ import annotations

from typing import Any

import numpy as np

from ppmcal.diagnosis.plot_data import Story
from ppmcal.diagnosis.residual_series import Series
from ppmcal.linalg import Array
from ppmcal.units import Units


def story_entry(story: Story, units: Units) -> dict[str, Any]:
    """Return the entry ``story``: each part has its unit beside it."""
    return {
        "actuators": [{
            "name": a.name, "unit": units.name(a.quantity),
            "rms_before": _number(a.before / units.factor(a.quantity)),
            "rms_after": _number(a.after / units.factor(a.quantity)),
            "noise": _number(a.noise / units.factor(a.quantity))} for a in story.actuators],
        "series": [series_entry(s, units) for s in story.series],
        "ranking": [{"kind": r.kind, "on": list(r.on), "form": r.form,
                     "log10_p": _number(r.log_p / np.log(10.0)),
                     "log10_p_alone": _number(r.log_p_alone / np.log(10.0)), "status": r.status}
                    for r in story.ranking],
        "steps": [{"what": s.what, "kind": s.kind, "on": list(s.on), "rms_ratio": _number(s.ratio)}
                  for s in story.steps],
        "left_out_rows": story.left_out,
    }


def series_entry(s: Series, units: Units) -> dict[str, Any]:
    """Return one series: bins of an input with mean error and half its 95 % interval."""
    bins, f = s.bins, units.factor(s.quantity)
    per = units.factor(s.input_quantity) if s.input_quantity not in ("", "deg C") else 1.0
    unit = units.name(s.input_quantity) if s.input_quantity else ""
    return {
        "effect": s.effect, "role": s.role, "on": list(s.on), "coordinate": s.coordinate,
        "input": s.input, "which": s.which, "input_unit": unit, "unit": units.name(s.quantity),
        "period": _number(s.period / per) if s.period else None,
        "x": _rounded(bins.x / per), "names": list(bins.names), "count": bins.count.tolist(),
        "before": _rounded(bins.before / f), "before_95": _rounded(bins.before_half / f),
        "after": _rounded(bins.after / f), "after_95": _rounded(bins.after_half / f)}


def _rounded(values: Array) -> list[float]:
    return [_number(float(v)) for v in values]


def _number(value: float) -> float:
    """Return a number with six digits: enough for a picture."""
    return float(f"{value:.6g}")
