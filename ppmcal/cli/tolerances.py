"""``ppmcal tolerances``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    command_line,
    effects_words,
    finish,
    json_option,
    leave,
    number,
    out_option,
    plain_table,
    quiet_option,
    seed_option,
)

if TYPE_CHECKING:
    from ppmcal.io.results.tolerances import Result
    from ppmcal.model.mechanism import Mechanism


@click.command("tolerances")
@click.argument("mech", type=FILE)
@out_option("tolerances")
@click.option("--accuracy", type=float, default=None, metavar="LENGTH",
              help="Largest position error of the tool that is allowed.")
@click.option("--rotation", type=float, default=None, metavar="ANGLE",
              help="Largest rotation error that is allowed.")
@click.option("--yield", "share", type=float, default=0.95,
              show_default=True, help="Share of machines that must meet it, before calibration.")
@click.option("--method", type=click.Choice(["cost", "equal", "mean", "file"]), default="cost",
              show_default=True, help="Which tolerances to verify: of least cost, of equal "
              "contributions, one for all, or the file's own.")
@click.option("--poses", type=FILE, default=None,
              help="Task poses, a CSV  [default: drawn over the workspace].")
@click.option("--instrument", type=FILE, default=None, metavar="SIDECAR",
              help="Calibrate with this instrument, a data set's YAML  [default: one whose noise "
              "is a tenth of the accuracy].")
@click.option("--measure", type=click.IntRange(4, 1000), default=30, show_default=True,
              help="Poses that a calibration measures.")
@click.option("--machines", type=click.IntRange(20, 10_000_000), default=1000, show_default=True,
              help="Machines to simulate.")
@click.option("--metric", type=float, default=None, metavar="LENGTH",
              help="An angle of sigma/LENGTH counts like a length of sigma  [default: the platform "
              "joints' rms distance].")
@click.option("--tool", default=None, metavar="X,Y,Z", help="Tool point in platform axes.")
@click.option("--cores", type=click.IntRange(min=1), default=None,
              help="Processes to run in  [default: all processors].")
@click.option("--dask", default=None, metavar="ADDRESS",
              help="Run on this dask scheduler, such as tcp://10.0.0.5:8786.")
@seed_option
@quiet_option
@json_option
def command(mech: Path, out: Path, accuracy: float | None, rotation: float | None, share: float,
            method: str, poses: Path | None, instrument: Path | None, measure: int,
            machines: int, metric: float | None, tool: str | None, cores: int | None,
            dask: str | None, seed: int | None, quiet: bool, as_json: bool) -> None:
    """Find tolerances with which MECH keeps an accuracy, and count the machines that do.

    Writes tolerances.csv, errors.csv, allocated.yaml (the machine with these tolerances),
    yield.png and tolerances.json.
    """
    from ppmcal.cli.tolerances_job import Job, solve
    from ppmcal.io import Output, provenance, read_mechanism
    from ppmcal.io.results.tolerances import files, record

    console = Console(quiet, as_json)
    machine = read_mechanism(mech)
    job = Job(accuracy, rotation, share, method, poses, instrument, measure, machines, metric,
              tool, cores, dask, seed or 0)
    with console.progress("Simulating machines") as tell:
        result = solve(machine, job, tell)
    inputs = [*machine.inputs, *(str(p) for p in (poses, instrument) if p)]
    source = provenance(inputs, command_line(), job.seed)
    said, findings = [*sentences(result), *effects_words(machine)], _findings(machine, result)
    summary = record(result, said, findings, source)
    with Output(out) as output:
        for name, content in files(result, summary).items():
            output.add(name, content)
    for sentence in said:
        console.say(sentence)
    _tables(console, summary)
    console.warn(findings)
    finish(out, list(output.files), console)
    console.summary(summary)
    leave(bool(findings))


def sentences(r: Result) -> list[str]:
    """Return the results in words."""
    import numpy as np

    from ppmcal.io.results.tolerances import yields

    units, d = r.machine.units, r.demand
    length, angle = units.factor("length"), units.factor("angle")
    asked = [f"{number(d.position / length)} {units.length}"] if d.position is not None else []
    asked += [f"{number(d.rotation / angle)} {units.angle}"] if d.rotation is not None else []
    words = {"cost": "of least cost", "equal": "of equal contributions", "mean": "one for all",
             "file": "as in the file"}[r.chosen]
    out = [f"{r.machine.name}: {len(r.sources)} errors, tolerances {words}, for "
           f"{' and '.join(asked)} at each of {len(r.fleet.tasks.q)} task poses."]
    if r.sigma_one is not None:
        out.append(f"One standard deviation for all errors that gives an rms error of the accuracy "
                   f"at home: {number(r.sigma_one / length)} {units.length} (accuracy over the "
                   "amplification index).")
    for y in yields(r):
        low, high = y["interval"]
        lost = y["machines"] - y["going"]
        size = "" if y["position_rms"] is None else (
            f"; {number(y['position_rms'])} {units.length} rms"
            + (f" of the {y['going']} that have a result" if lost else ""))
        out.append(f"{y['words'].capitalize()}: {y['share']:.1%} of {y['machines']} machines in "
                   f"specification (95 % interval {low:.1%} to {high:.1%}){size}.")
    kind = r.fleet.recipe.instrument if r.fleet.recipe else None
    if kind is not None and np.isfinite(kind.sigma_position):
        told = "" if r.predicted is None else (
            f"; the linear model expects {number(r.predicted / length)} {units.length} rms")
        out.append(f"Calibrated with {len(r.fleet.recipe.q) if r.fleet.recipe else 0} poses, "
                   f"instrument {kind.kind} of {number(kind.sigma_position / length)} "
                   f"{units.length}{told}.")
    agree, count = int(r.check.agrees.sum()), len(r.check.agrees)
    out.append("As built, linear prediction and nonlinear machines agree in position at "
               f"{agree} of {count} task poses (a difference of {r.check.seen:.0%} would show)"
               + ("." if agree == count else "; where they do not, trust the machines drawn "
                  "(errors.csv, linear_agrees)."))
    return out


def _tables(console: Console, found: dict[str, object]) -> None:
    tables = found["tables"]
    assert isinstance(tables, list)
    slots = tables[1]
    rows = [[r[0], str(r[1]), *(number(v, 3) for v in r[3:]), r[2]] for r in slots["rows"]]
    console.say(slots["title"] + ":")
    console.table(plain_table(["slot", "errors", "file", "mean", "equal", "cost", "unit"], rows,
                              (1, 2, 3, 4, 5)))


def _findings(machine: Mechanism, r: Result) -> list[str]:
    """Return what must be looked at: machines that cannot take poses, a yield missed."""
    import numpy as np

    from ppmcal.design.tolerance_allocation import count

    out = [*machine.findings, *r.notes]
    built = r.judged.built
    lost = int((~np.isfinite(built.position)).any(axis=1).sum())
    if lost:
        out.append(f"{lost} of {len(built.position)} machines cannot take every task pose: they "
                   "count as out of specification")
    for _, words, errors in r.stages()[1:]:
        more = int((~np.isfinite(errors.position)).any(axis=1).sum()) - lost
        if more > 0:
            out.append(f"{words}: {more} more machines have no result (no converged fit, or a task "
                       "pose out of their reach): they count as out of specification")
    high = count(built, r.demand).interval[1]
    wrong = lost > 0 or not r.check.agrees.all()
    if high < r.demand.share and r.chosen != "file" and wrong:
        out.append(f"fewer machines than wanted are in specification as built ({high:.1%} at most, "
                   f"wanted {r.demand.share:.1%}): the linear model is not good enough here")
    return out
