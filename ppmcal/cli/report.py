"""``ppmcal report``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import FOLDER, Console, finish, json_option, out_option, quiet_option


@click.command("report")
@click.argument("dirs", type=FOLDER, nargs=-1, required=True)
@out_option("report")
@quiet_option
@json_option
def command(dirs: tuple[Path, ...], out: Path, quiet: bool, as_json: bool) -> None:
    """Gather the output folders DIRS into report.html and report.json."""
    from ppmcal.io import Output, json_text
    from ppmcal.report import collect, to_html, to_json

    console = Console(quiet, as_json)
    data = collect(dirs)
    content = to_json(data)
    with Output(out) as output:
        output.add("report.html", to_html(data))
        output.add("report.json", json_text(content))
    finish(out, list(output.files), console)
    console.say(f"Open {out / 'report.html'} in a browser.")
    console.summary(content)
