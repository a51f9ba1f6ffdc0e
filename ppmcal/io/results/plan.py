"""plan.json and the files beside it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

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
from ppmcal.io.results.record import Flag, Shown, Text, Whole, table_text
from ppmcal.store.provenance import Provenance
from ppmcal.units import Angle, Key, Length

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
            provenance=Provenance(**provenance))

    def files(self, plan: Plan, wanted: float | None) -> dict[str, str | bytes]:
        """Return file name -> content of everything that plan writes, in the machine's units."""
        poses = pose_table(plan)
        return {"poses.csv": csv_text(list(poses), list(poses.values())),
                "accuracy.csv": table_text(accuracy_table(plan), plan.mechanism.units),
                **pictures_beside({PICTURE: lambda: accuracy_picture(plan, wanted)}),
                self.FILE: self.text()}
