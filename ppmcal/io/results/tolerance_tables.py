"""Tables and pictures of ``tolerances``: tolerances.csv, errors.csv, allocated.yaml, yield.png."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from ppmcal.design.error_sources import Source
from ppmcal.design.monte_carlo import Fleet, MachineErrors, MonteCarloErrors
from ppmcal.design.tolerance_allocation import AccuracyCheck, Allocation, Demand, count
from ppmcal.io import write_mechanism
from ppmcal.io.results.design import ShownTable
from ppmcal.io.results.record import Column, Part, Shown, Text, Whole, in_units
from ppmcal.io.results.tables import pose_columns
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Angle, Length

METHODS = ("file", "mean", "equal", "cost")
STAGES = (("built", "as built"), ("registered", "registered only"), ("calibrated", "calibrated"))


@dataclass(frozen=True, eq=False)
class ToleranceResult:
    """Everything that the command found, SI.

    ``machine``: the nominal one, its effects left out; ``sources`` (S,); ``allocations`` by method;
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


class StageYield(Part):
    """Machines in specification at one stage, their share and its 95 % interval.

    ``going``: machines that have a result at every task pose; ``position_rms, rotation_rms``:
    of those, units as in ``units``.
    """

    stage: Text = ""
    words: Text = ""
    in_specification: Whole = 0
    machines: Whole = 0
    share: Shown | None = None
    interval: tuple[Shown, ...] = ()
    going: Whole = 0
    position_rms: Length[Shown | None] = None
    rotation_rms: Angle[Shown | None] = None

    @classmethod
    def of(cls, r: ToleranceResult, stage: str, words: str, errors: MachineErrors) -> Self:
        """Return how many machines are in specification at a stage."""
        share = count(errors, r.demand)
        return cls.filled(share, r.machine.units, stage=stage, words=words,
                          in_specification=share.hits, machines=share.total,
                          share=share.hits / share.total,
                          going=int(np.isfinite(errors.position).all(axis=1).sum()),
                          position_rms=float(rms(errors.position)),
                          rotation_rms=float(rms(errors.rotation)))


def tolerance_table(r: ToleranceResult) -> list[Column]:
    """Return the columns of tolerances.csv, one row per error.

    inf: the tool is not sensitive to it.
    """
    units = r.machine.units
    parameters = [r.machine.parameters[s.parameter] for s in r.sources]
    unit = np.array([units.factor(p.quantity) for p in parameters])
    out = [Column("name", [p.name for p in parameters]),
           Column("limb", [s.limb for s in r.sources]),
           Column("slot", [s.group for s in r.sources]),
           Column("class", [s.tolerance_class for s in r.sources]),
           Column("unit", [units.name(p.quantity) + (" per unit" if p.per_unit else "")
                           for p in parameters])]
    out += [Column(f"tolerance_{m}", r.allocations[m].tau / unit) for m in METHODS]
    return [*out, Column("chosen", r.allocations[r.chosen].tau / unit)]


def errors_table(r: ToleranceResult) -> list[Column]:
    """Return the columns of errors.csv: task poses, rms errors, linear against drawn."""
    poses = pose_columns(r.machine, pose_vector(r.fleet.tasks.motor))
    out = [*(Column(name, values) for name, values in poses.items()),
           Column("linear_position", r.check.linear, "length"),
           Column("drawn_position", r.check.drawn, "length"),
           Column("drawn_error", r.check.error, "length"),
           Column("linear_agrees", ["yes" if a else "no" for a in r.check.agrees])]
    for key, _, errors in r.stages():
        out += [Column(f"{key}_position_rms", rms(errors.position, 0), "length"),
                Column(f"{key}_position_p95", quantile(errors.position, 0.95), "length")]
        if r.machine.motion.turns:
            out.append(Column(f"{key}_rotation_rms", rms(errors.rotation, 0), "angle"))
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


def allocated(r: ToleranceResult) -> str:
    """Return the machine file with the chosen tolerances; others stay as they were."""
    tau = {s.parameter: float(t) for s, t in
           zip(r.sources, r.allocations[r.chosen].tau, strict=True) if np.isfinite(t)}
    parameters = tuple(replace(p, tolerance=tau[i]) if i in tau else p
                       for i, p in enumerate(r.machine.parameters))
    return write_mechanism(replace(r.machine, parameters=parameters),
                           "Tolerances allocated by ppmcal tolerances; effects left out.")


def yield_picture(r: ToleranceResult) -> bytes:
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


def slot_table(r: ToleranceResult) -> ShownTable:
    """Return the median tolerance by slot and method."""
    columns = in_units(tolerance_table(r), r.machine.units)
    rows = []
    keys = list(zip(columns["slot"], columns["unit"], strict=True))
    for group, unit in dict.fromkeys(keys):
        mine = np.array([k == (group, unit) for k in keys])
        row: list[Any] = [group, int(mine.sum()), unit]
        for method in METHODS:
            values = columns[f"tolerance_{method}"][mine]
            values = values[np.isfinite(values)]
            row.append(float(np.median(values)) if values.size else None)
        rows.append(tuple(row))
    return ShownTable(title="Tolerances by slot, medians (one standard deviation)",
                      columns=("slot", "errors", "unit", *METHODS), rows=tuple(rows),
                      note="empty: the tool is not sensitive to it; all are in tolerances.csv")
