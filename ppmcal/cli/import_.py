"""``ppmcal import``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli import completion
from ppmcal.cli.common import (
    FILE,
    Console,
    console_options,
    examples,
    finish,
    leave,
    out_option,
)


@click.command("import", epilog=examples("ppmcal import klipper printer.cfg"))
@click.argument("form", metavar="FORMAT", shell_complete=completion.imports)
@click.argument("file", type=FILE)
@out_option("imported")
@click.option("--rods", multiple=True, metavar="MM|fixed|shared|single",
              help="Length of the rods as you measured it, mm; and rods as drawn, one length for "
              "all, or one for each tower  [default: shared, or single where they differ]. Repeat "
              "to give both.")
@click.option("--radius", type=float, default=None, metavar="MM",
              help="delta_radius (R of M665) as you measured it, mm: from the joints at a tower to "
              "those at the effector, seen from above  [default: as the file has it].")
@click.option("--mesh", multiple=True, metavar="NAME|FILE",
              help="A probed bed, as touches with their direction of travel: the name of a mesh "
              "that Klipper saved, a log of its touches, or RepRapFirmware's heightmap.csv. "
              "Repeatable.")
@click.option("--scale", type=click.Choice(["printed", "known", "unknown"]), default="printed",
              show_default=True, help="What measured distances are: those of a printed part, which "
              "shrinks; true; or all off by a factor that nothing is known of.")
@console_options
def command(form: str, file: Path, out: Path, rods: tuple[str, ...], radius: float | None,
            mesh: tuple[str, ...], scale: str, console: Console) -> None:
    """Turn a controller's configuration FILE into a machine and its measurements.

    FORMAT klipper: printer.cfg of a delta printer, with the heights and distances that
    DELTA_CALIBRATE saved in it, and its meshes. FORMAT reprap: config.g of RepRapFirmware.
    Writes machine.yaml (the printer as it was meant to be), saved.yaml (as a calibration left
    it), and heights, distances and mesh_NAME as .csv and .yaml where there are any.
    """
    from ppmcal.api.import_ import import_config

    result = import_config(form, file, rods=rods, mesh=mesh, scale=scale, radius=radius)
    written = result.save(out)
    tables = [p for p in written if p.suffix == ".csv"]
    console.say(result.headline())
    console.warn(result.findings)
    finish(out, [p.name for p in written], console)
    if tables:
        console.say_command("Next:", ["ppmcal", "identify", out / "machine.yaml", *tables])
    console.summary({**result.summary(), "written": [p.name for p in written]})
    leave(bool(result.findings))
