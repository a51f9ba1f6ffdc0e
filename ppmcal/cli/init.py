"""``ppmcal init``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli import completion
from ppmcal.cli.common import (
    FILE,
    WIDTH,
    Console,
    console_options,
    examples,
    plain_table,
    single_files,
)


@click.command("init", epilog=examples("ppmcal init", "ppmcal init 6-UPS --out my-hexapod.yaml"))
@click.argument("kind", required=False, shell_complete=completion.machines)
@click.option("--out", type=FILE, default=None, help="File to write [default: KIND.yaml].")
@click.option("--force", is_flag=True, help="Overwrite a file that exists.")
@console_options
@single_files
def command(kind: str | None, out: Path | None, force: bool, console: Console) -> None:
    """Write a commented mechanism file for KIND (none: list the kinds)."""
    from ppmcal.errors import BadInput
    from ppmcal.io import Output
    from ppmcal.io.templates import find_template, for_editors, templates

    if kind is None:
        rows = [[name, line] for name, line in templates().items()]
        console.table(plain_table(["KIND", "machine"], rows))
        console.say("Write one with: ppmcal init KIND")
        console.summary({"kinds": templates()})
        return
    path = find_template(kind)
    target = out or Path(path.name)
    scenario = path.parent / "scenarios" / path.name
    second = target.with_name(f"{target.stem}.scenario.yaml")
    for place in (target, second):
        if place.exists() and not force:
            raise BadInput("exists already", str(place), "Give another --out, or --force")
    output = Output(target.parent, loose=True)
    output.add(target.name, for_editors(path, "mechanism", target.stem))
    if scenario.exists():
        output.add(second.name, for_editors(scenario, "scenario", target.stem))
    written = [str(place) for place in output.write()]
    console.say(f"Written: {', '.join(written)}")
    head, line = f"Next: put your numbers into {target}, then:", ["ppmcal", "check", target]
    if len(" ".join(map(str, [head, *line]))) <= WIDTH:
        console.say_command(head, line)
    else:
        console.say(head)
        console.say_command("   ", line)
    console.summary({"written": written})
