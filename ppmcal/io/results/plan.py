"""poses.csv, accuracy.csv, plan.json and the picture of a measuring plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.design.plan.result import Plan
from ppmcal.io import csv_text, json_text
from ppmcal.io.measurement_columns import ZERO_CELSIUS
from ppmcal.io.results.plan_wording import findings, said
from ppmcal.io.results.tables import joint_columns, pose_columns, unit_map
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism

PICTURE = "accuracy.png"
DIGITS = 4


def files(plan: Plan, wanted: float | None, notes: Sequence[str], provenance: Mapping[str, Any]
          ) -> dict[str, str | bytes]:
    """Return file name -> content of everything that plan writes, in the machine's units."""
    poses, curves = pose_table(plan), accuracy_table(plan)
    return {"poses.csv": csv_text(list(poses), list(poses.values())),
            "accuracy.csv": csv_text(list(curves), list(curves.values())),
            PICTURE: picture(plan, wanted),
            "plan.json": json_text(record(plan, wanted, notes, provenance))}


def pose_table(plan: Plan) -> dict[str, Any]:
    """Return poses.csv: one row per measurement, in the order of the route."""
    mechanism, pool = plan.mechanism, plan.pool
    at = plan.offer.pose[plan.rows]
    # poses are numbered as they are come to
    numbers = {p: i + 1 for i, p in enumerate(dict.fromkeys(at.tolist()))}
    table: dict[str, Any] = {"pose": np.array([numbers[p] for p in at.tolist()])}
    table |= joint_columns(mechanism, pool.q[at], "q_{}")
    table |= pose_columns(mechanism, pool.pose[at])
    for name, (factor, _) in zip(mechanism.actuators, mechanism.joint_units, strict=True):
        if f"dir_{name}" in plan.columns:
            table[f"dir_{name}"] = plan.columns[f"dir_{name}"].astype(int)
        if f"vel_{name}" in plan.columns:
            table[f"vel_{name}"] = plan.columns[f"vel_{name}"] / factor
    if "payload" in plan.columns:
        table["payload"] = plan.columns["payload"]
    if "temperature" in plan.columns:
        table["temperature"] = np.round(plan.columns["temperature"] - ZERO_CELSIUS, 9)
    table |= {"travel": plan.way.travel, "via": list(plan.way.via),
              "condition": pool.condition[at], "gain": plan.gain}
    order = [n for n in table if n[:4] not in ("dir_", "vel_")]
    head = order.index("travel") - ("payload" in table) - ("temperature" in table)
    middle = [n for n in table if n.startswith("dir_")] + [n for n in table
                                                           if n.startswith("vel_")]
    return {n: table[n] for n in [*order[:head], *middle, *order[head:]]}


def accuracy_table(plan: Plan) -> dict[str, Any]:
    """Return accuracy.csv: standard deviations at the tasks against the number of rows."""
    units = plan.mechanism.units
    n = np.arange(plan.least, len(plan.planned.position) + 1)
    out: dict[str, Any] = {"n": n}
    turns = any(c >= 3 for c in plan.mechanism.dof)
    parts = [("position", "length")] + ([("rotation", "angle")] if turns else [])
    exchanged = {size: values for size, *values in plan.best}
    for i, (part, quantity) in enumerate(parts):
        f = units.factor(quantity)
        out[f"sigma_{part}"] = _finite(getattr(plan.planned, part)[n - 1] / f)
        out[f"sigma_{part}_random"] = _finite(getattr(plan.random, part)[n - 1] / f)
        out[f"sigma_{part}_exchanged"] = np.array(
            [exchanged[int(k)][i] / f if int(k) in exchanged else np.nan for k in n])
    return out


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def picture(plan: Plan, wanted: float | None) -> bytes:
    """Return the accuracy at the tasks against the number of measurements, PNG."""
    from ppmcal.plotting.curves import draw_curves

    table, unit = accuracy_table(plan), plan.mechanism.units.length
    n, exchanged = table["n"], table["sigma_position_exchanged"]
    have = np.isfinite(exchanged)
    series = [("planned, one after the other", n, table["sigma_position"]),
              ("random, mean of 20", n, table["sigma_position_random"]),
              ("planned, each number for itself", n[have], exchanged[have])]
    if wanted is not None:
        level = wanted / plan.mechanism.units.factor("length")
        series.append(("wanted", n[[0, -1]], np.array([level, level])))
    marks = [(float(len(plan.rows)), f"this plan: {len(plan.rows)}")]
    if plan.pays and plan.pays != len(plan.rows) and plan.pays <= n[-1]:
        marks.append((float(plan.pays), f"hardly pays from {plan.pays}"))
    return draw_curves("Accuracy of the calibrated machine at the tasks", "measurements",
                       f"standard deviation of position, {unit}", series, log_y=True, marks=marks)


def record(plan: Plan, wanted: float | None, notes: Sequence[str], provenance: Mapping[str, Any]
           ) -> dict[str, Any]:
    """Return plan.json."""
    mechanism = plan.mechanism
    poses, curves = pose_table(plan), accuracy_table(plan)
    units = {**unit_map(mechanism, [*poses, *curves]), **_more_units(mechanism, poses)}
    return {
        "format": "ppmcal/plan/1", "name": mechanism.name, "said": said(plan, wanted, notes),
        "units": units, "findings": findings(plan, wanted),
        "pictures": {PICTURE: "Standard deviation of the calibrated machine's position at the "
                              "tasks against the number of measurements."},
        "tables": [_accuracy_rows(curves, plan), _observability_rows(plan)],
        "count": len(plan.rows), "poses": int(max(poses["pose"])), "least": plan.least,
        "hardly_pays_from": plan.pays or None, "reaches_accuracy": plan.reached,
        "extrapolated": plan.about,
        "limit": {"position": plan.limit[0] / mechanism.units.factor("length"),
                  "rotation": plan.limit[1] / mechanism.units.factor("angle")},
        "observability": plan.observability, "efficiency": plan.efficiency,
        "candidates": {"count": len(plan.pool), "left_out": dict(plan.pool.left_out)},
        "not_told": list(plan.offer.dropped),
        "route": {"before": plan.way.before, "after": plan.way.after},
        "provenance": dict(provenance)}


def _more_units(mechanism: Mechanism, header: Mapping[str, Any]) -> dict[str, str]:
    out = {"payload": "kg", "temperature": "deg C", "travel": "joint ranges"}
    out |= {f"vel_{a}": f"{u or 'unit'}/s" for a, (_, u) in zip(
        mechanism.actuators, mechanism.joint_units, strict=True)}
    return {n: u for n, u in out.items() if n in header}


def _accuracy_rows(curves: Mapping[str, Array], plan: Plan) -> dict[str, Any]:
    """Return the accuracy at some numbers of measurements, as a table for people."""
    n = curves["n"]
    wanted = {int(n[0]), int(n[-1]), len(plan.rows), len(plan.rows) // 2,
              *(size for size, *_ in plan.best), *(k for k in (10, 15, 20, 30, 50, 100))}
    rows = [i for i, k in enumerate(n.tolist()) if k in wanted]
    return {"title": "Accuracy at the tasks against the number of measurements",
            "columns": list(curves),
            "rows": [[_short(float(c[i])) if name != "n" else int(c[i])
                      for name, c in curves.items()] for i in rows],
            "note": "One standard deviation; exchanged: a design made for that number alone"}


def _observability_rows(plan: Plan) -> dict[str, Any]:
    names = list(plan.observability["planned"])
    return {"title": "Observability of the measurements, without tolerances",
            "columns": ["poses", *names],
            "rows": [[which, *(_short(values[k]) for k in names)]
                     for which, values in plan.observability.items()],
            "note": "In tolerances per standard deviation; random: mean of 20 designs"}


def _short(value: float) -> float | None:
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None
