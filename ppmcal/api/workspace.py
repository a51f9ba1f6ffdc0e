"""Where a machine can go, its singularities and assembly modes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

from ppmcal.api.inputs import Machine, files_of, load, place_of, recorded, source_of
from ppmcal.api.result import Progress, Result
from ppmcal.design.assembly_modes import assembly_modes
from ppmcal.design.workspace import Workspace
from ppmcal.design.workspace import workspace as mapped
from ppmcal.errors import BadInput, NoResult
from ppmcal.io import read_joints
from ppmcal.io.grid import read_grid
from ppmcal.io.results.workspace import WorkspaceRecord
from ppmcal.io.results.workspace_tables import ModeRow, pictures
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.tables import refuse_singular_home
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import begin, heard, silent

LEVELS = 61


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
        return {**self.record.files(self.workspace, list(self.modes)), **pictures(self.workspace)}

    def headline(self) -> str:
        """Return the first sentence of what was found."""
        return f"{self.mechanism.name}: {self.record.said[0]}"


@recorded
@heard
def workspace(mechanism: Machine, *, grid: str | None = None, joints: Any = None, seed: int = 0,
              progress: Progress = silent) -> WorkspaceResult:
    """Show where a machine can go, its singularities, dexterity and assembly modes.

    Geometry only: effects are left out.

    Args:
        mechanism: the machine, or its file.
        grid: coordinates with range and levels, such as ``x=-300:300:41,rz``  [default: the
            first two, as far as home can go].
        joints: joint values to find assembly modes for, as a file or a table in memory
            [default: home's].
        seed: of the search for assembly modes.
        progress: called with a line of text now and then.

    Raises:
        BadInput: anything wrong in the files or options. NoResult: home is singular.
    """
    machine = load(mechanism)
    refuse_singular_home(machine)    # about which no grid would be found
    found = mapped(machine, read_grid(grid, machine, LEVELS))
    begin("assembly modes")
    rows = _modes(found, joints, seed)
    source = source_of("workspace", [*machine.inputs, *files_of(joints)], seed)
    record = WorkspaceRecord.of(found, rows, source)
    return WorkspaceResult(source, tuple(record.findings), machine, found, tuple(rows), record)


def _modes(found: Workspace, joints: Any, seed: int) -> list[ModeRow]:
    """Return the assembly modes at home's joints, or for each row of a file."""
    model = Model(found.mechanism)
    wanted = [(0, home_state(found.mechanism).q)]
    if joints is not None:
        table = read_joints(joints, found.mechanism)
        wanted = [(int(n), q) for n, q in zip(table.rows, table.q, strict=True)]
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
