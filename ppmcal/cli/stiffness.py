"""``ppmcal stiffness``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

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

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


    Array = NDArray[np.float64]


@click.command("stiffness", epilog=examples("ppmcal stiffness mine.yaml --load fz=-100"))
@click.argument("mech", type=MODEL)
@click.option("--grid", "grid_text", metavar="TEXT", default=None,
              help="Coordinates of the map, such as x=-300:300:41,y.")
@click.option("--poses", type=FILE, default=None, help="Poses instead of a grid.")
@click.option("--load", "load_text", metavar="TEXT", default=None,
              help="Load at the tool point, base axes, N and N m: fx=0,fy=0,fz=-100.")
@click.option("--payload", type=float, default=None, help="Mass at the tool point, kg.")
@click.option("--tool", "tool_text", metavar="TEXT", default=None,
              help="Tool point in platform axes: x,y,z. Default: the platform's origin.")
@out_option("stiffness")
@console_options
def command(mech: Path, grid_text: str | None, poses: Path | None, load_text: str | None,
            payload: float | None, tool_text: str | None, out: Path, console: Console) -> None:
    """How far the tool of MECH gives way under load, at home and over a map.

    MECH says how stiff bars, drives and joints are under `stiffness`. Writes map.csv,
    stiffness.json and pictures of the map.
    """
    from ppmcal.api.stiffness import stiffness
    from ppmcal.io.results.stiffness_tables import share_table

    result = stiffness(mech, grid=grid_text, poses=poses, load_at_tool=load_text,
                       payload=payload, tool=tool_text)
    written = result.save(out)
    console.say(f"{result.mechanism.name}:")
    for sentence in result.record.said:
        console.say(sentence)
    shares = share_table(result.study)
    if shares.rows:
        console.say(f"{shares.title}. {shares.note}")
        console.table(plain_table(shares.columns, shares.rows, range(1, len(shares.columns))))
    console.warn_rows([*result.mechanism.findings, *result.findings], result.failed)
    finish(out, [p.name for p in written], console)
    console.summary({k: v for k, v in result.record.entries().items()
                     if k not in ("tables", "pictures", "units")})
    leave(bool(result.findings or result.failed))


