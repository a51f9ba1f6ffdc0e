"""``ppmcal verify``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import FOLDER, Console, console_options, examples, plain_table

if TYPE_CHECKING:
    from ppmcal.io.results.verification import RunCheck


@click.command("verify", epilog=examples(
    "ppmcal verify identified", "ppmcal verify identified --inputs archive"))
@click.argument("dirs", metavar="DIRS...", type=FOLDER, nargs=-1, required=True)
@click.option("--inputs", type=FOLDER, default=None,
              help="Folder to look for the inputs in, by name and content, where they are not any "
              "more where they were.")
@console_options
def command(dirs: tuple[Path, ...], inputs: Path | None, console: Console) -> None:
    """Make the results in DIRS again, and compare them value by value.

    Inputs are checked by their SHA-256. With the same version, libraries and processor every byte
    must be the same; elsewhere numbers may be off by a little, and everything else not at all.
    Writes nothing. Exit code 0 same, 1 something differs, 2 an input is missing or has changed,
    3 the run itself fails.
    """
    from ppmcal.api.verify import verify

    result = verify(*dirs, inputs=inputs)
    for run in result.record.runs:
        _show(run, console)
    console.summary(result.record.entries(whole=True))
    raise click.exceptions.Exit(result.exit_code)


def _show(run: RunCheck, console: Console) -> None:
    """Print what became of one run."""
    console.say(run.sentence())
    if run.environment:
        console.say("Not as it was, so numbers may be off by a little: "
                    f"{'; '.join(run.environment)}.")
    if not run.files or not console.speaks:
        return
    console.table(plain_table(["file", "", "values that differ"], [
        [f.file, f.status, str(f.count or "")] for f in run.files], (2,)))
    for file in run.files:
        if file.words():
            console.say(f"{file.file}: {file.words()}.")
