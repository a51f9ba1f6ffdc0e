"""Where a machine can go, its singularities and assembly modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from ppmcal.commands.inputs import files_of, load, place_of
from ppmcal.commands.result import Result
from ppmcal.commands.workspace.options import WorkspaceArguments
from ppmcal.design.assembly_modes import ModeRow, assembly_modes
from ppmcal.design.workspace import Workspace
from ppmcal.design.workspace import workspace as mapped
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_joints
from ppmcal.io.grid import read_grid
from ppmcal.io.results.workspace import (
    WorkspaceRecord,
    left_table,
    modes_sentences,
    modes_table,
    reach,
    singularities,
)
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.tables import refuse_singular_home
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.provenance import source_of
from ppmcal.wording.progress import start_stage
from ppmcal.wording.told import ShortTable

LEVELS = 61
SHOWN = 10
"""Rows of a table that the console shows."""


@dataclass(frozen=True, eq=False, repr=False)
class WorkspaceResult(Result):
    """Where a machine can go.

    Attributes:
        mechanism: the machine.
        workspace: the map: status, conditioning and distances to singularities, SI.
        modes: assembly modes at home's joint values, or of the rows given.
        record: the content of workspace.json.
    """

    COMMAND: ClassVar[str] = "workspace"
    TABLE: ClassVar[str] = "map.csv"

    mechanism: Mechanism
    workspace: Workspace
    modes: tuple[ModeRow, ...]
    record: WorkspaceRecord

    def files(self) -> Mapping[str, str | bytes]:
        """Return map.csv, singular.csv, modes.csv, workspace.json and pictures."""
        return self.record.files(self.workspace, self.modes)

    def told(self) -> Iterator[str | ShortTable]:
        """Yield everything in sentences, with the tables that belong to it."""
        found, rows = self.workspace, self.modes
        yield from reach(found)
        if found.table.status.count("ok") < len(found.table.status):
            left = left_table(found)
            yield ShortTable(left.columns, left.rows[:SHOWN], (1,))
        yield from singularities(found)
        yield from modes_sentences(found, rows)
        table = modes_table(found, rows)
        if table is not None:
            yield ShortTable(table.columns, table.rows[:SHOWN], range(len(table.columns) - 1))
            if len(table.rows) > SHOWN:
                yield f"... and {len(table.rows) - SHOWN} more, see modes.csv."


def run(asked: WorkspaceArguments) -> WorkspaceResult:
    """Show where a machine can go, its singularities, dexterity and assembly modes."""
    machine = load(asked.mechanism)
    refuse_singular_home(machine)    # about which no grid would be found
    found = mapped(machine, read_grid(asked.grid, machine, LEVELS))
    start_stage("assembly modes")
    rows = _modes(found, asked.joints, asked.seed)
    source = source_of("workspace", [*machine.inputs, *files_of(asked.joints)], asked.seed)
    record = WorkspaceRecord.of(found, rows, source)
    return WorkspaceResult(source, tuple(record.findings), machine, found, tuple(rows), record)


def _modes(found: Workspace, joints: Any, seed: int) -> list[ModeRow]:
    """Return the assembly modes at home's joints, or for each row of a file."""
    model = Model(found.mechanism)
    wanted = [(0, home_state(found.mechanism).q)]
    if joints is not None:
        table = read_joints(joints, found.mechanism)
        wanted = list(enumerate(table.q, 1))
        if not wanted:
            raise BadInput("has no rows", place_of(joints, "joints"),
                           "Give at least one row of joint values")
    out = []
    for n, q in wanted:
        try:
            out.append(ModeRow(n, q, assembly_modes(model, q, seed)))
        except NoResult as refused:
            out.append(ModeRow(n, q, None, refused.what))
    return out
