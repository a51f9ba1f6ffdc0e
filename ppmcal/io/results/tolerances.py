"""Tolerances: tolerances.json, the tables and the picture beside it, and what is said of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal import codec
from ppmcal.calibration.fit import pictures_beside
from ppmcal.design.error_sources import Source
from ppmcal.design.monte_carlo import Fleet, MachineErrors, MonteCarloErrors
from ppmcal.design.tolerance_allocation import AccuracyCheck, Allocation, Demand, StageYield, count
from ppmcal.io import write_mechanism
from ppmcal.io.results.parts import AnalysisRecord, ShownTable, geometry_note
from ppmcal.io.results.record import Column, Shown, Text, Whole, in_units, table_text
from ppmcal.io.results.tables import error_columns, pose_columns, unit_map
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length
from ppmcal.wording import number

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


def _stage(r: ToleranceResult, stage: str, words: str, errors: MachineErrors) -> StageYield:
    """Return how many machines are in specification at a stage, file units."""
    return codec.in_units(replace(
        count(errors, r.demand), stage=stage, words=words,
        going=int(np.isfinite(errors.position).all(axis=1).sum()),
        position_rms=float(rms(errors.position)), rotation_rms=float(rms(errors.rotation))),
        r.machine.units)


def tolerance_table(r: ToleranceResult) -> list[Column]:
    """Return the columns of tolerances.csv, one row per error.

    inf: the tool is not sensitive to it.
    """
    named, unit = error_columns(r.machine, r.sources, "class")
    return [*named, *(Column(f"tolerance_{m}", r.allocations[m].tau / unit) for m in METHODS),
            Column("chosen", r.allocations[r.chosen].tau / unit)]


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


METHOD_WORDS = {"cost": "of least cost", "equal": "of equal contributions", "mean": "one for all",
                "file": "as in the file"}


def sentences(r: ToleranceResult, stages: Sequence[StageYield]) -> list[str]:
    """Return the results in words, the most important first."""
    units = r.machine.units
    return [_demanded(r), *_mean_deviation(r), *(_in_specification(y, units.length)
                                                for y in stages),
            *_calibrated(r), _linear_check(r)]


def _demanded(r: ToleranceResult) -> str:
    units, d = r.machine.units, r.demand
    parts = ((d.position, "length"), (d.rotation, "angle"))
    asked = [units.words(value, quantity) for value, quantity in parts if value is not None]
    return (f"{r.machine.name}: {len(r.sources)} errors, tolerances {METHOD_WORDS[r.chosen]}, for "
            f"{' and '.join(asked)} at each of {len(r.fleet.tasks.q)} task poses.")


def _mean_deviation(r: ToleranceResult) -> list[str]:
    if r.sigma_one is None:
        return []
    return ["One standard deviation for all errors that gives an rms error of the accuracy "
            f"at home: {r.machine.units.words(r.sigma_one, 'length')} (accuracy "
            "over the amplification index)."]


def _in_specification(y: StageYield, length: str) -> str:
    low, high = y.interval
    size = "" if y.position_rms is None else (
        f"; {number(y.position_rms)} {length} rms"
        + (f" of the {y.going} that have a result" if y.machines > y.going else ""))
    return (f"{y.words.capitalize()}: {y.share:.1%} of {y.machines} machines in "
            f"specification (95 % interval {low:.1%} to {high:.1%}){size}.")


def _calibrated(r: ToleranceResult) -> list[str]:
    setup, units = r.fleet.setup, r.machine.units
    if setup is None or not np.isfinite(setup.instrument.sigma_position):
        return []
    predicted = "" if r.predicted is None else (
        f"; the linear model expects {units.words(r.predicted, 'length')} rms")
    return [f"Calibrated with {len(setup.q)} poses, instrument {setup.instrument.kind} of "
            f"{units.words(setup.instrument.sigma_position, 'length')}{predicted}."]


def _linear_check(r: ToleranceResult) -> str:
    agree, poses = int(r.check.agrees.sum()), len(r.check.agrees)
    return ("As built, linear prediction and nonlinear machines agree in position at "
            f"{agree} of {poses} task poses (a difference of {r.check.seen:.0%} would show)"
            + ("." if agree == poses else "; where they do not, trust the machines drawn "
               "(errors.csv, linear_agrees)."))


def findings(r: ToleranceResult, mechanism: Mechanism) -> list[str]:
    """Return what must be looked at: machines that cannot take poses, a yield missed."""
    out = [*mechanism.findings, *r.notes]
    built = r.judged.built
    lost = int((~np.isfinite(built.position)).any(axis=1).sum())
    if lost:
        out.append(Note(
            f"{lost} of {len(built.position)} machines cannot take every task pose: they "
            "count as out of specification"))
    for _, words, errors in r.stages()[1:]:
        more = int((~np.isfinite(errors.position)).any(axis=1).sum()) - lost
        if more > 0:
            out.append(Note(
                f"{words}: {more} more machines have no result (no converged fit, or a task "
                "pose out of their reach): they count as out of specification"))
    high = count(built, r.demand).interval[1]
    wrong = lost > 0 or not r.check.agrees.all()
    if high < r.demand.share and r.chosen != "file" and wrong:
        out.append(Note(
            f"fewer machines than wanted are in specification as built ({high:.1%} at most, "
            f"wanted {r.demand.share:.1%}): the linear model is not good enough here"))
    return out


class TolerancesRecord(AnalysisRecord):
    """tolerances.json; lengths and angles in the machine's units.

    ``costs``: by method, bare numbers; ``mean_deviation``: one standard deviation for all
    errors that gives an rms error of the accuracy; ``linear_agrees``: at how many ``task_poses``
    the linear model agrees with the machines drawn; ``calibrated_predicted``: rms position error
    that it expects after calibration.
    """

    FILE: ClassVar[str] = "tolerances.json"
    FORMAT: ClassVar[str] = "ppmcal/tolerances/1"
    TITLE: ClassVar[str] = "Tolerances"
    TABLES: ClassVar[tuple[str, ...]] = ("tolerances.csv", "errors.csv")

    demand: Demand = codec.unsaid(Demand)
    method: Text = ""
    stages: Annotated[tuple[StageYield, ...], Key("yield")] = ()
    costs: Mapping[str, Shown | None] = field(default_factory=dict)
    errors: Whole = 0
    mean_deviation: Length[Shown | None] = None
    task_poses: Annotated[Whole, Key("linear.poses")] = 0
    linear_agrees: Annotated[Whole, Key("linear.agree")] = 0
    calibrated_predicted: Annotated[Length[Shown | None], Key("linear.calibrated_predicted")] = None
    tables: tuple[ShownTable, ...] = ()
    pictures: Mapping[str, Text] | None = None
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, r: ToleranceResult, mechanism: Mechanism, provenance: Mapping[str, Any]) -> Self:
        """Return the record of tolerances found for ``mechanism``."""
        units = r.machine.units
        stated = {c.name: units.name(c.quantity)
                  for c in (*tolerance_table(r), *errors_table(r)) if c.quantity}
        stages = tuple(_stage(r, *stage) for stage in r.stages())
        return cls.filled(
            None, units, format=cls.FORMAT, name=r.machine.name,
            summary=(*sentences(r, stages), *geometry_note(mechanism)),
            units={**unit_map(r.machine, r.machine.coordinates), **stated,
                   "position": units.length, "rotation": units.angle,
                   "position_rms": units.length, "rotation_rms": units.angle},
            findings=tuple(findings(r, mechanism)),
            demand=r.demand, method=r.chosen, stages=stages,
            costs={m: a.cost for m, a in r.allocations.items()}, errors=len(r.sources),
            mean_deviation=r.sigma_one,
            task_poses=len(r.check.agrees), linear_agrees=int(r.check.agrees.sum()),
            calibrated_predicted=r.predicted,
            tables=(_yield_table(stages, units.length), slot_table(r), ShownTable(
                title="Cost", columns=("method", "cost"), note="",
                rows=tuple((m, a.cost) for m, a in r.allocations.items()))),
            pictures={"yield.png": "Share of machines below every accuracy"},
            provenance=provenance)

    def files(self, r: ToleranceResult) -> dict[str, str | bytes]:
        """Return file name -> content of everything that tolerances writes."""
        units = r.machine.units
        out: dict[str, str | bytes] = {
            "tolerances.csv": table_text(tolerance_table(r), units),
            "errors.csv": table_text(errors_table(r), units),
            **pictures_beside({"yield.png": lambda: yield_picture(r)}), self.FILE: self.text()}
        if r.chosen != "file":
            out["allocated.yaml"] = allocated(r)
        return out


def _yield_table(stages: tuple[StageYield, ...], length: str) -> ShownTable:
    return ShownTable(
        title="Machines in specification",
        columns=("stage", "machines", "share", "from", "to", f"rms, {length}"),
        rows=tuple((y.words, f"{y.in_specification} of {y.machines}", y.share, *y.interval,
                    y.position_rms) for y in stages),
        note="intervals: Clopper-Pearson, 95 %; every task pose must be within the accuracy")
