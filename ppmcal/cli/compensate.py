"""``ppmcal compensate``."""

from __future__ import annotations

import math
from pathlib import Path

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
    regardless_option,
)


@click.command("compensate", epilog=examples(
    "ppmcal compensate identified targets.csv --frame base"))
@click.argument("model", type=MODEL)
@click.argument("targets", type=FILE)
@out_option("compensated", "--overwrite")
@regardless_option("a model whose fit had not converged or whose residuals are far beyond the "
                   "noise of its own measurements, and of corrections that are predicted to be "
                   "worse than none")
@click.option("--frame", metavar="NAME", default=None,
              help="Data set whose measuring frame the targets are in: poses of the mark that it "
              "measured, which need not be the platform's origin. Or 'base': poses of the "
              "platform's origin in the base frame  [default: the model's only data set].")
@click.option("--knowledge", type=FILE, default=None,
              help="identification.json of MODEL  [default: beside it].")
@click.option("--approach", type=click.Choice(["columns", "sequence"]), default="columns",
              show_default=True, help="Directions of approach: from dir_ columns, or from the "
              "order of the targets.")
@click.option("--path/--no-path", default=True, show_default=True,
              help="Targets are visited in their order: judge the straight ways between them too, "
              "or each target alone.")
@click.option("--assume", metavar="NAME=VALUE", multiple=True,
              help="A condition of all targets that has no column, such as temperature=22.")
@console_options
def command(model: Path, targets: Path, out: Path, frame: str | None, knowledge: Path | None,
            approach: str, path: bool, assume: tuple[str, ...], regardless: bool,
            console: Console) -> None:
    """Turn the wanted poses TARGETS into corrected commands of the identified MODEL.

    Without --frame base, TARGETS say where the measured mark is to be, in the frame of the
    instrument that measured it; with it, where the platform's origin is to be, in base axes.

    Rows outside limits, across singularities, far outside the measured volume, farther from the
    uncorrected command than tolerances explain, worse off with the correction than without, or not
    to be come to safely from the row before are refused, each with its reason. A model whose
    fit had not converged, or whose residuals are far beyond the noise of its own measurements, is
    refused as a whole. --regardless lifts that, and the refusal of rows worse off; what may break
    the machine stays refused. Writes commands.csv and commands.json.
    """
    from ppmcal.api.compensate import compensate

    result = compensate(model, targets, frame=frame, knowledge=knowledge, approach=approach,
                        path=path, assume=_assumed(assume), regardless=regardless)
    written = result.save(out)
    console.say(result.headline())
    console.say(result.point())
    for kind, size in result.record.predicted.items():
        if size.words():
            console.say(f"Predicted {kind} error: {size.words()}.")
    if any(size.after is not None for size in result.record.predicted.values()):
        unexplained = result.knowledge is not None and any(result.knowledge.unexplained)
        console.say("What is left is how well the measurements know the machine (1 sigma, in the "
                    f"frame of {result.frame or 'its base'})"
                    f"{', with what they leave unexplained' * unexplained}.")
    console.warn_rows([*result.findings, *result.notes],
                      [f"row {n} refused: {r}" for n, r in result.refused])
    finish(out, [p.name for p in written], console)
    console.summary(result.record.summary())
    leave(result.needs_a_look)


def _assumed(given: tuple[str, ...]) -> dict[str, float]:
    """Return name -> value of what is assumed.

    Raises:
        click.UsageError: not of the form NAME=VALUE, or named twice.
    """
    out: dict[str, float] = {}
    for one in given:
        name, _, text = one.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not name or not math.isfinite(value):
            raise click.UsageError(f"--assume {one}: write NAME=VALUE, such as temperature=22.")
        if name in out:
            raise click.UsageError(f"--assume {one}: {name} has a value already.")
        out[name] = value
    return out
