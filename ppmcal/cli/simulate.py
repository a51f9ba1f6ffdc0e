"""``ppmcal simulate``."""

from __future__ import annotations

from pathlib import Path

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    finish,
    json_option,
    leave,
    out_option,
    quiet_option,
    seed_option,
)
from ppmcal.wording import counted


@click.command("simulate")
@click.argument("mech", type=FILE)
@click.argument("scenario", type=FILE)
@out_option("simulated")
@seed_option
@quiet_option
@json_option
def command(mech: Path, scenario: Path, out: Path, seed: int | None, quiet: bool,
            as_json: bool) -> None:
    """Simulate measurements of MECH as SCENARIO says.

    Writes measurements.csv, measurements.yaml and truth.json.
    """
    from ppmcal.io import Output, provenance, read_mechanism, read_scenario
    from ppmcal.io.results.simulation import files
    from ppmcal.simulation.simulate import simulate

    console = Console(quiet, as_json)
    mechanism = read_mechanism(mech)
    plan = read_scenario(scenario, mechanism)
    with console.progress("Simulating"):
        campaign = simulate(mechanism, plan, seed)
    seed = plan.seed if seed is None else seed
    source = provenance([*mechanism.inputs, str(scenario)], command_line(), seed)
    with Output(out) as output:
        for name, text in files(mechanism, plan, campaign, out.name, source).items():
            output.add(name, text)
    rows, poses = len(campaign.time), len(set(campaign.pose.tolist()))
    console.say(f"{mechanism.name}: {counted(rows, 'row')} at {counted(poses, 'pose')}, "
                f"instrument {plan.kind}, seed {source['seed']}; "
                f"{counted(int(campaign.outlier.sum()), 'outlier')} injected.")
    console.warn([*mechanism.findings, *campaign.left_out])
    finish(out, list(output.files), console)
    console.summary({"format": "ppmcal/simulation/1", "rows": rows, "poses": poses,
                     "left_out": list(campaign.left_out), "provenance": source})
    leave(bool(campaign.left_out))
