"""plan.json and the files beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Any, ClassVar, Self

from ppmcal.calibration.fit import pictures_beside
from ppmcal.design.plan.result import Plan
from ppmcal.io import csv_text
from ppmcal.io.results.design import AnalysisRecord, ShownTable
from ppmcal.io.results.plan_tables import (
    accuracy_picture,
    accuracy_rows,
    accuracy_table,
    column_units,
    observability_rows,
    pose_table,
)
from ppmcal.io.results.plan_wording import findings, sentences
from ppmcal.io.results.record import Flag, Part, Shown, Text, Whole, table_text
from ppmcal.store.provenance import Provenance
from ppmcal.units import Angle, Length

PICTURE = "accuracy.png"
CAPTION = ("Standard deviation of the calibrated machine's position at the tasks against the "
           "number of measurements.")


class AccuracyLimit(Part):
    """What ever more measurements leave, in the machine's units."""

    position: Length[Shown | None] = None
    rotation: Angle[Shown | None] = None


class CandidatePoses(Part):
    """How many candidates there were, and why others were left out."""

    count: Whole = 0
    left_out: Mapping[str, Whole] = field(default_factory=dict)


class RouteLength(Part):
    """Length of the path through the poses, joint ranges, before and after it was ordered."""

    before: Shown | None = None
    after: Shown | None = None


class PlanRecord(AnalysisRecord):
    """plan.json.

    ``observability``: O1 to O5 of this plan and of random ones; ``efficiency``: information
    per parameter, random ones = 1; ``not_told``: columns that no candidate determines.
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
    limit: AccuracyLimit = AccuracyLimit()
    observability: Mapping[str, Mapping[str, Shown | None]] = field(default_factory=dict)
    efficiency: Shown | None = None
    candidates: CandidatePoses = CandidatePoses()
    not_told: tuple[Text, ...] = ()
    route: RouteLength = RouteLength()
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, plan: Plan, wanted: float | None, notes: Sequence[str],
           provenance: Mapping[str, Any]) -> Self:
        """Return the record of a plan for an accuracy ``wanted`` at the tasks, m, or None."""
        return cls(
            format=cls.FORMAT, name=plan.mechanism.name,
            summary=tuple(sentences(plan, wanted, notes)), units=column_units(plan),
            findings=tuple(findings(plan, wanted)), pictures={PICTURE: CAPTION},
            tables=(accuracy_rows(plan), observability_rows(plan)), count=len(plan.rows),
            poses=int(max(pose_table(plan)["pose"])), least=plan.least,
            hardly_pays_from=plan.pays or None, reaches_accuracy=plan.reached,
            extrapolated=plan.about,
            limit=AccuracyLimit.filled(None, plan.mechanism.units, position=plan.limit[0],
                                       rotation=plan.limit[1]),
            observability=plan.observability, efficiency=plan.efficiency,
            candidates=CandidatePoses(count=len(plan.pool), left_out=dict(plan.pool.left_out)),
            not_told=plan.offer.dropped,
            route=RouteLength.filled(plan.route),
            provenance=Provenance(**provenance))

    def files(self, plan: Plan, wanted: float | None) -> dict[str, str | bytes]:
        """Return file name -> content of everything that plan writes, in the machine's units."""
        poses = pose_table(plan)
        return {"poses.csv": csv_text(list(poses), list(poses.values())),
                "accuracy.csv": table_text(accuracy_table(plan), plan.mechanism.units),
                **pictures_beside({PICTURE: lambda: accuracy_picture(plan, wanted)}),
                self.FILE: self.text()}
