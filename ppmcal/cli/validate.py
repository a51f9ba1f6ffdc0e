"""``ppmcal validate``."""

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
    seed_option,
)
from ppmcal.wording import number

if TYPE_CHECKING:
    from ppmcal.io.results.validation import ValidatedDataset, ValidationRecord

WORDS = ("frame", "target", "rotation", "homing", "none")


@click.command("validate", epilog=examples(
    "ppmcal validate identified run2.csv --against identified-may"))
@click.argument("model", type=MODEL)
@click.argument("data", type=FILE, nargs=-1, required=True)
@out_option("validated")
@click.option("--against", type=MODEL, multiple=True, metavar="OTHER",
              help="Another calibration of the machine (file or folder), judged by the same rows.")
@click.option("--register", type=click.Choice(WORDS), multiple=True,
              help="What the registration fits  [default: what the files leave open, and what "
              "the data demand beyond it].")
@click.option("--png", is_flag=True, help="Write the picture as PNG too.")
@seed_option
@console_options
def command(model: Path, data: tuple[Path, ...], out: Path, against: tuple[Path, ...],
            register: tuple[str, ...], png: bool, seed: int | None, console: Console) -> None:
    """Predict the measurements DATA, which no fit has seen, with MODEL as it is.

    MODEL is a mechanism file or a folder that identify or diagnose wrote. Only the registration is
    fitted. Each effect is left out in turn, and the nominal machine is judged beside it, all by the
    same rows. Figures have 95 % intervals over poses. Where the model predicts surely worse than
    itself without an effect, or than another machine, that is a finding: exit code 1. Writes
    validation.csv, validation.json and the picture validation.svg.
    """
    from ppmcal.api.validate import validate

    result = validate(model, data, against=against, register=register or None,
                      seed=seed or 0, png=png)
    written = result.save(out)
    _show(result.record, console)
    console.warn([*result.mechanism.findings, *result.findings])
    finish(out, [p.name for p in written], console)
    console.summary(result.record.entries())
    leave(bool(result.findings))


def _show(record: ValidationRecord, console: Console) -> None:
    """Print what a person wants to know."""
    if not console.speaks:
        return
    from ppmcal.io.results.validation import (
        effects_sentence,
        model_sentence,
        noise_sentence,
        registered_sentence,
    )

    for data in record.datasets:
        console.say(f"{registered_sentence(data)} {noise_sentence(data)}".strip())
        console.table(plain_table(*_table(data)))
        console.say(f"{model_sentence(data)} {effects_sentence(data)}".strip())


def _table(data: ValidatedDataset) -> tuple[list[str], list[list[str]], tuple[int, ...]]:
    """Return header, rows and the columns of numbers."""
    unit = data.errors[0].unit
    header = ["machine", f"{unit} rms", f"better by, {unit}", f"95 %, {unit}", ""]
    rows = []
    for e in data.errors:
        size = e.position or e.rotation
        apart = [f"{e.closer:+.2g}", f"{e.low:+.2g} to {e.high:+.2g}"] if e.verdict else ["", ""]
        rows.append([e.model, "" if size is None else number(size.rms), *apart, e.verdict])
    return header, rows, (1, 2, 3)
