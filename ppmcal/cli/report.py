"""``ppmcal report``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FOLDER,
    Console,
    examples,
    finish,
    json_option,
    out_option,
    quiet_option,
)


@click.command("report", epilog=examples("ppmcal report identified compared"))
@click.argument("dirs", type=FOLDER, nargs=-1, required=True)
@out_option("report")
@quiet_option
@json_option
def command(dirs: tuple[Path, ...], out: Path, quiet: bool, as_json: bool) -> None:
    """Gather the output folders DIRS into report.html and report.json."""
    from ppmcal.api.report import make_report

    console = Console(quiet, as_json)
    result = make_report(*dirs)
    written = result.save(out)
    finish(out, [p.name for p in written], console)
    console.say(f"Open {out / 'report.html'} in a browser.")
    console.summary(result.content)
