"""What ``workspace`` says: reach, singularities and assembly modes, in sentences."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.design.workspace import Workspace
from ppmcal.io.results.workspace_tables import (
    ModeRow,
    places,
    size_unit,
    size_word,
)
from ppmcal.kinematics.tables import SINGULAR_HOME
from ppmcal.linalg import Array
from ppmcal.notes import Note

LISTED = 10
"""Rows without assembly modes that are findings of their own."""


def reach(found: Workspace) -> list[str]:
    """Return how much of the grid the machine reaches."""
    machine = found.mechanism
    axes = []
    for c, name, level in zip(found.grid.coordinates, found.grid.names, found.grid.levels,
                              strict=True):
        quantity = "length" if c < 3 else "angle"
        f = machine.units.factor(quantity)
        axes.append(f"{name} {level[0] / f:.4g} to {level[-1] / f:.4g} "
                    f"{machine.units.name(quantity)} ({len(level)} levels)")
    factor, unit = size_unit(found)
    short = machine.dependent > 0
    out = [f"{machine.name}: {', '.join(axes)}; other coordinates as at home"
           + (", or as the closure decides." if short else "."),
           f"Reached within limits: {found.share:.1%} of {len(found.table.status)} poses, "
           f"{size_word(found)} {found.size / factor:.4g} {unit}."]
    if found.reached.any():
        out.append(f"Mean dexterity there: {found.index:.3f} (home {found.home.dexterity[0]:.3f}, "
                   "1 is isotropic).")
    return out


def singularities(found: Workspace) -> list[str]:
    """Return where the singularity nearest to home is."""
    if not found.searched:
        return ["Singularities are looked for on grids of at most three coordinates."]
    near = found.nearest
    if near is None:
        joined = bool((found.table.singular_value >= 0.0).any())
        if joined and found.mechanism.surplus:
            return _weakest(found)
        return ["No singularity on this grid: det A keeps its sign wherever the limbs reach."
                if joined else "No pose of this grid has joint values."]
    units, quantity = found.mechanism.units, found.distance_quantity
    scale = units.words(found.mechanism.length_scale, "length")
    mixed = len({c >= 3 for c in found.grid.coordinates}) > 1
    count, pose = len(found.singular), np.zeros(6)
    pose[list(found.mechanism.dof)] = list(near.pose.values())
    out = ["Nearest singularity to home on this grid: "
           + units.words(near.distance, quantity)
           + (f" (rotations times {scale})" if mixed else "")
           + f", at {_place(found, pose)}; {count} singular "
           f"pose{'' if count == 1 else 's'} in singular.csv."]
    unsure = int((found.reached & ~found.sure).sum())
    if unsure:
        out.append(f"For {unsure} of {int(found.reached.sum())} reached poses the grid ends nearer "
                   "than the singularity found: a nearer one may lie beyond (grid_end in map.csv; "
                   "left out of the picture).")
    if near.distance > near.edge:
        out.append(f"The grid ends {units.words(near.edge, quantity)} from home; beyond its end "
                   "there may be nearer ones.")
    return out


def _weakest(found: Workspace) -> list[str]:
    """Return where surplus limbs hold the platform least: A there has no sign that could change."""
    if not found.reached.any():
        return []
    value = np.where(found.reached, found.table.singular_value, np.nan)
    row = int(np.nanargmin(value))
    return ["With more limbs than freedoms, a grid may step over singular poses. Smallest singular "
            f"value in reach: {value[row]:.3f} at {_place(found, found.table.pose[row])} "
            f"(home {found.home.singular_value[0]:.3f})."]


def _place(found: Workspace, pose: Array) -> str:
    """Return a pose (6,) in words: its coordinates in the file's units."""
    return ", ".join(f"{name} {v[0]}" for name, v in
                     places(found.mechanism, pose[None]).items())


def assembly_modes(found: Workspace, rows: Sequence[ModeRow]) -> list[str]:
    """Return how many assembly modes home's joint values have."""
    known = [r.modes for r in rows if r.modes is not None and not r.row]
    if not known:
        return []
    end = (", all there are." if known[0].complete else
           ", found by search; there may be more." if known[0].method == "search" else
           "; there may be more.")
    return [f"Assembly modes at home's joint values: {len(known[0])}{end}"]


def findings(found: Workspace, rows: Sequence[ModeRow]) -> list[Note]:
    """Return what the user must look at: home, and rows of joint values without modes."""
    out = []
    if found.home_limits:
        out.append(Note(f"home is not within limits: {found.home_limits}."))
    if found.home.singular_value[0] < SINGULAR_HOME:
        out.append(Note("the machine is close to a singularity at home: smallest singular value "
                        f"{found.home.singular_value[0]:.2g} (a sound machine has 0.1 to 1)."))
    bad = [(r.row, r.reason or "no pose closes") for r in rows if not r.modes]
    out += [Note(f"assembly modes of row {n}: {why}." if n else f"assembly modes at home: {why}.")
            for n, why in bad[:LISTED]]
    if len(bad) > LISTED:
        out.append(Note(f"{len(bad) - LISTED} more rows without assembly modes, see modes.csv."))
    return out
