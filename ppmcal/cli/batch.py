"""``ppmcal batch``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    cluster_options,
    console_options,
    examples,
    finish,
    leave,
    out_option,
)
from ppmcal.wording import counted

SHOWN = 10


@click.command("batch", epilog=examples("ppmcal batch fleet.yaml --cores 2"))
@click.argument("manifest", type=FILE)
@out_option("batch")
@cluster_options
@console_options
def command(manifest: Path, out: Path, cores: int | None, scheduler: str | None,
            console: Console) -> None:
    """Identify, diagnose or compensate the campaigns of many machines that MANIFEST lists.

    Each writes into its own folder machine/date/command of --out what its command alone would.
    One that fails is reported and the others go on; those that are finished are not run again.
    Writes campaigns.parquet, a table of all results, and batch.html: which machines are worst,
    what they have in common, and what has changed since last time.
    """
    from ppmcal.api.batch import batch
    from ppmcal.io.folder import current

    result = batch(manifest, out, cores=cores, scheduler=scheduler, force=current().force)
    written = result.save(out)
    console.say(result.headline())
    for r in result.failed[:SHOWN]:
        console.warn([f"{r.campaign} failed (exit code {r.exit_code}): {r.message}"])
    if len(result.failed) > SHOWN:
        console.say(f"... and {counted(len(result.failed) - SHOWN, 'further campaign')} that "
                    "failed, see batch.html.")
    finish(out, [p.name for p in written], console)
    console.summary({"format": "ppmcal/batch-summary/1", "headline": result.headline(),
                     "finished_before": list(result.done_before),
                     "campaigns": [{k: getattr(r, k) for k in (
                         "campaign", "machine", "date", "command", "exit_code", "verdict",
                         "message")} for r in result.records]})
    leave(result.needs_a_look)
