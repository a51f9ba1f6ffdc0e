"""``ppmcal export``."""

from __future__ import annotations

import math
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
    from ppmcal.controllers.export import Exported

ROWS = 24
LEAST = 1e-4
"""Below so many mm or degrees it is arithmetic."""


@click.command("export")
@click.argument("form", metavar="FORMAT")
@click.argument("model", type=FILE)
@out_option("exported")
@click.option("--old", type=FILE, default=None,
              help="The controller's file in use, to predict the gain against  [default: the "
              "nominal values of MODEL].")
@click.option("--poses", type=FILE, default=None,
              help="Wanted poses, for formats that are tables of them.")
@quiet_option
@json_option
def command(form: str, model: Path, out: Path, old: Path | None, poses: Path | None, quiet: bool,
            as_json: bool) -> None:
    """Write MODEL as a controller's configuration takes it.

    FORMAT klipper: lines for the printer.cfg of a linear delta.
    FORMAT linuxcnc: HAL pins of genhexkins for a hexapod.
    FORMAT reprap: M665 and M666 of a linear delta.
    FORMAT joints: LinuxCNC compensation files, one for each actuator.
    FORMAT grid: a table of wanted poses, their corrected commands and joint values.

    The file is read back, and the machine is driven through the controller's own arithmetic
    with the old and the new numbers; what the controller cannot express is listed with what
    that costs. Writes the controller's file and export.json.
    """
    from dataclasses import replace

    from ppmcal.controllers.export import all_files, exporter, summary
    from ppmcal.controllers.model_uncertainty import KNOWLEDGE, certainty
    from ppmcal.io import Output, provenance, read_mechanism

    console = Console(quiet, as_json)
    writer = exporter(form)
    mechanism = read_mechanism(model)
    with console.progress("Fitting"):
        exported = writer.export(mechanism, old, poses)
        exported = replace(exported, certainty=certainty(mechanism, exported.poses, model))
    known = model.with_name(KNOWLEDGE) if exported.certainty.frame else None
    inputs = [*mechanism.inputs, *(str(p) for p in (old, poses, known) if p is not None)]
    source = provenance(inputs, command_line(), None)
    with Output(out) as output:
        for name, text in all_files(exported, mechanism.name, source).items():
            output.add(name, text)
    _show(exported, mechanism.name, console)
    findings = exported.findings
    console.warn(findings)
    finish(out, list(output.files), console)
    console.summary(summary(exported, mechanism.name, source))
    leave(bool(findings))


def _show(exported: Exported, name: str, console: Console) -> None:
    """Print the numbers, and what they are worth."""
    if not console.speaks:
        return
    console.say(f"{name}: {exported.said}.")
    if exported.numbers:
        console.table(plain_table(["parameter", "old", "new", "change", "unit"], [
            [n.name, "-" if n.old is None else f"{n.old:.4f}", f"{n.new:.4f}",
             "-" if n.old is None else f"{round(n.new - n.old, 4) + 0.0:+.4f}", n.unit]
            for n in exported.numbers[:ROWS]], (1, 2, 3)))
    if len(exported.numbers) > ROWS:
        console.say(f"... and {len(exported.numbers) - ROWS} more, all in export.json.")
    console.say(f"Error over {exported.over}, if the model is exact:")
    figures = (("old", exported.before), ("new", exported.after))
    turns = exported.after.rotation_rms is not None
    rows = [[label, f"{f.rms * 1e3:.4f}", f"{f.max * 1e3:.4f}", *(
        [f"{math.degrees(v or 0.0):.5f}" for v in (f.rotation_rms, f.rotation_max)]
        if turns else [])] for label, f in figures]
    console.table(plain_table(["", "rms mm", "max mm",
                               *(["rms deg", "max deg"] if turns else [])], rows, (1, 2, 3, 4)))
    console.say(_predicted(exported))
    for note in exported.notes:
        console.say(f"Note: {note}.")
    for line in exported.advice:
        console.say(line)


def _predicted(exported: Exported) -> str:
    """Return what is left with the new numbers: of the format, of the model, and together."""
    own, both = exported.certainty, exported.predicted
    lacks = _size(exported.after.rms, exported.after.rotation_rms)
    text = f"What the format cannot express: {lacks} rms; the model's own uncertainty: "
    if own.position is None or both is None:
        return f"{text}unknown, as {own.reason}. So the error to expect is unknown too."
    where = "the base frame" if own.frame == "base" else f"the frame of {own.frame}"
    return (f"{text}{_size(own.position, own.rotation)} (1 sigma, rms over the poses, in {where}). "
            f"Predicted error with the new numbers: {_size(both.rms, both.rotation_rms)} rms.")


def _size(position: float, rotation: float | None) -> str:
    turn = "" if rotation is None else f" and {_least(math.degrees(rotation))} deg"
    return f"{_least(position * 1e3)} mm{turn}"


def _least(value: float) -> str:
    return f"{value:.2g}" if value >= LEAST else f"below {LEAST:g}"
