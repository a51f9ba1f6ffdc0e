"""identification.json, parameters.csv, residuals.csv and identified.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppmcal.calibration.fit import Fit
from ppmcal.calibration.observation import labels
from ppmcal.calibration.posterior import of_data
from ppmcal.calibration.problem import Problem, State
from ppmcal.calibration.summary import Estimate, Identification
from ppmcal.calibration.validation import Residuals
from ppmcal.io import csv_text, json_text, write_mechanism
from ppmcal.io.results.identifiability import entry as untold_entry
from ppmcal.io.results.identifiability import flat_entries
from ppmcal.io.results.outliers import entry as blunder_entry
from ppmcal.io.results.units import column_factor
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.model.mechanism import POSE_COORDINATES, Registration
from ppmcal.units import Units

CORRELATED = 0.95


def files(result: Identification, provenance: Mapping[str, Any], method: str) -> dict[str, str]:
    """Return file name -> text of everything that identify writes."""
    return {
        "identified.yaml": write_mechanism(
            result.mechanism, f"identified by ppmcal {provenance.get('version', '')} from "
            + ", ".join(d.name for d in result.fit.problem.datasets)),
        "parameters.csv": parameters_csv(result),
        "residuals.csv": residuals_csv(result.fit, result.before, result.after),
        "identification.json": json_text(summary(result, provenance, method, True)),
    }


def summary(result: Identification, provenance: Mapping[str, Any], method: str,
            covariance: bool) -> dict[str, Any]:
    """Return the content of identification.json; without ``covariance`` the short form."""
    units = result.mechanism.units
    fit = result.fit
    out: dict[str, Any] = {
        "format": "ppmcal/identification/1",
        "name": result.mechanism.name,
        "method": method,
        "parameters": [parameter(e, units) for e in result.estimates],
        "rank": result.rank,
        "columns": len(result.columns),
        "redundant": [{"name": d.name, "depends_on": {
            n: v * _column_factor(result, n) ** -1 * _column_factor(result, d.name)
            for n, v in d.depends_on.items()}} for d in result.redundant],
        "iterations": fit.iterations,
        "converged": fit.converged,
        "prior_scale": fit.prior_scale,
        "residual": {
            "before": figures(result.before.figures(fit.keep), units),
            "after": figures(result.after.figures(fit.keep), units),
            "holdout": figures(result.holdout, units),
        },
        "unexplained": figures({k: {"rms": v} for k, v in result.unexplained.items()}, units),
        "holdout_note": result.holdout_note,
        "noise": {
            "sigma_ratio": result.noise.sigma_ratio, "chi2": result.noise.chi2,
            "degrees": result.noise.degrees, "chi2_p": result.noise.chi2_p,
            "repeat_ratio": result.noise.repeat_ratio,
            "repeat_degrees": result.noise.repeat_degrees,
            "by_dataset": dict(result.noise.by_dataset),
        },
        "observability": dict(result.observability),
        "correlations": correlations(result),
        "flats": flat_entries(result.flats, result.mechanism),
        "blunders": blunder_entry(result.blunders, result.mechanism),
        "untold": untold_entry(result.identifiability, result.mechanism),
        "excluded": [
            {"dataset": d.name, "row": int(d.rows[n]), "reason": reason}
            for d, reasons in zip(fit.problem.datasets, fit.reasons, strict=True)
            for n, reason in sorted(reasons.items())] + [
            {"dataset": d.name, "row": row, "reason": reason}
            for d in fit.problem.datasets for row, reason in d.dropped],
        "findings": list(result.findings),
        "datasets": [{"name": d.name, "source": d.source, "kind": d.kind, "rows": len(d),
                      "used": int(k.sum()),
                      "registration": registration(result.mechanism.registrations[d.name], units),
                      "registration_before": registration(result.before_registrations[d.name],
                                                          units)}
                     for d, k in zip(fit.problem.datasets, fit.keep, strict=True)],
        "units": {"length": units.length, "angle": units.angle},
        "measured_volume": _volume(result),
        "provenance": dict(provenance),
    }
    if result.earlier is not None:
        out["earlier"] = dict(result.earlier.inputs)
    if covariance:
        out["covariance"] = covariance_entry(result)
    return out


def parameter(e: Estimate, units: Units) -> dict[str, Any]:
    """Return one parameter's entry, file units."""
    f = units.factor(e.quantity)
    low, high = e.interval or (None, None)
    return {
        "name": e.name, "nominal": e.nominal / f, "value": e.value / f, "error": e.error / f,
        "sigma": _over(e.sigma, f), "sigma_data": _over(e.sigma_data, f),
        "low": _over(low, f), "high": _over(high, f), "tolerance": _over(e.tolerance, f),
        "unit": units.name(e.quantity) + ("/unit" if e.per_unit else ""), "status": e.status,
        "of_tolerance": of_tolerance(e)}


def of_tolerance(e: Estimate) -> float | None:
    """Return the standard deviation after the fit over that before it, None without a prior."""
    if e.sigma is None or not e.tolerance or not np.isfinite(e.tolerance):
        return None
    return e.sigma / e.tolerance


def _over(value: float | None, factor: float) -> float | None:
    return None if value is None or not np.isfinite(value) else value / factor


def figures(values: Mapping[str, Mapping[str, float]], units: Units) -> dict[str, Any]:
    """Return error figures in file units, each with its unit."""
    out: dict[str, Any] = {}
    for name, parts in values.items():
        quantity = "angle" if name == "rotation" else "length"
        f = units.factor(quantity)
        out[name] = {**{k: v / f for k, v in parts.items()}, "unit": units.name(quantity)}
    return out


def _column_factor(result: Identification, name: str) -> float:
    """SI value of one file unit of a column."""
    return column_factor(result.mechanism, name)


def correlations(result: Identification) -> list[dict[str, Any]]:
    """Return the strongly correlated pairs of parameters, strongest first, at most 50."""
    count = len(result.fit.problem.free)
    c = result.covariance[:count, :count]
    sigma = np.sqrt(np.maximum(np.diagonal(c), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.triu(c / np.outer(sigma, sigma), 1)
    strong = np.argwhere(np.abs(np.nan_to_num(r)) > CORRELATED).tolist()
    pairs = sorted(strong, key=lambda p: -abs(r[p[0], p[1]]))[:50]
    return [{"a": result.columns[i], "b": result.columns[j], "value": float(r[i, j])}
            for i, j in pairs]


def covariance_entry(result: Identification) -> dict[str, Any]:
    """Return the covariance of all columns in file units, and what its frames turn about."""
    f = np.array([_column_factor(result, n) for n in result.columns])
    length = result.mechanism.units.factor("length")
    problem = result.fit.problem
    tau = [float(1.0 / w) if w > 0.0 else None for w in result.fit.prior.tolist()]
    return {"names": list(result.columns),
            "prior": [_over(t, u) for t, u in zip(tau, f.tolist(), strict=True)],
            "inflation": result.fit.noise,
            "data": _data_entry(result.fit, f),
            "matrix": (result.covariance / np.outer(f, f)).tolist(),
            "frames_turn_about": {d.name: (o.about / length).tolist() for d, o in
                                  zip(problem.datasets, problem.opens, strict=True)}}


def _data_entry(fit: Fit, factor: Array) -> dict[str, Any]:
    """Return what the data alone say of steps of the parameters, file units.

    White by the stated noise, as ``inflation`` beside it is a factor on that.
    """
    count = len(fit.problem.free)
    matrix, right = of_data(fit.reduced.triangle, fit.reduced.right, count, fit.scale[:count])
    return {"matrix": (matrix * factor[:count] * fit.noise).tolist(),
            "right": (right * fit.noise).tolist(),
            "unit_of_parameters": (fit.scale[:count] / factor[:count]).tolist()}


def registration(r: Registration, units: Units) -> dict[str, list[float]]:
    """Return frame (6), target (3) and target rotation (3) in file units."""
    length, angle = units.factor("length"), units.factor("angle")
    return {"frame": [*(r.frame[:3] / length).tolist(), *(r.frame[3:] / angle).tolist()],
            "target": (r.target / length).tolist(),
            "target_rotation": (r.target_rotation / angle).tolist()}


def _volume(result: Identification) -> dict[str, list[float]]:
    """Range of the platform poses that were measured, base frame, file units."""
    units = result.mechanism.units
    state: State = result.fit.state
    poses = np.concatenate([p[k].reshape(-1, 8)    # a distance has two platform positions
                            for p, k in zip(state.poses, result.fit.keep, strict=True)])
    full = pose_vector(poses)
    out = {}
    for c in result.mechanism.dof:
        f = units.factor("length" if c < 3 else "angle")
        out[POSE_COORDINATES[c]] = [float(full[:, c].min() / f), float(full[:, c].max() / f)]
    return out


def parameters_csv(result: Identification) -> str:
    """Return parameters.csv."""
    rows = [parameter(e, result.mechanism.units) for e in result.estimates]
    header = ["name", "nominal", "value", "error", "sigma", "sigma_data",
              "tolerance", "unit", "status"]
    return csv_text(header, [[r[h] for r in rows] for h in header])


def residuals_csv(fit: Fit, before: Residuals, after: Residuals) -> str:
    """Return residuals.csv: one line per input row, data set by data set.

    Rows that held nothing usable come last, with their reason.
    """
    problem: Problem = fit.problem
    units, motion = problem.mechanism.units, problem.mechanism.motion
    used = {label for d in problem.datasets for label in labels(d, motion)}
    used_labels = [label for label in (*POSE_COORDINATES, "height", "distance") if label in used]
    dropped = [(d.name, row, reason) for d in problem.datasets for row, reason in d.dropped]
    total = sum(len(d) for d in problem.datasets) + len(dropped)
    header = ["row", "dataset"]
    columns: list[Any] = [
        [*(int(n) for d in problem.datasets for n in d.rows), *(row for _, row, _ in dropped)],
        [*(d.name for d in problem.datasets for _ in range(len(d))), *(n for n, _, _ in dropped)]]
    for name in used_labels:
        f = units.factor("angle" if name in POSE_COORDINATES[3:] else "length")
        for label, source in (("before", before.vector), ("after", after.vector),
                              ("sigma", after.sigma)):
            values = np.full(total, np.nan)
            at = 0
            for d, v in zip(problem.datasets, source, strict=True):
                shown = labels(d, motion)
                if name in shown:
                    values[at:at + len(d)] = v[:, shown.index(name)] / f
                at += len(d)
            header.append(f"{label}_{name}")
            columns.append(values)
    header += ["used", "reason"]
    columns.append([*(int(u) for k in fit.keep for u in k), *(0 for _ in dropped)])
    columns.append([*(r.get(n, "") for r, d in
                      zip(fit.reasons, problem.datasets, strict=True)
                      for n in range(len(d))), *(reason for _, _, reason in dropped)])
    return csv_text(header, columns)
