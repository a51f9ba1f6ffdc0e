"""tolerances.json and the files beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

from ppmcal.calibration.fit import pictures_beside
from ppmcal.codec import unsaid
from ppmcal.design.tolerance_allocation import Demand
from ppmcal.io.results.design import AnalysisRecord, ShownTable, geometry_note
from ppmcal.io.results.record import Shown, Text, Whole, table_text
from ppmcal.io.results.tables import unit_map
from ppmcal.io.results.tolerance_tables import (
    StageYield,
    ToleranceResult,
    allocated,
    errors_table,
    slot_table,
    tolerance_table,
    yield_picture,
)
from ppmcal.io.results.tolerances_wording import findings, sentences
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length


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

    demand: Demand = unsaid(Demand)
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
        stages = tuple(StageYield.of(r, *stage) for stage in r.stages())
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
            provenance=Provenance(**provenance))

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
