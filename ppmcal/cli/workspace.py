"""``ppmcal workspace``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    console_options,
    examples,
    finish,
    leave,
    out_option,
    plain_table,
    seed_option,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ppmcal.design.workspace import Workspace
    from ppmcal.io.results.workspace_tables import ModeRow

    Array = NDArray[Any]

SHOWN = 10


@click.command("workspace", epilog=examples("ppmcal workspace mine.yaml"))
@click.argument("mech", type=MODEL)
@click.option("--grid", metavar="TEXT", default=None,
              help="Coordinates with range and levels, such as x=-300:300:41,rz. "
                   "Default: the first two, as far as home can go.")
@click.option("--joints", type=FILE, default=None,
              help="CSV of joint values to find assembly modes for. Default: home's.")
@out_option("workspace")
@seed_option
@console_options
def command(mech: Path, grid: str | None, joints: Path | None, out: Path, seed: int | None,
            console: Console) -> None:
    """Show where MECH can go, its singularities, dexterity and assembly modes.

    Geometry only: effects in MECH are left out. Writes map.csv, singular.csv, modes.csv,
    workspace.json and a picture of each map.
    """
    from ppmcal.api.workspace import workspace

    result = workspace(mech, grid=grid, joints=joints, seed=seed or 0)
    written = result.save(out)
    _show(console, result.workspace, list(result.modes))
    console.warn([*result.mechanism.findings, *result.findings])
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(bool(result.findings))


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
