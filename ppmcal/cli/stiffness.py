"""``ppmcal stiffness``."""

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
    plain_table,
    quiet_option,
)

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ppmcal.io.results.stiffness_tables import Load
    from ppmcal.kinematics.region import Grid
    from ppmcal.model.mechanism import Mechanism

    Array = NDArray[np.float64]

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
LARGEST = 1e12


@click.command("stiffness")
@click.argument("mech", type=FILE)
@click.option("--grid", "grid_text", metavar="TEXT", default=None,
              help="Coordinates of the map, such as x=-300:300:41,y.")
@click.option("--poses", type=FILE, default=None, help="Poses instead of a grid.")
@click.option("--load", "load_text", metavar="TEXT", default=None,
              help="Load at the tool point, base axes, N and N m: fx=0,fy=0,fz=-100.")
@click.option("--payload", type=float, default=None, help="Mass at the tool point, kg.")
@click.option("--tool", "tool_text", metavar="TEXT", default=None,
              help="Tool point in platform axes: x,y,z. Default: the platform's origin.")
@out_option("stiffness")
@quiet_option
@json_option
def command(mech: Path, grid_text: str | None, poses: Path | None, load_text: str | None,
            payload: float | None, tool_text: str | None, out: Path, quiet: bool,
            as_json: bool) -> None:
    """How far the tool of MECH gives way under load, at home and over a map.

    MECH says how stiff bars, drives and joints are under `stiffness`. Writes map.csv,
    stiffness.json and pictures of the map.
    """
    if grid_text is not None and poses is not None:
        raise click.UsageError("Give --grid or --poses, not both.")
    if load_text is not None and payload is not None:
        raise click.UsageError("Give --load or --payload, not both.")
    from ppmcal.design.stiffness import stiffness_at_home, stiffness_table
    from ppmcal.io import Output, provenance, read_mechanism
    from ppmcal.io.grid import read_point
    from ppmcal.io.results.stiffness import StiffnessRecord
    from ppmcal.io.results.stiffness_tables import StiffnessStudy, share_table

    console = Console(quiet, as_json)
    mechanism = read_mechanism(mech)
    tool = read_point(tool_text, mechanism)
    load = _payload(payload, mechanism) if payload is not None else _load(load_text, mechanism)
    home = stiffness_at_home(mechanism, tool)
    grid, wanted, notes = _poses(grid_text, poses, mechanism)
    with console.progress("Mapping"):
        found = stiffness_table(mechanism, wanted, tool, load.wrench if load else None)
        study = StiffnessStudy(mechanism, wanted, grid, tool, load, home, found, tuple(notes))
        inputs = [*mechanism.inputs, *([str(poses)] if poses else [])]
        record = StiffnessRecord.of(study, provenance(inputs, command_line(), None))
        made = record.files(study)
    with Output(out) as output:
        for name, content in made.items():
            output.add(name, content)
    console.say(f"{mechanism.name}:")
    for sentence in record.said:
        console.say(sentence)
    shares = share_table(study)
    if shares.rows:
        console.say(f"{shares.title}. {shares.note}")
        console.table(plain_table(shares.columns, shares.rows, range(1, len(shares.columns))))
    bad = [] if poses is None else [
        f"row {n + 1}: {s}: {r}" for n, (s, r) in
        enumerate(zip(found.table.status, found.table.reason, strict=True)) if s != "ok"]
    console.warn_rows([*mechanism.findings, *record.findings], bad)
    finish(out, list(made), console)
    console.summary({k: v for k, v in record.entries().items()
                     if k not in ("tables", "pictures", "units")})
    leave(bool(record.findings or bad))


def _poses(grid_text: str | None, poses: Path | None, mechanism: Mechanism
           ) -> tuple[Grid | None, Array, list[str]]:
    """Return the grid, if there is one, the wanted poses (N, 6), and notes on them."""
    from ppmcal.io import read_poses
    from ppmcal.io.grid import read_grid

    if poses is not None:
        table = read_poses(poses, mechanism)
        unused = [c for c in (*WRENCH, "payload") if c in table.header]
        notes = [f"Columns {', '.join(unused)} of {poses} are not used: the load is that of "
                 "--load or --payload."] if unused else []
        return None, table.poses, notes
    grid = read_grid(grid_text, mechanism)
    return grid, grid.poses(mechanism), []


def _load(text: str | None, mechanism: Mechanism) -> Load | None:
    """Return the load of ``fx=0,fz=-100``; refuse what does not move the platform."""
    import numpy as np

    from ppmcal.errors import BadInput, unknown
    from ppmcal.io.results.stiffness_tables import Load

    if text is None:
        return None
    mend = f"Write for example {WRENCH[mechanism.dof[-1]]}=-100"
    moving = [WRENCH[c] for c in mechanism.dof]
    given: dict[str, float] = {}
    for part in (p.strip() for p in text.split(",") if p.strip()):
        name, sign, value = (p.strip() for p in part.partition("="))
        if not sign:
            raise BadInput(f"'{part}' is not a component with a value", "--load", mend)
        if name not in WRENCH:
            raise unknown("component", name, moving, "--load")
        if name in given:
            raise BadInput(f"names {name} twice", "--load", "Name each component once")
        given[name] = _number(value, "--load", mend)
        if given[name] and name not in moving:
            raise BadInput(f"{name} cannot be answered: in {mechanism.motion} motion the model "
                           "bears it without giving way", "--load",
                           f"Components that move this machine: {', '.join(moving)}")
    wrench = np.array([given.get(name, 0.0) for name in WRENCH])
    if not wrench.any():
        raise BadInput("the load is zero", "--load", mend)
    words = ", ".join(f"{n} = {v:g} {'N' if n[0] == 'f' else 'N m'}"
                      for n, v in given.items() if v)
    return Load(wrench, words)


def _payload(mass: float, mechanism: Mechanism) -> Load:
    """Return the weight of a mass; refuse one that acts across the machine's plane."""
    import numpy as np

    from ppmcal.errors import BadInput
    from ppmcal.io.results.stiffness_tables import Load
    from ppmcal.model.dataset import STANDARD_GRAVITY

    if not 0.0 < mass < LARGEST:
        raise BadInput(f"{mass:g} is not a mass", "--payload", "Write kilograms, such as 5")
    wrench = np.zeros(6)
    wrench[:3] = mass * STANDARD_GRAVITY * mechanism.gravity
    across = [WRENCH[i] for i in range(6) if wrench[i] and i not in mechanism.dof]
    if across:
        raise BadInput(f"the weight acts along {across[0][1]}, across the plane of motion, where "
                       "the model does not give way", "--payload",
                       f"Change `gravity` in {mechanism.source}, or give --load")
    return Load(wrench, f"the weight of {mass:g} kg")


def _number(text: str, place: str, mend: str) -> float:
    from ppmcal.errors import BadInput

    try:
        value = float(text)
    except ValueError:
        raise BadInput(f"'{text.strip()}' is not a number", place, mend) from None
    if not math.isfinite(value) or abs(value) > LARGEST:
        raise BadInput(f"{text.strip()} is too large to be true", place, mend)
    return value
