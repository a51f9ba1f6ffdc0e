"""``export grid``: wanted poses with the commands that bring the machine there."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.controllers.export import Exported, NotExpressed, effect_lacking, misread, refuse
from ppmcal.controllers.pose_grid import (
    BETWEEN,
    Corrected,
    corrected,
    default_grid,
    errors_at_poses,
    errors_between_poses,
    instrument_notes,
)
from ppmcal.errors import NoResult
from ppmcal.io import csv_text, read_poses
from ppmcal.io.results.tables import joint_columns, pose_columns, unit_map
from ppmcal.kinematics.region import Grid, named
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import NOTE, Note

TABLE = "grid.csv"
SEED = 1


def export(mechanism: Mechanism, old: Path | None, poses: Path | None) -> Exported:
    """Return the machine as a table of poses; see :class:`ppmcal.controllers.export.Exporter`."""
    refuse(old, "--old", "a grid of poses is compared with the nominal geometry, not with another "
           "grid")
    grid, further = None, []
    if poses is None:
        grid = default_grid(mechanism)
        wanted = grid.poses(mechanism)
    else:
        table = read_poses(poses, mechanism)
        wanted, further = table.poses, list(table.environment)
    found = corrected(mechanism, wanted)
    if not found.good.any():
        reasons = "; ".join(found.left_out)
        raise NoResult(f"none of the {len(wanted)} poses has a command ({reasons})",
                       str(poses or mechanism.source), "Wanted are platform poses in the base "
                       "frame, inside the limits")
    before, after = (errors_at_poses(mechanism, found) if grid is None
                     else errors_between_poses(mechanism, grid, found, SEED))
    count = int(found.good.sum())
    return Exported(
        "grid", "pose grid", {TABLE: _text(mechanism, found)},
        f"{count} poses with the commands that bring the machine there", (),
        f"the {after.count} poses themselves, none in between" if grid is None else
        f"{after.count} random poses between those of the grid, commands interpolated linearly",
        before, after, tuple(_not_expressed(mechanism, found, grid is None)),
        tuple(_notes(mechanism, grid, found, further)), (_advice(mechanism, grid),),
        _extra(mechanism, grid, found), found.wanted[found.good])


def columns(mechanism: Mechanism, found: Corrected) -> dict[str, Array]:
    """Return the table, rows that have a command: wanted pose, command, joints; file units."""
    good = found.good
    return {**pose_columns(mechanism, found.wanted[good]),
            **pose_columns(mechanism, found.command[good], "cmd_"),
            **joint_columns(mechanism, found.q[good], "q_{}")}


def _text(mechanism: Mechanism, found: Corrected) -> str:
    """Return grid.csv, read back."""
    table = columns(mechanism, found)
    text = csv_text(list(table), list(table.values()))
    again = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1, ndmin=2)
    if not np.array_equal(again, np.column_stack(list(table.values()))):
        raise misread(TABLE, "the table reads back as another one", "it")
    return text


def _not_expressed(mechanism: Mechanism, found: Corrected, asked: bool) -> Iterator[NotExpressed]:
    """Yield poses asked for that have no command, and effects that a table holds at rest only."""
    missing = len(found.good) - int(found.good.sum())
    if asked and missing:
        yield NotExpressed(f"{missing} of {len(found.good)} poses, left out: {_reasons(found)}", (),
                           None)
    for effect in mechanism.effects:
        if effect.kind.needs and not effect.kind.instrument:
            yield effect_lacking(mechanism, effect, f", which depends on "
                                 f"{', '.join(effect.kind.needs)}: taken without direction, speed "
                                 "and load, at 20 C")


def _reasons(found: Corrected) -> str:
    return "; ".join(f"{n} times {reason}" for reason, n in found.left_out.items())


def _notes(mechanism: Mechanism, grid: Grid | None, found: Corrected, further: list[str]
           ) -> Iterator[Note]:
    """Yield what a user should know of the rows."""
    missing = len(found.good) - int(found.good.sum())
    if missing and grid is not None:
        yield Note(f"{missing} of {len(found.good)} poses have no command and are left out: "
                   f"{_reasons(found)}", NOTE)
    ends = {} if mechanism.measured is None else mechanism.measured.ranges
    cut = [] if grid is None else [name for name, level in zip(grid.names, grid.levels, strict=True)
                                   if {level[0], level[-1]} & {*ends.get(name, ())}]
    if cut:
        yield Note(
            f"the grid ends where the measurements of {', '.join(cut)} do, not at the limits", NOTE)
    if grid is None:
        yield Note(
            "between the poses of a list nothing is predicted: the figures are at the poses", NOTE)
    open_ = [POSE_COORDINATES[c] for c in mechanism.dof if c not in named(mechanism)]
    if open_:
        yield Note(
            f"{', '.join(open_)} follow from the other coordinates and are not commanded", NOTE)
    if further:
        yield Note(
            f"the columns {', '.join(further)} are not used; `ppmcal compensate` makes commands "
            "for given directions, loads and temperatures", NOTE)
    yield from instrument_notes(mechanism)


def _advice(mechanism: Mechanism, grid: Grid | None) -> Note:
    names = ", ".join(f"cmd_{POSE_COORDINATES[c]}" for c in named(mechanism))
    joints = ", ".join(f"q_{a}" for a in mechanism.actuators[:1])
    between = ("" if grid is None else " In between, interpolate the difference of command and "
               "wanted pose linearly in each coordinate.")
    return Note(f"Ask a controller with the nominal geometry for {names} to get the pose before "
                f"them, or send the joint values ({joints}, ...).{between}", NOTE)


def _extra(mechanism: Mechanism, grid: Grid | None, found: Corrected) -> dict[str, Any]:
    names = list(columns(mechanism, found))
    out: dict[str, Any] = {"rows": int(found.good.sum()), "left_out": dict(found.left_out),
                           "columns": unit_map(mechanism, names)}
    if grid is not None:
        out["grid"] = {POSE_COORDINATES[c]: level / mechanism.units.factor(
            "length" if c < 3 else "angle") for c, level in zip(
                grid.coordinates, grid.levels, strict=True)}
        out["tried"] = {"poses": BETWEEN, "seed": SEED}
    return out
