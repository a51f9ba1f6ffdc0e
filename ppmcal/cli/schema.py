"""``ppmcal schema``."""

from __future__ import annotations

import click

from ppmcal.cli import completion
from ppmcal.cli.common import examples, verbose_alone


@click.command("schema", epilog=examples("ppmcal schema mechanism"))
@click.argument("name", metavar="FILE", shell_complete=completion.schemas)
@verbose_alone
def command(name: str) -> None:
    """Print the JSON Schema of a file, for editors that complete and check it.

    FILE is mechanism, dataset (the YAML beside a CSV), scenario or batch (a manifest), or a
    result: identification, diagnosis, comparison, ... Kinds of limbs and effects that other
    packages add are in it.
    """
    import json

    from ppmcal.api.schema import schema

    click.echo(json.dumps(schema(name), indent=1, ensure_ascii=False))
