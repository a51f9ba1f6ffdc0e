"""``ppmcal plan``."""

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
    seed_option,
)

if TYPE_CHECKING:
    pass

MOST_COUNT = 1000


@click.command("plan", epilog=examples("ppmcal plan mine.yaml --count 15"))
@click.argument("mech", type=MODEL)
@click.option("--count", type=click.IntRange(2, MOST_COUNT), default=None,
              help="Measurements to take  [default: until one more hardly helps].")
@click.option("--instrument", "sidecar", type=FILE, default=None, metavar="SIDECAR.yaml",
              help="What measures, as beside a measurement file  [default: the full pose, a "
              "tenth of the tolerances].")
@click.option("--tasks", type=FILE, default=None, metavar="POSES.csv",
              help="Poses at which the machine has to be exact  [default: the whole region].")
@click.option("--candidates", type=FILE, default=None, metavar="POSES.csv",
              help="Poses to choose from  [default: drawn in the machine's region].")
@click.option("--for", "kinds", multiple=True, metavar="KINDS",
              help="Effects to be shown too, such as backlash,compliance.")
@click.option("--payload", metavar="LOW,HIGH", default=None,
              help="Payloads that can be put on, kg.")
@click.option("--temperature", metavar="LOW,HIGH", default=None,
              help="Temperatures that can be set, deg C.")
@click.option("--accuracy", type=float, default=None,
              help="Wanted standard deviation of position at the tasks, in MECH's length unit.")
@out_option("plan")
@seed_option
@console_options
def command(mech: Path, count: int | None, sidecar: Path | None, tasks: Path | None,
            candidates: Path | None, kinds: tuple[str, ...], payload: str | None,
            temperature: str | None, accuracy: float | None, out: Path, seed: int | None,
            console: Console) -> None:
    """Choose the poses of MECH that are worth measuring.

    D-optimal for the parameters that MECH leaves free, with its tolerances as prior; ordered
    into a short path. Writes poses.csv, accuracy.csv, plan.json and accuracy.png.
    """
    from ppmcal.api.plan import plan

    result = plan(mech, count=count, instrument=sidecar, tasks=tasks, candidates=candidates,
                  effects=kinds, payload=payload, temperature=temperature, accuracy=accuracy,
                  seed=seed or 0)
    written = result.save(out)
    console.say(f"{result.mechanism.name}:")
    for sentence in result.record.said:
        console.say(sentence)
    console.warn([*result.mechanism.findings, *result.findings])
    finish(out, [p.name for p in written], console)
    console.summary({k: v for k, v in result.record.entries().items()
                     if k not in ("tables", "pictures")})
    leave(bool(result.findings))


