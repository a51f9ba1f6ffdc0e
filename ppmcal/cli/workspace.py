"""``ppmcal workspace``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    finish,
    json_option,
    leave,
    out_option,
    plain_table,
    quiet_option,
    seed_option,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ppmcal.design.workspace import Workspace
    from ppmcal.io.results.workspace_tables import ModeRow

    Array = NDArray[Any]

LEVELS = 61
SHOWN = 10


@click.command("workspace")
@click.argument("mech", type=FILE)
@click.option("--grid", metavar="TEXT", default=None,
              help="Coordinates with range and levels, such as x=-300:300:41,rz. "
                   "Default: the first two, as far as home can go.")
@click.option("--joints", type=FILE, default=None,
              help="CSV of joint values to find assembly modes for. Default: home's.")
@out_option("workspace")
@seed_option
@quiet_option
@json_option
def command(mech: Path, grid: str | None, joints: Path | None, out: Path, seed: int | None,
            quiet: bool, as_json: bool) -> None:
    """Show where MECH can go, its singularities, dexterity and assembly modes.

    Geometry only: effects in MECH are left out. Writes map.csv, singular.csv, modes.csv,
    workspace.json and a picture of each map.
    """
    from ppmcal.design.workspace import workspace
    from ppmcal.io import Output, provenance, read_mechanism
    from ppmcal.io.grid import read_grid
    from ppmcal.io.results.workspace import WorkspaceRecord
    from ppmcal.io.results.workspace_tables import pictures

    console = Console(quiet, as_json)
    seed = seed or 0
    mechanism = read_mechanism(mech)
    asked = read_grid(grid, mechanism, LEVELS)
    with console.progress("Workspace") as now:
        found = workspace(mechanism, asked)
        now("assembly modes")
        rows = _modes(found, joints, seed)
        now("pictures")
        drawn = pictures(found)
    inputs = [*mechanism.inputs, *([str(joints)] if joints else [])]
    record = WorkspaceRecord.of(found, rows, provenance(inputs, command_line(), seed))
    with Output(out) as output:
        for name, text in record.files(found, rows).items():
            output.add(name, text)
        for name, picture in drawn.items():
            output.add(name, picture)
    _show(console, found, rows)
    console.warn([*mechanism.findings, *record.findings])
    finish(out, list(output.files), console)
    console.summary(record.entries())
    leave(bool(record.findings))


def _modes(found: Workspace, joints: Path | None, seed: int) -> list[ModeRow]:
    """Return the assembly modes at home's joints, or for each row of a file."""
    from ppmcal.design.assembly_modes import assembly_modes
    from ppmcal.errors import BadInput, NoResult
    from ppmcal.io import read_joints
    from ppmcal.io.results.workspace_tables import ModeRow
    from ppmcal.kinematics.closure import Model
    from ppmcal.kinematics.inverse import home_state

    model = Model(found.mechanism)
    wanted = [(0, home_state(found.mechanism).q)]
    if joints is not None:
        table = read_joints(joints, found.mechanism)
        wanted = [(int(n), q) for n, q in zip(table.rows, table.q, strict=True)]
        if not wanted:
            raise BadInput("has no rows", str(joints), "Give at least one row of joint values")
    out = []
    for n, q in wanted:
        try:
            out.append(ModeRow(n, q, assembly_modes(model, q, seed)))
        except NoResult as refused:
            out.append(ModeRow(n, q, None, refused.what))
    return out


def _show(console: Console, found: Workspace, rows: list[ModeRow]) -> None:
    """Say everything, with the tables that belong to it."""
    from ppmcal.io.results.workspace_tables import left_table, modes_table
    from ppmcal.io.results.workspace_wording import assembly_modes, reach, singularities

    for sentence in reach(found):
        console.say(sentence)
    if found.table.status.count("ok") < len(found.table.status):
        left = left_table(found)
        console.table(plain_table(left.columns, left.rows[:SHOWN], (1,)))
    for sentence in [*singularities(found), *assembly_modes(found, rows)]:
        console.say(sentence)
    table = modes_table(found, rows)
    if table is not None:
        console.table(plain_table(table.columns, table.rows[:SHOWN],
                                  tuple(range(len(table.columns) - 1))))
        if len(table.rows) > SHOWN:
            console.say(f"... and {len(table.rows) - SHOWN} more, see modes.csv.")
