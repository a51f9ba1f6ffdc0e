"""tolerances.csv, tolerances.json, errors.csv, allocated.yaml and the picture of yields."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ppmcal.design.error_sources import Source
from ppmcal.design.monte_carlo import Fleet, MachineErrors, MonteCarloErrors
from ppmcal.design.tolerance_allocation import AccuracyCheck, Allocation, Demand, Share, count
from ppmcal.io import csv_text, json_text, write_mechanism
from ppmcal.io.results.tables import pose_columns
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

STAGES = (("built", "as built"), ("registered", "registered only"), ("calibrated", "calibrated"))


@dataclass(frozen=True, eq=False)
class ToleranceResult:
    """Everything that the command found, SI.

    ``machine``: the drawing, its effects left out; ``sources`` (S,); ``allocations`` by method;
    ``chosen``: the method that was verified; ``fleet``, ``judged``, ``check``: of it;
    ``sigma_one``: [LIN]'s mean deviation for an rms error of the accuracy, m;
    ``predicted``: rms position error after calibration by the linear model, m, or None;
    ``notes``: what must be said of the user's task poses.
    """

    machine: Mechanism
    sources: tuple[Source, ...]
    demand: Demand
    allocations: Mapping[str, Allocation]
    chosen: str
    fleet: Fleet
    judged: MonteCarloErrors
    check: AccuracyCheck
    sigma_one: float | None
    predicted: float | None
    notes: tuple[str, ...] = ()

    def stages(self) -> list[tuple[str, str, MachineErrors]]:
        """Return (key, words, errors) of what was simulated."""
        found = [(k, w, getattr(self.judged, k)) for k, w in STAGES]
        return [(k, w, e) for k, w, e in found if e is not None]


def table(r: ToleranceResult) -> dict[str, Any]:
    """Return the columns of tolerances.csv, one row per error, file units; inf: not felt."""
    units = r.machine.units
    parameters = [r.machine.parameters[s.parameter] for s in r.sources]
    unit = np.array([units.factor(p.quantity) for p in parameters])
    out: dict[str, Any] = {
        "name": [p.name for p in parameters], "limb": [s.limb for s in r.sources],
        "slot": [s.group for s in r.sources], "class": [s.tolerance_class for s in r.sources],
        "unit": [units.name(p.quantity) + (" per unit" if p.per_unit else "")
                 for p in parameters]}
    for method in ("file", "mean", "equal", "cost"):
        out[f"tolerance_{method}"] = r.allocations[method].tau / unit
    out["chosen"] = r.allocations[r.chosen].tau / unit
    return out


def errors_table(r: ToleranceResult) -> dict[str, Any]:
    """Return the columns of errors.csv: task poses, rms errors, linear against drawn."""
    length, angle = (r.machine.units.factor(q) for q in ("length", "angle"))
    out: dict[str, Any] = {**pose_columns(r.machine, pose_vector(r.fleet.tasks.motor))}
    out |= {"linear_position": r.check.linear / length, "drawn_position": r.check.drawn / length,
            "drawn_error": r.check.error / length,
            "linear_agrees": ["yes" if a else "no" for a in r.check.agrees]}
    for key, _, errors in r.stages():
        out[f"{key}_position_rms"] = rms(errors.position, 0) / length
        out[f"{key}_position_p95"] = quantile(errors.position, 0.95) / length
        if r.machine.motion != "translational":
            out[f"{key}_rotation_rms"] = rms(errors.rotation, 0) / angle
    return out


def rms(values: Array, axis: int | None = None) -> Array:
    """Return the root mean square of what is known; nan where nothing is."""
    there = np.isfinite(values)
    n = there.sum(axis=axis)
    total = np.where(there, values, 0.0) ** 2
    return np.asarray(np.sqrt(total.sum(axis=axis) / np.where(n > 0, n, np.nan)))


def quantile(values: Array, part: float) -> Array:
    """Return a quantile over machines (T,), poses that a machine cannot reach as inf."""
    ordered = np.sort(np.where(np.isfinite(values), values, np.inf), axis=0)
    return np.asarray(ordered[min(int(np.ceil(part * len(ordered))), len(ordered)) - 1])


def yields(r: ToleranceResult) -> list[dict[str, Any]]:
    """Return the share of machines in specification at every stage."""
    out = []
    for key, words, errors in r.stages():
        share: Share = count(errors, r.demand)
        low, high = share.interval
        there = np.isfinite(errors.position).all(axis=1)
        out.append({"stage": key, "words": words, "in_specification": share.hits,
                    "machines": share.total, "share": share.hits / share.total,
                    "interval": [low, high], "going": int(there.sum()),
                    "position_rms": _known(rms(errors.position), r.machine.units.factor("length")),
                    "rotation_rms": _known(rms(errors.rotation), r.machine.units.factor("angle"))})
    return out


def _known(value: Array, factor: float) -> float | None:
    """Return a number in file units, None where there is none."""
    return float(value) / factor if np.isfinite(value) else None


def allocated(r: ToleranceResult) -> str:
    """Return the machine file with the chosen tolerances; those of errors not felt stay."""
    tau = {s.parameter: float(t) for s, t in
           zip(r.sources, r.allocations[r.chosen].tau, strict=True) if np.isfinite(t)}
    parameters = tuple(replace(p, tolerance=tau[i]) if i in tau else p
                       for i, p in enumerate(r.machine.parameters))
    return write_mechanism(replace(r.machine, parameters=parameters),
                           "Tolerances allocated by ppmcal tolerances; effects left out.")


def files(r: ToleranceResult, content: Mapping[str, Any]) -> dict[str, str | bytes]:
    """Return file name -> content of everything that tolerances writes; see :func:`record`."""
    rows, poses = table(r), errors_table(r)
    out: dict[str, str | bytes] = {
        "tolerances.csv": csv_text(list(rows), list(rows.values())),
        "errors.csv": csv_text(list(poses), list(poses.values())),
        "yield.png": _picture(r),
        "tolerances.json": json_text(content)}
    if r.chosen != "file":
        out["allocated.yaml"] = allocated(r)
    return out


def _picture(r: ToleranceResult) -> bytes:
    """Return the share of machines below every accuracy, by stage."""
    from ppmcal.plotting.curves import draw_curves

    length, unit = r.machine.units.factor("length"), r.machine.units.length
    series = []
    for _, words, errors in r.stages():
        worst = np.where(np.isfinite(errors.position).all(axis=1), errors.position.max(axis=1),
                         np.inf)
        ordered = np.sort(worst) / length
        series.append((words, ordered, np.arange(1, len(ordered) + 1) / len(ordered) * 100.0))
    marks = [] if r.demand.position is None else [(r.demand.position / length, "demanded")]
    return draw_curves("Machines that keep an accuracy at every task pose",
                       f"largest position error of a machine, {unit}", "machines, %", series,
                       True, False, marks)


def record(r: ToleranceResult, said: Sequence[str], findings: Sequence[str],
           provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return tolerances.json."""
    units = r.machine.units
    length, angle = units.factor("length"), units.factor("angle")
    d = r.demand
    found = yields(r)
    rows = [[y["words"], f"{y['in_specification']} of {y['machines']}", y["share"],
             y["interval"][0], y["interval"][1], y["position_rms"]] for y in found]
    costs = [(m, None if not np.isfinite(a.cost) else a.cost) for m, a in r.allocations.items()]
    return {
        "format": "ppmcal/tolerances/1", "name": r.machine.name, "said": list(said),
        "units": {"position": units.length, "rotation": units.angle,
                  "position_rms": units.length, "rotation_rms": units.angle},
        "findings": list(findings),
        "demand": {"position": None if d.position is None else d.position / length,
                   "rotation": None if d.rotation is None else d.rotation / angle,
                   "share": d.share},
        "method": r.chosen, "yield": found,
        "costs": dict(costs), "errors": len(r.sources),
        "mean_deviation": None if r.sigma_one is None else r.sigma_one / length,
        "linear": {"poses": len(r.check.agrees), "agree": int(r.check.agrees.sum()),
                   "calibrated_predicted": None if r.predicted is None else r.predicted / length},
        "tables": [
            {"title": "Machines in specification", "rows": rows, "note":
             "intervals: Clopper-Pearson, 95 %; every task pose must be within the accuracy",
             "columns": ["stage", "machines", "share", "from", "to", f"rms, {units.length}"]},
            _class_table(r),
            {"title": "Cost", "columns": ["method", "cost"], "rows": costs, "note": ""}],
        "pictures": {"yield.png": "Share of machines below every accuracy"},
        "provenance": dict(provenance)}


def _class_table(r: ToleranceResult) -> dict[str, Any]:
    """Return the range of tolerances by slot and method."""
    columns = table(r)
    rows = []
    keys = list(zip(columns["slot"], columns["unit"], strict=True))
    for group, unit in dict.fromkeys(keys):
        mine = np.array([k == (group, unit) for k in keys])
        row: list[Any] = [group, int(mine.sum()), unit]
        for method in ("file", "mean", "equal", "cost"):
            values = columns[f"tolerance_{method}"][mine]
            values = values[np.isfinite(values)]
            row.append(float(np.median(values)) if values.size else None)
        rows.append(row)
    return {"title": "Tolerances by slot, medians (one standard deviation)", "rows": rows,
            "columns": ["slot", "errors", "unit", "file", "mean", "equal", "cost"],
            "note": "empty: the tool does not feel it; all are in tolerances.csv"}
