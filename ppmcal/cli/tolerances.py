"""``ppmcal tolerances``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    cluster_options,
    console_options,
    examples,
    finish,
    leave,
    out_option,
    plain_table,
    seed_option,
)
from ppmcal.wording import number

if TYPE_CHECKING:
    from ppmcal.io.results.design import ShownTable


@click.command("tolerances", epilog=examples(
    "ppmcal tolerances mine.yaml --accuracy 0.2 --machines 50"))
@click.argument("mech", type=MODEL)
@out_option("tolerances")
@click.option("--accuracy", type=float, default=None, metavar="LENGTH",
              help="Largest position error of the tool that is allowed.")
@click.option("--rotation", type=float, default=None, metavar="ANGLE",
              help="Largest rotation error that is allowed.")
@click.option("--yield", "share", type=float, default=0.95,
              show_default=True, help="Share of machines that must meet it, before calibration.")
@click.option("--method", type=click.Choice(["cost", "equal", "mean", "file"]), default="cost",
              show_default=True, help="Which tolerances to verify: of least cost, of equal "
              "contributions, one for all, or the file's own.")
@click.option("--poses", type=FILE, default=None,
              help="Task poses, a CSV  [default: drawn over the workspace].")
@click.option("--instrument", type=FILE, default=None, metavar="SIDECAR",
              help="Calibrate with this instrument, a data set's YAML  [default: one whose noise "
              "is a tenth of the accuracy].")
@click.option("--measure", type=click.IntRange(4, 1000), default=30, show_default=True,
              help="Poses that a calibration measures.")
@click.option("--machines", type=click.IntRange(20, 10_000_000), default=1000, show_default=True,
              help="Machines to simulate.")
@click.option("--metric", type=float, default=None, metavar="LENGTH",
              help="An angle of sigma/LENGTH counts like a length of sigma  [default: the platform "
              "joints' rms distance].")
@click.option("--tool", default=None, metavar="X,Y,Z", help="Tool point in platform axes.")
@cluster_options
@seed_option
@console_options
def command(mech: Path, out: Path, accuracy: float | None, rotation: float | None, share: float,
            method: str, poses: Path | None, instrument: Path | None, measure: int,
            machines: int, metric: float | None, tool: str | None, cores: int | None,
            scheduler: str | None, seed: int | None, console: Console) -> None:
    """Find tolerances with which MECH keeps an accuracy, and count the machines that do.

    Writes tolerances.csv, errors.csv, allocated.yaml (the machine with these tolerances),
    yield.png and tolerances.json.
    """
    from ppmcal.api.tolerances import tolerances
    from ppmcal.io.results.tolerance_tables import slot_table

    result = tolerances(mech, accuracy=accuracy, rotation=rotation, share=share,
                        method=method, poses=poses, instrument=instrument, measure=measure,
                        machines=machines, metric=metric, tool=tool, cores=cores,
                        scheduler=scheduler, seed=seed or 0)
    written = result.save(out)
    for sentence in result.record.said:
        console.say(sentence)
    _tolerances_by_slot(console, slot_table(result.found))
    console.warn(result.findings)
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(result.needs_a_look)


def _tolerances_by_slot(console: Console, slots: ShownTable) -> None:
    rows = [[r[0], str(r[1]), *(number(v, 3) for v in r[3:]), r[2]] for r in slots.rows]
    console.say(f"{slots.title}:")
    console.table(plain_table(["slot", "errors", *slots.columns[3:], "unit"], rows,
                              (1, 2, 3, 4, 5)))
