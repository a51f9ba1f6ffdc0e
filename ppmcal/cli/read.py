"""``ppmcal read``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    FiniteRange,
    console_options,
    examples,
    leave,
    single_files,
)

if TYPE_CHECKING:
    from ppmcal.api.read import ReadResult


INPUT = click.Path(path_type=Path)
"""A file, or the folder of a bag."""


@click.command("read", epilog=examples(
    "ppmcal read log.csv points.txt --mechanism mine.yaml --out joined.csv",
    "ppmcal read log.csv points.txt --mechanism mine.yaml --join name --partial"))
@click.argument("files", type=INPUT, nargs=-1, required=True)
@click.option("--mechanism", type=MODEL, required=True, help="The machine that was measured.")
@click.option("--out", type=FILE, default="run.csv", show_default=True,
              help="CSV to write; its sidecar has the same stem.")
@click.option("--force", is_flag=True, help="Overwrite files that exist; never an input.")
@click.option("--sidecar", type=FILE, default=None,
              help="What the numbers are, and how to read them  [default: the YAML beside one of "
              "FILES].")
@click.option("--join", type=click.Choice(["name", "time"]), default=None,
              help="How points find their rows: a point's name is the log's `pose`, or by the "
              "nearest time  [default: name where names agree].")
@click.option("--tolerance", type=FiniteRange(min=0.0), default=0.5, show_default=True,
              metavar="S", help="How far apart two times may be, s.")
@click.option("--partial", is_flag=True,
              help="Leave out points and rows that match nothing, and name them.")
@click.option("--interpolate", is_flag=True,
              help="Joint values between the rows about a point's time, not those of the nearest.")
@click.option("--clock-offset", default=None, metavar="S|find",
              help="What the points' clock is ahead of the log's, s; find: from the motion that "
              "both saw, refused unless it is clear.")
@click.option("--names", default=None, metavar="PATTERN",
              help="How points are called where several targets are on the platform, such as "
              "{pose}_{target}: one CSV for each target.")
@click.option("--units", type=click.Choice(["m", "mm", "um", "in"]), default=None,
              help="Length unit of points whose header names none  [default: the sidecar's].")
@console_options
@single_files
def command(files: tuple[Path, ...], mechanism: Path, out: Path, force: bool,
            sidecar: Path | None, join: str | None, tolerance: float, partial: bool,
            interpolate: bool, clock_offset: str | None, names: str | None,
            units: str | None, console: Console) -> None:
    """Turn FILES of instruments and controllers into a measurement file.

    FILES are a table, or a joint log and lists of points (name, x, y, z, perhaps time), separated
    by commas, semicolons, tabs or spaces; or recordings of ROS (CSV or bag). Says what it
    understood, and writes a CSV and its sidecar.
    """
    from ppmcal.api.read import read

    inputs = [*files, mechanism, *([sidecar] if sidecar else [])]
    _refuse(out, inputs, force)
    result = read(files, mechanism, sidecar=sidecar, join=join, tolerance=tolerance,
                  partial=partial, interpolate=interpolate, clock_offset=clock_offset, names=names,
                  units=units, name=out.stem)
    for name in result.files():
        _refuse(out.with_name(name).with_suffix(".csv"),
                [Path(p) for p in result.provenance["inputs"]], force)
    for sentence in result.sentences:
        console.say(sentence)
    console.warn(result.findings)
    written = _write(result, out)
    console.say(f"Written: {', '.join(written)}")
    console.summary({**result.summary(), "written": written})
    leave(result.needs_a_look)


def _refuse(out: Path, inputs: list[Path], force: bool) -> None:
    """Refuse to replace an input, or what is there."""
    from ppmcal.errors import BadInput

    if out.suffix != ".csv":
        raise BadInput("is no name of a CSV", str(out), "Write --out run.csv")
    for place in (out, out.with_suffix(".yaml")):
        if any(place.exists() and p.exists() and place.samefile(p) for p in inputs):
            raise BadInput("is an input of this run, and its results would replace it",
                           str(place), "Give another --out")
        if place.exists() and not force:
            raise BadInput("exists already", str(place), "Give another --out, or --force")


def _write(result: ReadResult, out: Path) -> list[str]:
    """Write both files or none, and return their paths."""
    from ppmcal.io import Output

    output = Output(out.parent, loose=True)
    for name, content in result.files().items():
        output.add(name, content)
    return [str(path) for path in output.write()]
