"""``ppmcal plan``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from ppmcal.model.mechanism import Effect

MOST_COUNT = 1000
ABSOLUTE_ZERO = -273.15


@click.command("plan")
@click.argument("mech", type=FILE)
@click.option("--count", type=click.IntRange(2, MOST_COUNT), default=None,
              help="Measurements to take  [default: until one more hardly helps].")
@click.option("--instrument", "sidecar", type=FILE, default=None, metavar="SIDECAR.yaml",
              help="What measures, as beside a measurement file  [default: the full pose, a "
              "tenth of the tolerances].")
@click.option("--tasks", type=FILE, default=None, metavar="POSES.csv",
              help="Poses at which the machine has to be exact  [default: the whole region].")
@click.option("--candidates", type=FILE, default=None, metavar="POSES.csv",
              help="Poses to choose from  [default: drawn in the machine's region].")
@click.option("--for", "kinds", multiple=True, metavar="KINDS",
              help="Effects to be shown too, such as backlash,compliance.")
@click.option("--payload", metavar="LOW,HIGH", default=None,
              help="Payloads that can be put on, kg.")
@click.option("--temperature", metavar="LOW,HIGH", default=None,
              help="Temperatures that can be set, deg C.")
@click.option("--accuracy", type=float, default=None,
              help="Wanted standard deviation of position at the tasks, in MECH's length unit.")
@out_option("plan")
@seed_option
@quiet_option
@json_option
def command(mech: Path, count: int | None, sidecar: Path | None, tasks: Path | None,
            candidates: Path | None, kinds: tuple[str, ...], payload: str | None,
            temperature: str | None, accuracy: float | None, out: Path, seed: int | None,
            quiet: bool, as_json: bool) -> None:
    """Choose the poses of MECH that are worth measuring.

    D-optimal for the parameters that MECH leaves free, with its tolerances as prior; ordered
    into a short path. Writes poses.csv, accuracy.csv, plan.json and accuracy.png.
    """
    from ppmcal.design.plan.plan import PlanOptions, plan
    from ppmcal.design.plan.settings import PlanSettings
    from ppmcal.design.virtual_instrument import default_instrument
    from ppmcal.errors import BadInput
    from ppmcal.io import Output, provenance, read_mechanism, read_poses
    from ppmcal.io.results.plan import PlanRecord
    from ppmcal.io.sidecar import read_instrument

    console = Console(quiet, as_json)
    mechanism = read_mechanism(mech)
    names = tuple(dict.fromkeys(k.strip() for text in kinds for k in text.split(",") if k.strip()))
    asked = PlanSettings(names, _ends(payload, "--payload", "0,20", 0.0),
                  _ends(temperature, "--temperature", "18,26", ABSOLUTE_ZERO, -ABSOLUTE_ZERO))
    instrument = read_instrument(sidecar, mechanism) if sidecar else default_instrument(mechanism)
    given = (read_poses(candidates, mechanism).poses, str(candidates)) if candidates else None
    aims = (read_poses(tasks, mechanism).poses, str(tasks)) if tasks else None
    if accuracy is not None and not 0.0 < accuracy < 1e12:
        raise BadInput(f"{accuracy:g} is not the size of an error", "--accuracy",
                       "Write one above 0")
    wanted = None if accuracy is None else accuracy * mechanism.units.factor("length")
    seed = 0 if seed is None else seed
    with console.progress("Planning") as show:
        result = plan(
            mechanism, instrument, PlanOptions(count, seed, asked), given, aims, wanted, show
        )
    inputs = [*mechanism.inputs, *(str(p) for p in (sidecar, tasks, candidates) if p)]
    notes = _notes(mechanism.effects, names, result.unused)
    record = PlanRecord.of(result, wanted, notes, provenance(inputs, command_line(), seed))
    with Output(out) as output:
        for name, content in record.files(result, wanted).items():
            output.add(name, content)
    console.say(f"{mechanism.name}:")
    for sentence in record.said:
        console.say(sentence)
    console.warn([*mechanism.findings, *record.findings])
    finish(out, list(output.files), console)
    console.summary({k: v for k, v in record.entries().items()
                     if k not in ("tables", "pictures")})
    leave(bool(record.findings))


def _notes(effects: tuple[Effect, ...], names: tuple[str, ...], unused: tuple[str, ...]
           ) -> list[str]:
    out = [f"--{name} is not used: nothing that is asked for depends on it." for name in unused]
    others = sorted({e.kind.name for e in effects} - set(names))
    if others:
        out.append(f"The file's effects {', '.join(others)} are left out; name them with --for to "
                   "plan for them.")
    return out


def _ends(text: str | None, option: str, example: str, least: float, shift: float = 0.0
          ) -> tuple[float, float] | None:
    """Return both ends of ``LOW,HIGH``, shifted to SI."""
    from ppmcal.errors import BadInput

    if text is None:
        return None
    mend = f'Write two numbers, the lower one first, for example {option} "{example}"'
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        raise BadInput(f"'{text}' holds what is not a number", option, mend) from None
    if len(values) != 2 or not all(math.isfinite(v) and least <= v < 1e6 for v in values) or (
            values[0] >= values[1]):
        raise BadInput(f"'{text}' does not go from a lower to a higher value", option, mend)
    return values[0] + shift, values[1] + shift
