"""workspace.json and the files beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.design.workspace import Workspace
from ppmcal.io.results.design import NumberWithUnit, ShownTable
from ppmcal.io.results.record import Flag, Part, Record, Shown, Text, Whole
from ppmcal.io.results.tables import unit_map
from ppmcal.io.results.workspace_tables import (
    ModeRow,
    csv_files,
    left_out,
    left_table,
    modes_table,
    plotted,
    size_unit,
    size_word,
)
from ppmcal.io.results.workspace_wording import assembly_modes, findings, reach, singularities
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.provenance import Provenance
from ppmcal.units import ByCoordinate, Key, OfUnit

MEANING = {
    "condition": "smallest singular value of A, rotation columns divided by length_scale",
    "condition_relative": "condition, home = 1",
    "dexterity": "smallest over largest singular value of J = -inv(A) Jq, rotation rows times "
                 "length_scale, joint angles as arcs at length_scale (local conditioning index)",
    "dexterity_legs": "smallest over largest singular value of A",
    "singularity_distance": "to the nearest pose of singular.csv, in the grid's coordinates; "
                            "rotations times length_scale unless all coordinates are rotations",
    "grid_end": "distance to the end of the grid: where singularity_distance is larger, a nearer "
                "singularity may lie beyond",
    "determinant": "det A, home = 1; 0 on the singular curve, negative beyond it",
}
"""What the columns of map.csv are."""


class GridAxis(Part):
    """One coordinate of the grid."""

    low: OfUnit[Shown | None] = None
    high: OfUnit[Shown | None] = None
    levels: Whole = 0
    unit: Text = ""


class ReachableSpace(Part):
    """Share of the grid that is reached within limits, and its size by what that is called."""

    share: Shown | None = None
    length: Shown | None = None
    area: Shown | None = None
    volume: Shown | None = None
    extent: Shown | None = None
    unit: Text = ""


class ConditioningIndex(Part):
    """Mean dexterity over the poses reached, bare numbers."""

    dexterity: Shown | None = None
    dexterity_legs: Shown | None = None


class HomeConditioning(Part):
    """Figures at home, bare numbers, and which joint is outside its limits there."""

    condition: Shown | None = None
    dexterity: Shown | None = None
    dexterity_legs: Shown | None = None
    determinant: Shown | None = None
    outside_limits: Text | None = None


class SingularPose(Part):
    """The singular pose nearest to home; ``grid_ends_at``: distance to the end of the grid."""

    distance: OfUnit[Shown | None] = None
    unit: Text = ""
    pose: ByCoordinate[Mapping[str, Shown | None]] = field(default_factory=dict)
    grid_ends_at: OfUnit[Shown | None] = None

    @classmethod
    def of(cls, found: Workspace) -> Self | None:
        """Return the singular pose in the machine's units, None where the grid has none."""
        if found.nearest is None:
            return None
        machine, near = found.mechanism, found.nearest
        return cls.filled(near, machine.units, unit=found.distance_quantity, grid_ends_at=near.edge,
                          pose=dict(zip(machine.coordinates, near.pose[list(machine.dof)],
                                        strict=True)))


class SingularSet(Part):
    """How many singular poses the grid has; ``searched``: whether they were looked for."""

    searched: Flag = False
    points: Whole = 0
    nearest_to_home: SingularPose | None = None


class ModeCount(Part):
    """How many assembly modes one row has, and how far that is known; ``home``: from 1."""

    row: Whole = 0
    count: Whole | None = None
    singular: Whole = 0
    home: Whole | None = None
    complete: Flag = False
    method: Text = ""
    reason: Text = ""

    @classmethod
    def of(cls, entry: ModeRow) -> Self:
        """Return the count of one row's modes, or why there is none."""
        modes = entry.modes
        if modes is None:
            return cls(row=entry.row, count=None, reason=entry.reason)
        return cls(row=entry.row, count=len(modes), singular=int(modes.singular.sum()),
                   home=None if modes.home is None else modes.home + 1,
                   complete=modes.complete, method=modes.method)


class WorkspaceRecord(Record):
    """workspace.json; ``columns``: what those of map.csv are; ``units``: theirs, by name."""

    FILE: ClassVar[str] = "workspace.json"
    FORMAT: ClassVar[str] = "ppmcal/workspace/1"
    TITLE: ClassVar[str] = "Workspace and singularities"
    TABLES: ClassVar[tuple[str, ...]] = ("workspace.csv", "map.csv", "singular.csv", "modes.csv")

    name: Text = ""
    grid: Mapping[str, GridAxis] = field(default_factory=dict)
    poses: Whole = 0
    status: Mapping[str, Whole] = field(default_factory=dict)
    left_out: Mapping[str, Whole] = field(default_factory=dict)
    reachable: ReachableSpace = ReachableSpace()
    conditioning_index: ConditioningIndex = ConditioningIndex()
    home: HomeConditioning = HomeConditioning()
    singular: SingularSet = SingularSet()
    modes: tuple[ModeCount, ...] = ()
    summary: Annotated[tuple[Text, ...], Key("said")] = ()
    findings: tuple[Text, ...] = ()
    pictures: Mapping[str, Text] | None = None
    tables: tuple[ShownTable, ...] = ()
    columns: Mapping[str, Text] = field(default_factory=dict)
    units: Mapping[str, Text] = field(default_factory=dict)
    length_scale: NumberWithUnit = NumberWithUnit()
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, found: Workspace, rows: Sequence[ModeRow], provenance: Mapping[str, Any]) -> Self:
        """Return the record of a workspace and the assembly modes of rows of joint values."""
        machine = found.mechanism
        size, unit = size_unit(found)
        header = (*machine.coordinates, *(f"q_{a}" for a in machine.actuators))
        return cls(
            format=cls.FORMAT, name=machine.name, grid=_axes(found),
            poses=len(found.table.status),
            status=dict(sorted(Counter(found.table.status).items())), left_out=left_out(found),
            reachable=ReachableSpace(share=found.share, unit=unit,
                                     **{size_word(found): found.size / size}),
            conditioning_index=ConditioningIndex(dexterity=found.index,
                                                 dexterity_legs=found.index_legs),
            home=_home(found),
            singular=SingularSet(searched=found.searched, points=len(found.singular),
                                 nearest_to_home=SingularPose.of(found)),
            modes=tuple(ModeCount.of(r) for r in rows),
            summary=(*reach(found), *singularities(found), *assembly_modes(found, rows)),
            findings=tuple(findings(found, rows)),
            pictures={f"map_{m.name}.png": m.title for m in plotted(found)},
            tables=tuple(t for t in (left_table(found), modes_table(found, rows)) if t),
            columns=MEANING,
            units=unit_map(machine, header) | {
                "singularity_distance": machine.units.name(found.distance_quantity)},
            length_scale=NumberWithUnit.filled(None, machine.units, value=machine.length_scale,
                                               unit="length"),
            provenance=Provenance(**provenance))

    def files(self, found: Workspace, rows: Sequence[ModeRow]) -> dict[str, str]:
        """Return file name -> text of everything but the pictures."""
        return {**csv_files(found, rows), self.FILE: self.text()}


def _axes(found: Workspace) -> dict[str, GridAxis]:
    return {POSE_COORDINATES[c]: GridAxis.filled(
        None, found.mechanism.units, low=float(level[0]), high=float(level[-1]),
        levels=len(level), unit="length" if c < 3 else "angle")
        for c, level in zip(found.grid.coordinates, found.grid.levels, strict=True)}


def _home(found: Workspace) -> HomeConditioning:
    home = found.home
    return HomeConditioning(condition=float(home.singular_value[0]),
                            dexterity=float(home.dexterity[0]),
                            dexterity_legs=float(home.legs[0]),
                            determinant=float(np.sign(home.determinant[0])),
                            outside_limits=found.home_limits or None)
