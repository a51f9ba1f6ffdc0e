"""``ppmcal sensitivity``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli import completion
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
)
from ppmcal.wording import number

if TYPE_CHECKING:
    from rich.table import Table

    from ppmcal.design.sensitivity import Sensitivity

SHOWN = 10


@click.command("sensitivity", epilog=examples("ppmcal sensitivity mine.yaml --home-only"))
@click.argument("mech", type=MODEL)
@out_option("sensitivity")
@click.option("--poses", type=FILE, default=None, help="Poses to look at, a CSV.")
@click.option("--grid", default=None, metavar="NAME[=LOW:HIGH[:COUNT]],...",
              help="Poses of a grid about home, such as x=-100:100:41,y  [default: a map of the "
              "first two coordinates].")
@click.option("--home-only", is_flag=True, help="Look at home alone, draw no maps.")
@click.option("--all-components", is_flag=True,
              help="All error components of every joint frame and the platform points (21 for a "
              "leg), also those that the closure cancels.")
@click.option("--free", multiple=True, metavar="PATTERN",
              shell_complete=completion.parameters,
              help="Errors to look at, by name  [default: the file's free parameters].")
@click.option("--tool", default=None, metavar="X,Y,Z",
              help="Tool point in platform axes  [default: the platform origin].")
@click.option("--metric", type=float, default=None, metavar="LENGTH",
              help="An angular error of sigma/LENGTH counts like a length error of sigma in the "
              "amplification index  [default: the platform joints' rms distance].")
@click.option("--sigmas", type=float, default=1.0, show_default=True,
              help="Worst case: every error at this many standard deviations.")
@click.option("--together", multiple=True, metavar="PATTERN",
              help="Try the linear model with these errors all off by the same amount  [default: "
              "all errors at once by their tolerances].")
@click.option("--size", type=float, default=None, metavar="ERROR",
              help="With --together: also print what an error of this size does.")
@console_options
def command(mech: Path, out: Path, poses: Path | None, grid: str | None, home_only: bool,
            all_components: bool, free: tuple[str, ...], tool: str | None, metric: float | None,
            sigmas: float, together: tuple[str, ...], size: float | None, console: Console) -> None:
    """Tell what each geometric error of MECH does to the tool.

    Writes sensitivity.csv (the Jacobian at home, errors ranked), map.csv (amplification index,
    root sum square and worst case by pose), linearity.csv, pictures and sensitivity.json.
    """
    from ppmcal.api.sensitivity import sensitivity

    result = sensitivity(mech, poses=poses, grid=grid, home_only=home_only,
                         all_components=all_components, free=free, tool=tool, metric=metric,
                         sigmas=sigmas, together=together, size=size)
    written = result.save(out)
    for sentence in result.record.said:
        console.say(sentence)
    console.table(_ranking(result.sensitivity))
    console.warn(result.findings)
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(result.needs_a_look)


def _ranking(found: Sensitivity) -> Table:
    """Return the errors that count most, for the console."""
    from ppmcal.io.results.record import in_units
    from ppmcal.io.results.sensitivity_tables import ranking, rotates

    units, both = found.mechanism.units, rotates(found)
    table, mm, deg = in_units(ranking(found), units), units.length, units.angle
    rows = [[table["name"][i], f"{number(table['tolerance'][i])} {table['unit'][i]}",
             number(table["rss_position"][i]), f"{table['share_position'][i]:.1%}",
             *([number(table["rss_rotation"][i])] if both else [])]
            for i in range(min(SHOWN, len(table["name"])))]
    heads = ["error", "tolerance", f"tool rms, {mm}", "share", *([f"rms, {deg}"] if both else [])]
    return plain_table(heads, rows, (1, 2, 3, 4))
