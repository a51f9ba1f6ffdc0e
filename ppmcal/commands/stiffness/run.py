"""How far the tool gives way under load."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ppmcal.commands.inputs import files_of, load
from ppmcal.commands.result import Result
from ppmcal.commands.stiffness.options import StiffnessArguments
from ppmcal.design.statics import AppliedLoad
from ppmcal.design.stiffness import StiffnessStudy, stiffness_at_home, stiffness_table
from ppmcal.errors import BadInput, unknown
from ppmcal.io import read_poses
from ppmcal.io.grid import read_grid, read_point
from ppmcal.io.results.stiffness import StiffnessRecord, force_table, share_table
from ppmcal.kinematics.loads import only_pull
from ppmcal.kinematics.region import Grid
from ppmcal.linalg import Array
from ppmcal.model.dataset import STANDARD_GRAVITY, WRENCH
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.store.provenance import source_of
from ppmcal.wording.told import ShortTable

LARGEST = 1e12


@dataclass(frozen=True, eq=False, repr=False)
class StiffnessResult(Result):
    """How far the tool gives way under load, at home and over poses.

    Attributes:
        mechanism: the machine.
        study: compliance at home and over poses, and the deflection under the load, SI.
        record: the content of stiffness.json.
        chosen_poses: whether poses were given in place of a grid.
    """

    COMMAND: ClassVar[str] = "stiffness"
    UNTOLD: ClassVar[tuple[str, ...]] = ("tables", "pictures", "units")
    TABLE: ClassVar[str] = "map.csv"

    mechanism: Mechanism
    study: StiffnessStudy
    record: StiffnessRecord
    chosen_poses: bool

    def files(self) -> Mapping[str, str | bytes]:
        """Return map.csv, stiffness.json and, over a grid, a picture of each map."""
        return dict(self.record.files(self.study))

    @property
    def row_failures(self) -> Sequence[str]:
        """Sentences on given poses (rows from 1) that have no answer."""
        if not self.chosen_poses:
            return []
        table = self.study.found.table
        return [Note(f"row {n + 1}: {s}: {r}") for n, (s, r) in
                enumerate(zip(table.status, table.reason, strict=True)) if s != "ok"]

    def told(self) -> Iterator[str | ShortTable]:
        """Yield what was found in sentences, and what gives way most."""
        yield f"{self.mechanism.name}:"
        yield from self.record.summary
        for table in (share_table(self.study), force_table(self.study)):
            if table.rows:
                yield f"{table.title}. {table.note}"
                yield ShortTable(table.columns, table.rows, range(1, len(table.columns)))


def run(asked: StiffnessArguments) -> StiffnessResult:
    """Tell how far the tool of a machine gives way under load, at home and over a map."""
    for pair, words in (((asked.grid, asked.poses), "--grid or --poses"),
                        ((asked.load_at_tool, asked.payload), "--load or --payload")):
        if all(p is not None for p in pair):
            raise BadInput(f"Give {words}, not both", "", "Leave one of them out")
    machine = load(asked.mechanism)
    point = read_point(asked.tool, machine)
    weight = (_payload(asked.payload, machine) if asked.payload is not None
              else _load(asked.load_at_tool, machine))
    wrench, tension = weight.wrench if weight else None, _tension(asked.tension, machine)
    home = stiffness_at_home(machine, point, wrench, tension)
    mesh, wanted, notes = _poses(asked.grid, asked.poses, machine)
    found = stiffness_table(machine, wanted, point, wrench, tension)
    study = StiffnessStudy(machine, wanted, mesh, point, weight, home, found, tuple(notes), tension)
    source = source_of("stiffness", [*machine.inputs, *files_of(asked.poses)], None)
    record = StiffnessRecord.of(study, source)
    return StiffnessResult(source, tuple(record.findings), machine, study, record,
                           asked.poses is not None)


def _poses(grid_text: str | None, poses: Any, mechanism: Mechanism
           ) -> tuple[Grid | None, Array, list[Note]]:
    """Return the grid, if there is one, the wanted poses (N, 6), and notes on them."""
    if poses is not None:
        table = read_poses(poses, mechanism)
        unused = [c for c in (*WRENCH, "payload") if c in table.given[0]]
        notes = [Note(f"Columns {', '.join(unused)} of {poses} are not used: the load is that of "
                      "--load or --payload.", NOTE)] if unused else []
        return None, table.poses, notes
    grid = read_grid(grid_text, mechanism)
    return grid, grid.poses(mechanism), []


def _load(text: str | None, mechanism: Mechanism) -> AppliedLoad | None:
    """Return the load of ``fx=0,fz=-100``; refuse what does not move the platform."""
    if text is None:
        return None
    hint = f"Write for example {WRENCH[mechanism.dof[-1]]}=-100"
    moving = [WRENCH[c] for c in mechanism.dof]
    given: dict[str, float] = {}
    for part in (p.strip() for p in text.split(",") if p.strip()):
        name, sign, value = (p.strip() for p in part.partition("="))
        if not sign:
            raise BadInput(f"'{part}' is not a component with a value", "--load", hint)
        if name not in WRENCH:
            raise unknown("component", name, moving, "--load")
        if name in given:
            raise BadInput(f"names {name} twice", "--load", "Name each component once")
        given[name] = _number(value, "--load", hint)
        if given[name] and name not in moving:
            raise BadInput(f"{name} cannot be answered: in {mechanism.motion} motion the model "
                           "bears it without giving way", "--load",
                           f"Components that move this machine: {', '.join(moving)}")
    wrench = np.array([given.get(name, 0.0) for name in WRENCH])
    if not wrench.any():
        raise BadInput("the load is zero", "--load", hint)
    words = ", ".join(f"{n} = {v:g} {'N' if n[0] == 'f' else 'N m'}"
                      for n, v in given.items() if v)
    return AppliedLoad.of(wrench, words)


def _payload(mass: float, mechanism: Mechanism) -> AppliedLoad:
    """Return the weight of a mass; refuse one that acts across the machine's plane."""
    if not 0.0 < mass < LARGEST:
        raise BadInput(f"{mass:g} is not a mass", "--payload", "Write kilograms, such as 5")
    wrench = np.zeros(6)
    wrench[:3] = mass * STANDARD_GRAVITY * mechanism.gravity
    across = [WRENCH[i] for i in range(6) if wrench[i] and i not in mechanism.dof]
    if across:
        raise BadInput(f"the weight acts along {across[0][1]}, across the plane of motion, where "
                       "the model does not give way", "--payload",
                       f"Change `gravity` in {mechanism.source}, or give --load")
    return AppliedLoad.of(wrench, f"the weight of {mass:g} kg")


def _tension(mean: float | None, mechanism: Mechanism) -> float:
    """Return the mean tension of ropes without a load, N; refuse it where none are in surplus."""
    if mean is None:
        return 0.0
    if not 0.0 < mean < LARGEST:
        raise BadInput(f"{mean:g} is not a tension", "--tension", "Write newtons, such as 50")
    if not mechanism.surplus or not only_pull(mechanism).any():
        raise BadInput("this machine has no ropes that could pull against others: without a load "
                       "its limbs hold nothing", "--tension", "Leave it out")
    return mean


def _number(text: str, place: str, hint: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise BadInput(f"'{text.strip()}' is not a number", place, hint) from None
    if not math.isfinite(value) or abs(value) > LARGEST:
        raise BadInput(f"{text.strip()} is out of range", place, hint)
    return value
