"""``ppmcal import``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    finish,
    json_option,
    leave,
    out_option,
    quiet_option,
)
from ppmcal.wording import counted


@click.command("import")
@click.argument("form", metavar="FORMAT")
@click.argument("file", type=FILE)
@out_option("imported")
@click.option("--rods", type=click.Choice(["fixed", "shared", "single"]), default=None,
              help="Rods as drawn, one length for all, or one for each tower  [default: fixed "
              "without measured distances, else shared, or single where they differ].")
@quiet_option
@json_option
def command(form: str, file: Path, out: Path, rods: str | None, quiet: bool, as_json: bool
            ) -> None:
    """Turn a controller's configuration FILE into a machine and its measurements.

    FORMAT klipper: printer.cfg of a delta printer, with the heights and distances that
    DELTA_CALIBRATE saved in it. Writes machine.yaml, heights.csv and .yaml, and distances.csv and
    .yaml where there are any.
    """
    from ppmcal.controllers.klipper_config import find_format, read_printer
    from ppmcal.controllers.klipper_export import files, rods_of
    from ppmcal.io import Output, provenance

    console = Console(quiet, as_json)
    find_format(form)
    printer = read_printer(file)
    chosen = rods_of(printer, rods)
    with Output(out) as output:
        for name, text in files(printer, chosen).items():
            output.add(name, text)
    tables = [out / n for n in output.files if n.endswith(".csv")]
    console.say(f"{file}: a delta printer with {counted(len(printer.heights), 'height')} and "
                f"{counted(len(printer.distances), 'distance')}; rods {chosen}.")
    console.warn(printer.findings)
    finish(out, list(output.files), console)
    if tables:
        console.say_command("Next:", ["ppmcal", "identify", out / "machine.yaml", *tables])
    console.summary({"format": "ppmcal/import/1", "heights": len(printer.heights),
                     "distances": len(printer.distances), "rods": chosen,
                     "written": list(output.files), "findings": printer.findings,
                     "provenance": provenance([file], command_line(), None)})
    leave(bool(printer.findings))
