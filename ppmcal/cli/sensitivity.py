"""``ppmcal sensitivity``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

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
)
from ppmcal.wording import number

if TYPE_CHECKING:
    from rich.table import Table

    from ppmcal.design.sensitivity import Sensitivity
    from ppmcal.kinematics.region import Grid
    from ppmcal.model.mechanism import Mechanism

SHOWN = 10


@click.command("sensitivity")
@click.argument("mech", type=FILE)
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
@quiet_option
@json_option
def command(mech: Path, out: Path, poses: Path | None, grid: str | None, home_only: bool,
            all_components: bool, free: tuple[str, ...], tool: str | None, metric: float | None,
            sigmas: float, together: tuple[str, ...], size: float | None, quiet: bool,
            as_json: bool) -> None:
    """Tell what each geometric error of MECH does to the tool.

    Writes sensitivity.csv (the Jacobian at home, errors ranked), map.csv (amplification index,
    root sum square and worst case by pose), linearity.csv, pictures and sensitivity.json.
    """
    from ppmcal.design.error_sources import all_components as components
    from ppmcal.design.sensitivity import SensitivityOptions, analyse
    from ppmcal.errors import BadInput
    from ppmcal.io import Output, provenance, read_mechanism, read_poses
    from ppmcal.io.grid import metric_length, read_point
    from ppmcal.io.results.sensitivity import SensitivityRecord

    console = Console(quiet, as_json)
    machine = read_mechanism(mech)
    mesh = _grid(machine, grid, poses, home_only)
    point, rho = read_point(tool, machine), metric_length(metric, machine)
    if not 0.0 < sigmas < 1e6:
        raise BadInput(f"{sigmas:g} is not a number of standard deviations", "--sigmas",
                       "Write one above 0, such as 3")
    looked = components(machine) if all_components else machine
    if free:
        looked = _narrowed(looked, free)
    wanted = mesh.poses(machine) if mesh else read_poses(poses, machine).poses if poses else None
    inputs = [*machine.inputs, *([str(poses)] if poses else [])]
    with console.progress("Looking at errors"):
        found = analyse(looked, SensitivityOptions(point, rho, sigmas, together,
                                      _size(looked, together, size)), wanted)
        record = SensitivityRecord.of(found, machine, mesh,
                                      provenance(inputs, command_line(), None))
        content = record.files(found, mesh, poses is not None)
    with Output(out) as output:
        for name, text in content.items():
            output.add(name, text)
    for sentence in record.said:
        console.say(sentence)
    console.table(_ranking(found))
    console.warn(record.findings)
    finish(out, list(output.files), console)
    console.summary(record.entries())
    leave(bool(record.findings))


def _grid(machine: Mechanism, grid: str | None, poses: Path | None, home_only: bool
          ) -> Grid | None:
    from ppmcal.errors import BadInput
    from ppmcal.io.grid import read_grid

    if sum((grid is not None, poses is not None, home_only)) > 1:
        raise BadInput("only one of --poses, --grid and --home-only can be given", "",
                       "Leave the others out")
    return None if poses is not None or home_only else read_grid(grid, machine)


def _size(machine: Mechanism, together: tuple[str, ...], size: float | None) -> float | None:
    """Return the size of errors moved together in SI."""
    from ppmcal.errors import BadInput

    if size is None:
        return None
    if not together:
        raise BadInput("goes with --together", "--size", "Name the errors that are off by it")
    if not 0.0 < abs(size) < 1e12:
        raise BadInput(f"{size:g} is not the size of an error", "--size", "Write another number")
    named = [p for i in machine.free for p in (machine.parameters[i],)
             if any(p.matches(t) for t in together)]
    return size * machine.units.factor(named[0].quantity if named else "length")


def _narrowed(machine: Mechanism, patterns: tuple[str, ...]) -> Mechanism:
    from dataclasses import replace

    from ppmcal.errors import unknown
    from ppmcal.model.parameters import unmatched

    for pattern in unmatched(machine.parameters, patterns):
        raise unknown("parameter", pattern, machine.names, "--free")
    return replace(machine, free=tuple(
        i for i, p in enumerate(machine.parameters) if any(p.matches(t) for t in patterns)))


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
