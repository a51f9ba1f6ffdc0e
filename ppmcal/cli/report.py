"""``ppmcal report``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FOLDER,
    Console,
    console_options,
    examples,
    finish,
    out_option,
)


@click.command("report", epilog=examples("ppmcal report identified compared"))
@click.argument("dirs", type=FOLDER, nargs=-1, required=True)
@out_option("report")
@click.option("--open", "open_page", is_flag=True, help="Open the page in the browser.")
@console_options
def command(dirs: tuple[Path, ...], out: Path, open_page: bool, console: Console) -> None:
    """Gather the output folders DIRS into report.html and report.json."""
    from ppmcal.api.report import make_report

    result = make_report(*dirs)
    written = result.save(out)
    finish(out, [p.name for p in written], console)
    page = out / "report.html"
    if not (open_page and _opened(page)):
        console.say(f"Open {page} in a browser.")
    console.summary(result.content)


def _opened(page: Path) -> bool:
    """Open a page; whether there was a browser to do it."""
    import webbrowser

    return webbrowser.open(page.resolve().as_uri())
