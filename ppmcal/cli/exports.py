"""``ppmcal export``."""

from __future__ import annotations

from collections.abc import Iterable
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

if TYPE_CHECKING:
    from ppmcal.controllers.klipper_fit import Export
    from ppmcal.files.klipper import Config, Geometry


@click.command("export")
@click.argument("form", metavar="FORMAT")
@click.argument("model", type=FILE)
@out_option("exported")
@click.option("--old", type=FILE, default=None,
              help="The printer.cfg in use, to predict the gain against  [default: the nominal "
              "values of MODEL].")
@quiet_option
@json_option
def command(form: str, model: Path, out: Path, old: Path | None, quiet: bool, as_json: bool
            ) -> None:
    """Write MODEL as lines to paste into a controller's configuration.

    FORMAT klipper: a delta printer. The machine is driven through the controller's own
    arithmetic with the old and the new lines, and what it cannot express is listed with what
    that costs. Writes klipper.cfg and export.json.
    """
    from ppmcal.controllers.klipper_fit import project
    from ppmcal.files import Output, provenance, read_mechanism
    from ppmcal.files.klipper import find_format, read_config, read_geometry
    from ppmcal.outputs.klipper_export import CONFIG, files, keys, same_again, summary

    console = Console(quiet, as_json)
    find_format(form)
    mechanism = read_mechanism(model)
    present = None if old is None else read_config(old)
    before = None if present is None else read_geometry(present)
    with console.progress("Fitting"):
        export = project(mechanism, before)
    inputs = [*mechanism.inputs, *([str(old)] if old is not None else [])]
    source = provenance(inputs, command_line(), None)
    with Output(out) as output:
        for name, text in files(export, mechanism.name, source).items():
            output.add(name, text)
    same_again(read_geometry(read_config(out / CONFIG)), export.new)
    _show(export, mechanism.name, export.old, console)
    held = [] if present is None else _autosaved(present, keys(export.new))
    if held:
        console.say(f"Change these in the #*# lines of {old}, which win over all others: "
                    f"{', '.join(held)}.")
    findings = _findings(export)
    console.warn(findings)
    finish(out, list(output.files), console)
    console.summary(summary(export, mechanism.name, source))
    leave(bool(findings))


def _autosaved(config: Config, names: Iterable[str]) -> list[str]:
    """Return which ``section.key`` stand in the lines that the printer saved itself."""
    split = ((name, *name.split(".")) for name in names)
    return [name for name, section, key in split
            if key in config.sections.get(section, {}) and config.sections[section][key].saved]


def _findings(export: Export) -> list[str]:
    """Return what the user must look at."""
    out = []
    for lack in export.lacks:
        cost = "" if lack.cost is None else (
            f": costs {lack.cost.rms * 1e3:.4f} mm rms, {lack.cost.max * 1e3:.4f} mm at most")
        out.append(f"cannot be expressed: {lack.what}{cost}")
    if export.after.rms > export.before.rms + 1e-8:
        out.append("the new lines are worse than the old ones over this workspace")
    return out


def _show(export: Export, name: str, old: Geometry, console: Console) -> None:
    """Print the lines, and what they are worth."""
    if not console.speaks:
        return
    from ppmcal.outputs.klipper_export import keys

    console.say(f"{name}: Klipper's numbers hold "
                f"{'all of the geometry' if export.exact else 'most of it, fitted'}.")
    before = keys(old)
    console.table(plain_table(["parameter", "old", "new", "change"], [
        [key, f"{before[key]:.4f}", f"{value:.4f}", f"{round(value - before[key], 4) + 0.0:+.4f}"]
        for key, value in keys(export.new).items()], (1, 2, 3)))
    console.say(f"Predicted error in mm, driving the model over {len(export.points)} points, "
                f"{export.radius * 1e3:.0f} mm around the middle, z 0 to 100 mm, where on the bed "
                "a print lies aside:")
    console.table(plain_table(["lines", "rms", "max"], [
        [label, f"{found.rms * 1e3:.4f}", f"{found.max * 1e3:.4f}"]
        for label, found in (("old", export.before), ("new", export.after))], (1, 2)))
    console.say("How well the measurements know the model is in its identification.json.")
    for note in export.notes:
        console.say(f"Note: {note}.")
