"""What ``ppmcal workspace`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Machine, Table, grid, mechanism, option, seed


@dataclass(frozen=True)
class WorkspaceArguments(Arguments):
    """Where to look."""

    mechanism: Machine = mechanism()
    grid: str | None = grid()
    joints: Table | None = option(
        None, "CSV of joint values to find assembly modes for. Default: home's.")
    seed: int = seed()


COMMAND = Command(
    "workspace", WorkspaceArguments,
    about=("Show where {mechanism} can go, its singularities, dexterity and assembly modes.",
           "Geometry only: effects in {mechanism} are left out. Writes map.csv, singular.csv, "
           "modes.csv, workspace.json and a picture of each map."),
    examples=("ppmcal workspace mine.yaml",), out="workspace",
    result="WorkspaceResult",
    record=("workspace", "ppmcal.io.results.workspace:WorkspaceRecord"),
    raises="BadInput: anything wrong in the files or options. NoResult: home is singular.",
    shares={"mapping the workspace": 0.2, "assembly modes": 4.2, "writing the results": 1.0})
