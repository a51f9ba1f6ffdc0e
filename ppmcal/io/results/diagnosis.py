"""diagnosis.json, effects.csv, residuals.csv, model.yaml and next.csv."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppmcal.calibration.model_averaging import Reading
from ppmcal.calibration.validation import residuals
from ppmcal.diagnosis.added_variable_test import probability
from ppmcal.diagnosis.derived_errors import derived
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.plot_data import PlotData, plot_data
from ppmcal.diagnosis.residual_series import Series
from ppmcal.diagnosis.result import Diagnosis, NamedEffect
from ppmcal.io import csv_text, json_text, write_mechanism
from ppmcal.io.measurement_columns import ZERO_CELSIUS
from ppmcal.io.results.identification import residuals_csv
from ppmcal.io.results.identification import summary as identification_summary
from ppmcal.io.results.tables import joint_columns
from ppmcal.linalg import Array
from ppmcal.model.effects import GEOMETRY
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.units import Units


def plot_data_entry(plot_data: PlotData, units: Units) -> dict[str, Any]:
    """Return the entry ``story``: each part has its unit beside it."""
    return {
        "actuators": [{
            "name": a.name, "unit": units.name(a.quantity),
            "rms_before": _number(a.before / units.factor(a.quantity)),
            "rms_after": _number(a.after / units.factor(a.quantity)),
            "noise": _number(a.noise / units.factor(a.quantity))} for a in plot_data.actuators],
        "series": [series_entry(s, units) for s in plot_data.series],
        "ranking": [{"kind": r.kind, "on": list(r.on), "form": r.form,
                     "log10_p": _number(r.log_p / np.log(10.0)),
                     "log10_p_alone": _number(r.log_p_alone / np.log(10.0)), "status": r.status}
                    for r in plot_data.ranking],
        "steps": [{"what": s.what, "kind": s.kind, "on": list(s.on), "rms_ratio": _number(s.ratio)}
                  for s in plot_data.steps],
        "left_out_rows": plot_data.left_out,
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


def files(result: Diagnosis, provenance: Mapping[str, Any], record: Mapping[str, Any]
          ) -> dict[str, str]:
    """Return file name -> text of everything but pictures; ``record`` is :func:`summary`'s."""
    fit = result.identification.fit
    before = residuals(result.before.problem, result.before.state)
    out = {
        "model.yaml": write_mechanism(
            result.identification.mechanism,
            f"diagnosed by ppmcal {provenance.get('version', '')}: {result.verdict}; from "
            + ", ".join(d.name for d in fit.problem.datasets)),
        "effects.csv": effects_csv(result),
        "residuals.csv": residuals_csv(fit, before, result.identification.after),
        "diagnosis.json": json_text(record),
        "identification.json": json_text(identification_summary(
            result.identification, provenance, "prior", True)),
    }
    for name, other in other_files(result):
        what = (f"diagnosed by ppmcal: {other.effect} in place of {other.instead}" if other.effect
                else "fitted by ppmcal without the effects of model.yaml")
        out[name] = write_mechanism(other.mechanism, what)
    if result.proposal.rows:
        out["next.csv"] = next_csv(result)
    return out


def other_files(result: Diagnosis) -> list[tuple[str, Reading]]:
    """Return the other models with the names of their files."""
    return [(f"rival{n}.yaml" if other.effect else "without_effects.yaml", other)
            for n, other in enumerate(result.others, 1)]


def summary(result: Diagnosis, provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return the content of diagnosis.json, numbers in the machine's units."""
    mechanism = result.identification.mechanism
    units = mechanism.units
    gap = result.gap
    left, noise = result.remainder, result.found.last.noise
    return {
        "format": "ppmcal/diagnosis/1",
        "name": mechanism.name,
        "verdict": result.verdict,
        "effects": [effect_entry(result, e) for e in result.effects],
        "possible": [{"kind": c.form.kind, "on": list(c.form.on), "p_value": c.p_value,
                      "survival": c.survival, "status": c.status} for c in result.possible],
        "remainder": {"follows": None if left.p_value >= 0.01 else left.follows,
                      "p_value": left.p_value, "rms_ratio": left.ratio,
                      "noise_reference": left.source, "noise_ratio": left.reference,
                      "by_input": left.by_input},
        "gap": gap_entry(gap) | {"blocks": [{"by": b.by, **gap_entry(b.gap)}
                                            for b in result.blocks]},
        "confirmed": None if gap is None else gap.confirmed,
        "fit": {"before": result.start.ratio, "after": left.ratio,
                "rows": sum(int(k.sum()) for k in result.identification.fit.keep)},
        "noise": {"covariance_ratio": noise.scale, "serial_correlation": noise.rho,
                  "detect_p": float(np.exp(result.found.first.search.detect)),
                  "name_p": float(np.exp(result.found.first.search.name))},
        "localised": [{"by": p.by, "value": p.value, "rms_ratio": p.rms_ratio,
                       "p_value": p.p_value, "rms_ratio_after": p.rms_ratio_after}
                      for p in result.localised],
        "not_testable": [{"kind": u.kind, "missing": list(u.missing), "reason": u.reason}
                         for u in result.untestable],
        "swallowed": [{"name": s.name, "before": s.before / units.factor(s.quantity),
                       "after": s.after / units.factor(s.quantity),
                       "tolerance": s.tolerance / units.factor(s.quantity),
                       "unit": units.name(s.quantity)} for s in result.swallowed],
        "next_measurements": {"reason": result.proposal.reason,
                              "file": "next.csv" if result.proposal.rows else None,
                              "rows": result.proposal.rows,
                              "odds_before": result.proposal.odds_before,
                              "odds_after": result.proposal.odds_after},
        "excluded": [{"dataset": d.name, "row": int(d.rows[n]), "reason": reason}
                     for d, reasons in zip(result.identification.fit.problem.datasets,
                                           result.identification.fit.reasons, strict=True)
                     for n, reason in sorted(reasons.items())],
        "findings": list(result.findings),
        "other_models": [{"file": name, "effect": other.effect, "instead_of": other.instead,
                          "odds": other.odds} for name, other in other_files(result)],
        "story": plot_data_entry(plot_data(result), units),
        "units": {"length": units.length, "angle": units.angle},
        "provenance": dict(provenance),
    }


def effect_entry(result: Diagnosis, effect: NamedEffect) -> dict[str, Any]:
    """Return one effect's entry, file units."""
    return {
        "kind": effect.kind, "on": list(effect.on),
        "parameters": parameter_entries(result, effect), "p_value": effect.p_value,
        "log10_p": effect.log_p / np.log(10.0), "survival": effect.survival,
        "alternatives": [a.split(" on ")[0] for a in effect.alternatives],
        "alternatives_on": list(effect.alternatives), "odds": list(effect.odds),
        **derived_entries(result, effect)}


def gap_entry(gap: Gap | None) -> dict[str, Any]:
    """Return a gap in units of the noise; ``rms_closed``: 1 - rms(after)/rms(before)."""
    if gap is None:
        return {"noise": 1.0, "before": None, "after": None, "closed": None, "rms_closed": None,
                "interval": None, "poses": 0}
    return {"noise": 1.0, "before": gap.before, "after": gap.after, "closed": gap.closed,
            "rms_closed": 1.0 - gap.after / gap.before if gap.before else None,
            "interval": None if gap.interval is None else list(gap.interval), "poses": gap.poses}


def parameter_entries(result: Diagnosis, effect: NamedEffect) -> dict[str, dict[str, Any]]:
    """Return parameter -> value, sigma, unit of one named effect, file units."""
    units = result.identification.mechanism.units
    values = {e.name: e for e in result.identification.estimates}
    out: dict[str, dict[str, Any]] = {}
    for name in effect.parameters:
        e = values[name]
        f = units.factor(e.quantity)
        geometry = effect.kind == GEOMETRY
        short = name if geometry else name.rsplit(".", 1)[1]
        known = e.sigma is not None and np.isfinite(e.sigma)
        out[short] = {"value": (e.error if geometry else e.value) / f,
                      "sigma": (e.sigma or 0.0) / f if known else None,
                      "unit": units.name(e.quantity)}
    return out


def derived_entries(result: Diagnosis, effect: NamedEffect) -> dict[str, Any]:
    """Return ``derived`` (figure -> value, sigma, unit) and where mid-stroke is, file units.

    Empty for kinds of which the parameters say all.
    """
    found = derived(result.identification, effect.parameters)
    if found is None:
        return {}
    units = result.identification.mechanism.units

    def entry(value: float, quantity: str) -> dict[str, Any]:
        return {"value": value / units.factor(quantity), "unit": units.name(quantity)}

    return {"mid_stroke": entry(found.middle, found.quantity), "derived": {
        f.name: {**entry(f.value, f.quantity),
                 "sigma": None if f.sigma is None else f.sigma / units.factor(f.quantity)}
        for f in found.all}}


def effects_csv(result: Diagnosis) -> str:
    """Return effects.csv: one row per candidate, in the order of what became of it.

    ``p_value`` of what is named is that of diagnosis.json, given the others that are named;
    ``p_value_alone`` is before anything was named, for every row.
    """
    mechanism = result.identification.mechanism
    rows = []
    for c in result.candidates:
        smallest, unit = _detectable(mechanism, result, c)
        rows.append([c.form.family, " ".join(c.form.on),
                     "shared" if c.form.shared else "each", c.p_value, c.survival, c.status,
                     "; ".join(c.alternatives), smallest, unit, probability(c.log_p_alone)])
    for u in result.untestable:
        rows.append([u.kind, "", "", np.nan, np.nan, "not testable",
                     f"needs {', '.join(u.missing)}", np.nan, "", np.nan])
    header = ["kind", "on", "form", "p_value", "survival", "status", "alternatives",
              "detectable", "unit", "p_value_alone"]
    return csv_text(header, [[r[i] for r in rows] for i in range(len(header))])


def _detectable(mechanism: Mechanism, result: Diagnosis, candidate: Any) -> tuple[float, str]:
    """Return the smallest value that the data would show, and its unit."""
    from ppmcal.model.effects import effect_kinds
    from ppmcal.model.mechanism import resolved

    if candidate.detectable <= 0.0:
        return np.nan, ""
    if candidate.form.slot:
        p = next(p for p in mechanism.parameters if p.name == candidate.form.slot)
        return candidate.detectable / mechanism.units.factor(p.quantity), mechanism.units.name(
            p.quantity)
    spec = next(s for s in effect_kinds()[candidate.form.kind].parameters(mechanism.motion)
                if s.name == candidate.form.names[0])
    on = candidate.form.on or mechanism.actuators
    joint = mechanism.actuator_quantity[mechanism.actuators.index(on[0])]
    quantity = resolved(spec.quantity, joint)
    value = candidate.detectable
    if spec.reciprocal:
        value = 1.0 / value
    return value / mechanism.units.factor(quantity), mechanism.units.name(quantity)


def next_csv(result: Diagnosis) -> str:
    """Return next.csv: joints, poses and settings of the measurements to take."""
    mechanism = result.identification.mechanism
    proposal = result.proposal
    columns: dict[str, Any] = dict(joint_columns(mechanism, proposal.q, "q_{}"))
    for c in mechanism.dof:
        f = mechanism.units.factor("length" if c < 3 else "angle")
        columns[POSE_COORDINATES[c]] = proposal.pose[:, c] / f
    for name, values in proposal.columns.items():
        if name.startswith("vel_"):
            a = mechanism.actuators.index(name.removeprefix("vel_"))
            values = values / mechanism.joint_units[a][0]
        columns[name] = values - ZERO_CELSIUS if name.startswith("temperature") else values
    return csv_text(list(columns), list(columns.values()))
