"""``ppmcal simulate``."""

from __future__ import annotations

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
    seed_option,
)


@click.command("simulate", epilog=examples(
    "ppmcal simulate mine.yaml mine.scenario.yaml --seed 7"))
@click.argument("mech", type=MODEL)
@click.argument("scenario", type=FILE)
@out_option("simulated")
@seed_option
@console_options
def command(mech: Path, scenario: Path, out: Path, seed: int | None, console: Console) -> None:
    """Simulate measurements of MECH as SCENARIO says.

    Writes measurements.csv, measurements.yaml and truth.json.
    """
    from ppmcal.api.simulate import simulate

    result = simulate(mech, scenario, seed=seed)
    written = result.save(out)
    console.say(result.headline())
    console.warn([*result.mechanism.findings, *result.findings])
    finish(out, [p.name for p in written], console)
    campaign = result.campaign
    console.summary({"format": "ppmcal/simulation/1", "rows": len(campaign.time),
                     "poses": len(set(campaign.pose.tolist())),
                     "left_out": list(campaign.left_out), "provenance": result.provenance})
    leave(bool(result.findings))
