"""workspace.json and the files beside it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.design.workspace import Nearest, Workspace
from ppmcal.io.results.design import ShownTable
from ppmcal.io.results.parts import Range
from ppmcal.io.results.record import Flag, Part, PlainCell, Record, Shown, Text, Whole
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
from ppmcal.units import Key, Length

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
    """workspace.json; ``columns``: what those of map.csv are; ``units``: theirs, by name.

    ``reachable``: share of the grid within limits, and its size by what that is called;
    ``conditioning_index``: mean dexterity there; ``home``: figures there, bare, and which joint is
    outside its limits; ``nearest``: of ``singular_poses`` of the grid, if they were ``searched``.
    """

    FILE: ClassVar[str] = "workspace.json"
    FORMAT: ClassVar[str] = "ppmcal/workspace/1"
    TITLE: ClassVar[str] = "Workspace and singularities"
    TABLES: ClassVar[tuple[str, ...]] = ("workspace.csv", "map.csv", "singular.csv", "modes.csv")

    name: Text = ""
    grid: Mapping[str, Range] = field(default_factory=dict)
    poses: Whole = 0
    status: Mapping[str, Whole] = field(default_factory=dict)
    left_out: Mapping[str, Whole] = field(default_factory=dict)
    reachable: Mapping[str, PlainCell] = field(default_factory=dict)
    conditioning_index: Mapping[str, Shown | None] = field(default_factory=dict)
    home: Mapping[str, PlainCell] = field(default_factory=dict)
    searched: Annotated[Flag, Key("singular.searched")] = False
    singular_poses: Annotated[Whole, Key("singular.points")] = 0
    nearest: Annotated[Nearest | None, Key("singular.nearest_to_home")] = None
    modes: tuple[ModeCount, ...] = ()
    summary: Annotated[tuple[Text, ...], Key("said")] = ()
    findings: tuple[Text, ...] = ()
    pictures: Mapping[str, Text] | None = None
    tables: tuple[ShownTable, ...] = ()
    columns: Mapping[str, Text] = field(default_factory=dict)
    units: Mapping[str, Text] = field(default_factory=dict)
    length_scale: Annotated[Length[Shown | None], Key("length_scale.value")] = None
    length_scale_unit: Annotated[Text, Key("length_scale.unit")] = ""
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, found: Workspace, rows: Sequence[ModeRow], provenance: Mapping[str, Any]) -> Self:
        """Return the record of a workspace and the assembly modes of rows of joint values."""
        machine, home = found.mechanism, found.home
        size, unit = size_unit(found)
        header = (*machine.coordinates, *(f"q_{a}" for a in machine.actuators))
        return cls.filled(
            None, machine.units, format=cls.FORMAT, name=machine.name, grid=_axes(found),
            poses=len(found.table.status),
            status=dict(sorted(Counter(found.table.status).items())), left_out=left_out(found),
            reachable={"share": found.share, size_word(found): found.size / size, "unit": unit},
            conditioning_index={"dexterity": found.index, "dexterity_legs": found.index_legs},
            home={"condition": home.singular_value[0], "dexterity": home.dexterity[0],
                  "dexterity_legs": home.legs[0], "determinant": np.sign(home.determinant[0]),
                  "outside_limits": found.home_limits or None},
            searched=found.searched, singular_poses=len(found.singular), nearest=found.nearest,
            modes=tuple(ModeCount.of(r) for r in rows),
            summary=(*reach(found), *singularities(found), *assembly_modes(found, rows)),
            findings=tuple(findings(found, rows)),
            pictures={f"map_{m.name}.png": m.title for m in plotted(found)},
            tables=tuple(t for t in (left_table(found), modes_table(found, rows)) if t),
            columns=MEANING,
            units=unit_map(machine, header) | {
                "singularity_distance": machine.units.name(found.distance_quantity)},
            length_scale=machine.length_scale, length_scale_unit=machine.units.length,
            provenance=Provenance(**provenance))

    def files(self, found: Workspace, rows: Sequence[ModeRow]) -> dict[str, str]:
        """Return file name -> text of everything but the pictures."""
        return {**csv_files(found, rows), self.FILE: self.text()}


def _axes(found: Workspace) -> dict[str, Range]:
    return {POSE_COORDINATES[c]: Range.filled(
        None, found.mechanism.units, low=float(level[0]), high=float(level[-1]),
        levels=len(level), unit="length" if c < 3 else "angle")
        for c, level in zip(found.grid.coordinates, found.grid.levels, strict=True)}
