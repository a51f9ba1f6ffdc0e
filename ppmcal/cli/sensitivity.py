"""``ppmcal sensitivity``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    effects_words,
    finish,
    json_option,
    leave,
    number,
    out_option,
    plain_table,
    quiet_option,
)

if TYPE_CHECKING:
    from rich.table import Table

    from ppmcal.design.sensitivity import Sensitivity
    from ppmcal.kinematics.region import Grid
    from ppmcal.model.mechanism import Mechanism

SHOWN = 10
BAD, FAR = 0.1, 3.0
"""A finding: the linear model is wrong by this part before this many tolerances."""


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
    from ppmcal.io.results.sensitivity import files

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
        said = [*sentences(found, mesh), *effects_words(machine)]
        findings = _findings(machine, found, mesh)
        source = provenance(inputs, command_line(), None)
        content = files(found, mesh, poses is not None, said, findings, source)
    with Output(out) as output:
        for name, text in content.items():
            output.add(name, text)
    for sentence in said:
        console.say(sentence)
    console.table(_ranking(found))
    console.warn(findings)
    finish(out, list(output.files), console)
    from ppmcal.io.results.sensitivity import ranking, record

    console.summary(record(found, (), ranking(found), said, findings, source))
    leave(bool(findings))


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


def sentences(found: Sensitivity, grid: Grid | None) -> list[str]:
    """Return the results in words."""
    import numpy as np

    from ppmcal.io.results.sensitivity import WRONG, at_size, holds_to, size_unit, turns

    units, home, both = found.mechanism.units, found.home, turns(found)
    length, angle = units.factor("length"), units.factor("angle")
    rho = f"{number(found.asked.metric / length)} {units.length}"

    def pair(position: float, rotation: float) -> str:
        text = f"{number(position / length)} {units.length}"
        return text + (f" and {number(rotation / angle)} {units.angle}" if both else "")

    turned = (f" and {number(found.home_index[1] * length / angle)} {units.angle}/{units.length}"
              if both else "")
    times = (f"{found.asked.sigmas:g} tolerances" if found.asked.sigmas != 1.0
             else "its tolerance")
    out = [f"{found.mechanism.name}: {len(found.sources)} errors. At home the tool is off by "
           f"{pair(home.position[0], home.rotation[0])} (root sum square, each error one "
           f"tolerance), at worst by {pair(home.worst_position[0], home.worst_rotation[0])} with "
           f"every error at {times}.",
           f"Error amplification at home: {number(found.home_index[0], 5)} "
           f"{units.length}/{units.length}{turned} (all errors alike; angles count by {rho})."]
    good = np.isfinite(found.index[:, 0])
    if 1 == good.sum() < len(good):
        out.append(f"Only 1 of {len(good)} poses can be used, see status in map.csv.")
    if good.sum() > 1:
        low, high = np.nanmin(found.index[:, 0]), np.nanmax(found.index[:, 0])
        least = found.table.pose[int(np.nanargmin(found.index[:, 0]))]
        place = ", ".join(
            f"{name} = {number(_tidy(least[c] / units.factor('length' if c < 3 else 'angle')))}"
            for name, c in zip(found.mechanism.coordinates, found.mechanism.dof, strict=True)
            if grid is None or c in grid.coordinates)
        out.append(f"Over {int(good.sum())} of {len(good)} poses it goes from {number(low)} to "
                   f"{number(high)}; it is least at {place}.")
    one = at_size(found)
    if one is not None and not one["reached"]:
        out.append(f"{one['errors']} errors of {one['size']:g} {one['size_unit']} together are too "
                   "large: the machine has no pose at home's joint values then.")
    elif one is not None:
        turned = "" if not both else (
            f" and turn it by {number(one['linear_rotation'], 7)} {one['rotation_unit']} "
            f"(linear), {number(one['exact_rotation'], 7)} {one['rotation_unit']} (nonlinear)")
        out.append(f"{one['errors']} errors of {one['size']:g} {one['size_unit']} together move "
                   f"the tool by {number(one['linear'], 7)} {one['unit']} (linear), "
                   f"{number(one['exact'], 7)} {one['unit']} (nonlinear), apart by "
                   f"{number(one['relative'], 3)} of it{turned}.")
    to = holds_to(found)
    what = ("All errors tried" if not found.asked.together else " and ".join(found.asked.together))
    if to is None:
        out.append(f"{what}: the linear model is right to {WRONG:.0%} at every size tried.")
    else:
        out.append(f"{what}: the linear model is right to {WRONG:.0%} up to {number(to, 3)} "
                   f"{size_unit(found)}.")
    return out


def home_limits(machine: Mechanism) -> str:
    """Return which joint is outside its limits at home, empty if none."""
    from ppmcal.kinematics.inverse import home_state
    from ppmcal.kinematics.tables import limit_reason

    return limit_reason(machine, home_state(machine).q)


def _tidy(value: float) -> float:
    """Return 0 for what is only round-off."""
    return 0.0 if abs(value) < 1e-9 else value


def _findings(machine: Mechanism, found: Sensitivity, grid: Grid | None) -> list[str]:
    """Return what must be looked at: poses of a file that cannot be reached, wrong linear model."""
    from ppmcal.io.results.sensitivity import unknown

    out = list(machine.findings)
    lost = unknown(found)
    if lost:
        out.append(f"{lost[0]}{f' and {len(lost) - 1} more' if len(lost) > 1 else ''} without a "
                   "finite tolerance: root sum square, worst case and shares leave them out")
    if home_limits(machine):
        out.append(f"home is not within limits: {home_limits(machine)}")
    if grid is None and len(found.table.status) > 1:
        out += [f"row {n + 1}: {r}" for n, (s, r) in enumerate(
            zip(found.table.status, found.table.reason, strict=True))
            if s != "ok"]
    to = found.linear.holds_to(BAD)
    if not found.asked.together and to < FAR:
        out.append(f"the linear model is wrong by more than {BAD:.0%} from about {to:.2g} times "
                   "the tolerances on: trust Monte Carlo (ppmcal tolerances) instead")
    return out


def _ranking(found: Sensitivity) -> Table:
    """Return the errors that count most, for the console."""
    from ppmcal.io.results.sensitivity import ranking, turns

    table, mm, deg = ranking(found), found.mechanism.units.length, found.mechanism.units.angle
    both = turns(found)
    rows = [[table["name"][i], f"{number(table['tolerance'][i])} {table['unit'][i]}",
             number(table["rss_position"][i]), f"{table['share_position'][i]:.1%}",
             *([number(table["rss_rotation"][i])] if both else [])]
            for i in range(min(SHOWN, len(table["name"])))]
    heads = ["error", "tolerance", f"tool rms, {mm}", "share", *([f"rms, {deg}"] if both else [])]
    return plain_table(heads, rows, (1, 2, 3, 4))
