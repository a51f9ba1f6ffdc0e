"""``ppmcal import``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    finish,
    json_option,
    leave,
    out_option,
    quiet_option,
)


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
    from ppmcal.api.import_ import import_config

    console = Console(quiet, as_json)
    result = import_config(form, file, rods=rods)
    written = result.save(out)
    tables = [p for p in written if p.suffix == ".csv"]
    console.say(result.headline())
    console.warn(result.findings)
    finish(out, [p.name for p in written], console)
    if tables:
        console.say_command("Next:", ["ppmcal", "identify", out / "machine.yaml", *tables])
    printer = result.printer
    console.summary({"format": "ppmcal/import/1", "heights": len(printer.heights),
                     "distances": len(printer.distances), "rods": result.rods,
                     "written": [p.name for p in written], "findings": list(result.findings),
                     "provenance": result.provenance})
    leave(bool(result.findings))
