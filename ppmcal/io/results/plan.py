"""plan.json, poses.csv, accuracy.csv and the picture of a measuring plan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.calibration.fit import pictures_beside
from ppmcal.design.plan.result import Plan
from ppmcal.io import csv_text
from ppmcal.io.results.parts import AnalysisRecord, ShownTable
from ppmcal.io.results.plan_wording import findings, sentences
from ppmcal.io.results.record import Column, Flag, Shown, Text, Whole, in_units, table_text
from ppmcal.io.results.tables import joint_columns, pose_columns, unit_map
from ppmcal.linalg import Array
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.store.provenance import Provenance
from ppmcal.units import Angle, Key, Length
from ppmcal.wording import rounded

DIGITS = 4


def pose_table(plan: Plan) -> dict[str, Any]:
    """Return poses.csv, file units: one row per measurement, in the order of the route."""
    mechanism, pool = plan.mechanism, plan.pool
    at = plan.offer.pose[plan.rows]
    # poses are numbered as they are come to
    numbers = {p: i + 1 for i, p in enumerate(dict.fromkeys(at.tolist()))}
    table: dict[str, Any] = {"pose": np.array([numbers[p] for p in at.tolist()]),
                             **joint_columns(mechanism, pool.q[at], "q_{}"),
                             **pose_columns(mechanism, pool.pose[at])}
    given = plan.columns
    table |= {f"dir_{a}": given[f"dir_{a}"].astype(int) for a in mechanism.actuators
              if f"dir_{a}" in given}
    table |= {f"vel_{a}": given[f"vel_{a}"] / factor for a, (factor, _) in
              zip(mechanism.actuators, mechanism.joint_units, strict=True) if f"vel_{a}" in given}
    table |= {n: v for n, v in given.items() if n.startswith("tension_")}
    if "payload" in given:
        table["payload"] = given["payload"]
    if "temperature" in given:
        table["temperature"] = np.round(given["temperature"] - ZERO_CELSIUS, 9)
    return table | {"travel": plan.route.travel, "via": list(plan.route.via),
                    "condition": pool.singular_value[at], "gain": plan.gain}


def accuracy_table(plan: Plan) -> list[Column]:
    """Return accuracy.csv: standard deviations at the tasks against the number of rows."""
    n = np.arange(plan.least, len(plan.planned.position) + 1)
    turns = any(c >= 3 for c in plan.mechanism.dof)
    parts = [("position", "length")] + ([("rotation", "angle")] if turns else [])
    exchanged = {size: values for size, *values in plan.best}
    out = [Column("n", n)]
    for i, (part, quantity) in enumerate(parts):
        at_size = np.array([exchanged[int(k)][i] if int(k) in exchanged else np.nan for k in n])
        out += [Column(f"sigma_{part}", _finite(getattr(plan.planned, part)[n - 1]), quantity),
                Column(f"sigma_{part}_random", _finite(getattr(plan.random, part)[n - 1]),
                       quantity), Column(f"sigma_{part}_exchanged", at_size, quantity)]
    return out


def _finite(values: Array) -> Array:
    return np.where(np.isfinite(values), values, np.nan)


def column_units(plan: Plan) -> dict[str, str]:
    """Return the unit of every column of both tables that has one."""
    mechanism, poses = plan.mechanism, pose_table(plan)
    more = {"payload": "kg", "temperature": "deg C", "travel": "joint ranges"}
    more |= {f"tension_{a}": "N" for a in mechanism.actuators}
    more |= {f"vel_{a}": f"{u or 'unit'}/s" for a, (_, u) in zip(
        mechanism.actuators, mechanism.joint_units, strict=True)}
    return {**unit_map(mechanism, [*poses, *(c.name for c in accuracy_table(plan))]),
            **{n: u for n, u in more.items() if n in poses}}


def accuracy_picture(plan: Plan, wanted: float | None) -> bytes:
    """Return the accuracy at the tasks against the number of measurements, PNG."""
    from ppmcal.plotting.curves import draw_curves

    units = plan.mechanism.units
    table = in_units(accuracy_table(plan), units)
    n, exchanged = table["n"], table["sigma_position_exchanged"]
    have = np.isfinite(exchanged)
    series = [("planned, one after the other", n, table["sigma_position"]),
              ("random, mean of 20", n, table["sigma_position_random"]),
              ("planned, each number for itself", n[have], exchanged[have])]
    if wanted is not None:
        level = wanted / units.factor("length")
        series.append(("wanted", n[[0, -1]], np.array([level, level])))
    marks = [(float(len(plan.rows)), f"this plan: {len(plan.rows)}")]
    if plan.pays and plan.pays != len(plan.rows) and plan.pays <= n[-1]:
        marks.append((float(plan.pays), f"hardly pays from {plan.pays}"))
    return draw_curves("Accuracy of the calibrated machine at the tasks", "measurements",
                       f"standard deviation of position, {units.length}", series, log_y=True,
                       marks=marks)


def accuracy_rows(plan: Plan) -> ShownTable:
    """Return the accuracy at some numbers of measurements, as a table for people."""
    curves = in_units(accuracy_table(plan), plan.mechanism.units)
    n = curves["n"]
    wanted = {int(n[0]), int(n[-1]), len(plan.rows), len(plan.rows) // 2,
              *(size for size, *_ in plan.best), *(k for k in (10, 15, 20, 30, 50, 100))}
    rows = [i for i, k in enumerate(n.tolist()) if k in wanted]
    return ShownTable(
        title="Accuracy at the tasks against the number of measurements", columns=tuple(curves),
        rows=tuple(tuple(rounded(float(c[i]), DIGITS) if name != "n" else int(c[i])
                         for name, c in curves.items()) for i in rows),
        note="One standard deviation; exchanged: a design made for that number alone")


def observability_rows(plan: Plan) -> ShownTable:
    """Return the observability indices of this plan and of random ones."""
    names = list(plan.observability.get("planned", ()))
    return ShownTable(
        title="Observability of the measurements, without tolerances", columns=("poses", *names),
        rows=tuple((which, *(rounded(values[k], DIGITS) for k in names))
                   for which, values in plan.observability.items()),
        note="In tolerances per standard deviation; random: mean of 20 designs")


PICTURE = "accuracy.png"
CAPTION = ("Standard deviation of the calibrated machine's position at the tasks against the "
           "number of measurements.")


class PlanRecord(AnalysisRecord):
    """plan.json.

    ``observability``: O1 to O5 of this plan and of random ones; ``efficiency``: information
    per parameter, random ones = 1; ``not_told``: columns that no candidate determines.
    ``limit_position``, ``limit_rotation``: what ever more measurements leave; ``candidates``: how
    many there were, and why others were ``left_out``; ``route``: length of the path through the
    poses, joint ranges, before and after it was ordered.
    """

    FILE: ClassVar[str] = "plan.json"
    FORMAT: ClassVar[str] = "ppmcal/plan/1"
    TITLE: ClassVar[str] = "Measuring plan"
    TABLES: ClassVar[tuple[str, ...]] = ("poses.csv", "accuracy.csv")

    pictures: Mapping[str, Text] | None = None
    tables: tuple[ShownTable, ...] = ()
    count: Whole = 0
    poses: Whole = 0
    least: Whole = 0
    hardly_pays_from: Whole | None = None
    reaches_accuracy: Whole | None = None
    extrapolated: Flag = False
    limit_position: Annotated[Length[Shown | None], Key("limit.position")] = None
    limit_rotation: Annotated[Angle[Shown | None], Key("limit.rotation")] = None
    observability: Mapping[str, Mapping[str, Shown | None]] = field(default_factory=dict)
    efficiency: Shown | None = None
    candidates: Annotated[Whole, Key("candidates.count")] = 0
    left_out: Annotated[Mapping[str, Whole], Key("candidates.left_out")] = field(
        default_factory=dict)
    not_told: tuple[Text, ...] = ()
    route: Mapping[str, Shown | None] = field(default_factory=dict)
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, plan: Plan, wanted: float | None, notes: Sequence[str],
           provenance: Mapping[str, Any]) -> Self:
        """Return the record of a plan for an accuracy ``wanted`` at the tasks, m, or None."""
        return cls.filled(
            None, plan.mechanism.units, format=cls.FORMAT, name=plan.mechanism.name,
            summary=tuple(sentences(plan, wanted, notes)), units=column_units(plan),
            findings=tuple(findings(plan, wanted)), pictures={PICTURE: CAPTION},
            tables=(accuracy_rows(plan), observability_rows(plan)), count=len(plan.rows),
            poses=int(max(pose_table(plan)["pose"])), least=plan.least,
            hardly_pays_from=plan.pays or None, reaches_accuracy=plan.reached,
            extrapolated=plan.about,
            limit_position=plan.limit[0], limit_rotation=plan.limit[1],
            observability=plan.observability, efficiency=plan.efficiency,
            candidates=len(plan.pool), left_out=dict(plan.pool.left_out),
            not_told=plan.offer.dropped,
            route={"before": plan.route.before, "after": plan.route.after},
            provenance=provenance)

    def files(self, plan: Plan, wanted: float | None) -> dict[str, str | bytes]:
        """Return file name -> content of everything that plan writes, in the machine's units."""
        poses = pose_table(plan)
        return {"poses.csv": csv_text(list(poses), list(poses.values())),
                "accuracy.csv": table_text(accuracy_table(plan), plan.mechanism.units),
                **pictures_beside({PICTURE: lambda: accuracy_picture(plan, wanted)}),
                self.FILE: self.text()}
