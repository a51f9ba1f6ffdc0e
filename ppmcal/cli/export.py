"""``ppmcal export``."""

from __future__ import annotations

from collections.abc import Iterator
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
    regardless_option,
)

if TYPE_CHECKING:
    from rich.table import Table

    from ppmcal.io.results.export import ExportRecord

ROWS = 24


@click.command("export", epilog=examples(
    "ppmcal export klipper fitted-printer --old printer.cfg --write",
    "ppmcal export grid identified --poses targets.csv"))
@click.argument("form", metavar="FORMAT", shell_complete=completion.exports)
@click.argument("model", type=MODEL)
@out_option("exported", "--overwrite")
@regardless_option("a model whose fit had not converged or whose residuals are far beyond the "
                   "noise of its own measurements, and of numbers that are worse than the old ones")
@click.option("--old", type=FILE, default=None,
              help="The controller's file in use, to predict the gain against  [default: the "
              "nominal values of MODEL].")
@click.option("--write", is_flag=True,
              help="Write a copy of --old with the new numbers as well (klipper), such as its own "
              "reader takes them.")
@click.option("--poses", type=FILE, default=None,
              help="Wanted poses, for formats that are tables of them.")
@console_options
def command(form: str, model: Path, out: Path, old: Path | None, write: bool, poses: Path | None,
            regardless: bool, console: Console) -> None:
    """Write MODEL as a controller's configuration takes it.

    FORMAT klipper: lines for the printer.cfg of a linear delta.
    FORMAT linuxcnc: HAL pins of genhexkins for a hexapod.
    FORMAT reprap: M665 and M666 of a linear delta.
    FORMAT joints: LinuxCNC compensation files, one for each actuator.
    FORMAT grid: a table of wanted poses, their corrected commands and joint values.

    The file is read back, and the machine is driven through the controller's own arithmetic
    with the old and the new numbers; what the controller cannot express is listed with what
    that costs. Refused, unless --regardless says so: a model whose fit had not converged or
    whose residuals are far beyond the noise of its own measurements, and numbers that are
    predicted to be worse than the old ones.
    Writes the controller's file and export.json.
    """
    from ppmcal.api.export import export

    result = export(form, model, old=old, poses=poses, write=write, regardless=regardless)
    written = result.save(out)
    _show(result.record, console)
    console.warn(result.findings)
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(bool(result.findings))


def _show(record: ExportRecord, console: Console) -> None:
    """Print the numbers, and what they are worth."""
    if not console.speaks:
        return
    console.say(f"{record.name}: {record.said}.")
    if record.parameters:
        console.table(plain_table(["parameter", "old", "new", "change", "unit"],
                                  list(_numbers(record))[:ROWS], (1, 2, 3)))
    if len(record.parameters) > ROWS:
        console.say(f"... and {len(record.parameters) - ROWS} more, all in export.json.")
    console.say(f"Predicted error over {record.over}; \"expected\" counts the model's own "
                "uncertainty too:")
    console.table(_errors(record))
    console.say(record.predicted.sentence())
    for note in record.notes:
        console.say(f"Note: {note}.")
    for line in record.advice:
        console.say(line)


def _errors(record: ExportRecord) -> Table:
    """Return the table of errors with the old and the new numbers."""
    from ppmcal.io.results.export import error_size

    rows = [[label, *(error_size(v, part.unit) or "unknown" for part in (e, e.rotation)
                      if part is not None for v in (part.rms, part.max))]
            for label, e in (("old, model exact", record.gain.before),
                             ("new, model exact", record.gain.after))]
    for label, size in (("old, expected", record.predicted.before),
                        ("new, expected", record.predicted.after)):
        expected = [error_size(size.rms, size.unit) or "unknown", ""]
        if record.gain.after.rotation is not None:
            turn = size.rotation
            expected += [error_size(turn.rms, turn.unit) if turn else "unknown", ""]
        rows.append([label, *expected])
    turns = ["rms deg", "max deg"] * (record.gain.after.rotation is not None)
    return plain_table(["", "rms mm", "max mm", *turns], rows, (1, 2, 3, 4))


def _numbers(record: ExportRecord) -> Iterator[list[str]]:
    """Yield the rows of the table of numbers."""
    from ppmcal.io.results.export import fixed

    for name, new in record.parameters.items():
        old = record.old.get(name)
        if name.endswith(" points"):    # a count, not a length
            yield [name, "-", f"{new:.0f}", "-", ""]
            continue
        change = "-" if old is None or new is None else f"{round(new - old, 4) + 0.0:+.4f}"
        yield [name, fixed(old) or "-", fixed(new), change, record.number_units.get(name, "")]
