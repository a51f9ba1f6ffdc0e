"""What ``workspace`` says: reach, singularities and assembly modes, in sentences and tables."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import log10
from typing import Any

from ppmcal.design.assembly_modes import Modes
from ppmcal.design.workspace import Workspace
from ppmcal.io.results.tables import pose_columns
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism


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
    short = machine.equations > len(machine.actuators)
    out = [f"{machine.name}: {', '.join(axes)}; other coordinates as at home"
           + (", or as the closure decides." if short else "."),
           f"Reached within limits: {found.share:.1%} of {len(found.table.status)} poses, "
           f"{size_word(found)} {found.size / factor:.4g} {unit}."]
    if found.reached.any():
        out.append(f"Mean dexterity there: {found.index:.3f} (home {found.home.dexterity[0]:.3f}, "
                   "1 is isotropic).")
    return out


def left_table(found: Workspace) -> dict[str, Any]:
    """Return why poses are left out."""
    return {"title": "Poses left out", "columns": ["left out because", "poses"], "note": "",
            "rows": [[reason, str(count)] for reason, count in why(found).items()]}


def singular(found: Workspace) -> list[str]:
    """Return where the singularity nearest to home is."""
    if not found.searched:
        return ["Singularities are looked for on grids of at most three coordinates."]
    near = found.nearest
    if near is None:
        joined = bool((found.table.singular_value >= 0.0).any())
        return ["No singularity on this grid: det A keeps its sign wherever the limbs reach."
                if joined else "No pose of this grid has joint values."]
    factor, unit = distance_unit(found)
    scale = found.mechanism.length_scale / found.mechanism.units.factor("length")
    mixed = len({c >= 3 for c in found.grid.coordinates}) > 1
    count = len(found.singular)
    where = ", ".join(f"{name} {v[0]}" for name, v in
                      places(found.mechanism, near.pose[None]).items())
    out = [f"Nearest singularity to home on this grid: {near.distance / factor:.4g} {unit}"
           + (f" (rotations times {scale:.4g} {found.mechanism.units.length})" if mixed else "")
           + f", at {where}; {count} singular pose{'' if count == 1 else 's'} in singular.csv."]
    unsure = int((found.reached & ~found.sure).sum())
    if unsure:
        out.append(f"For {unsure} of {int(found.reached.sum())} reached poses the grid ends nearer "
                   "than the singularity found: a nearer one may lie beyond (grid_end in map.csv; "
                   "left out of the picture).")
    if near.distance > near.edge:
        out.append(f"The grid ends {near.edge / factor:.4g} {unit} from home; beyond its end "
                   "there may be nearer ones.")
    return out


def modes(found: Workspace, rows: Sequence[ModeRow]) -> list[str]:
    """Return how many assembly modes home's joint values have."""
    known = [r.modes for r in rows if r.modes is not None and not r.row]
    if not known:
        return []
    end = (", all there are." if known[0].complete else
           ", found by search; there may be more." if known[0].method == "search" else
           "; there may be more.")
    return [f"Assembly modes at home's joint values: {len(known[0])}{end}"]


def modes_table(found: Workspace, rows: Sequence[ModeRow]) -> dict[str, Any] | None:
    """Return home's modes, or how many each row of the user's file has."""
    known = [(r.row, r.modes) for r in rows if r.modes is not None]
    if not known:
        return None
    if known[0][0]:
        return {"title": "Assembly modes by row", "note": "",
                "columns": ["row", "modes", "singular", "all of them"],
                "rows": [[str(n), str(len(m)), str(int(m.singular.sum())),
                          "yes" if m.complete else "there may be more"] for n, m in known]}
    own, units = known[0][1], found.mechanism.units
    columns = places(found.mechanism, pose_vector(own.motors))
    cells = [[str(i + 1), *(v[i] for v in columns.values()), f"{own.sign[i]:+.0f}",
              f"{own.condition[i]:.3g}",
              "home" if i == own.home else "singular" if own.singular[i] else ""]
             for i in range(len(own))]
    heads = [f"{n} {units.angle if n.startswith('r') else units.length}" for n in columns]
    return {"title": "Assembly modes at home's joint values", "note": "", "rows": cells,
            "columns": ["", *heads, "det", "cond.", ""]}


def places(mechanism: Mechanism, pose: Array) -> dict[str, list[str]]:
    """Return poses (N, 6) as words by coordinate, with decimals that suit the machine's size."""
    out = {}
    for name, values in pose_columns(mechanism, pose).items():
        size = mechanism.reach / mechanism.units.factor("length")
        if name.startswith("r"):
            size = 3.0 / mechanism.units.factor("angle")
        decimals = max(0, 4 - int(log10(max(size, 1e-9))) - (len(mechanism.dof) > 3))
        out[name] = [f"{v:.{decimals}f}" if round(v, decimals) else "0" for v in values.tolist()]
    return out


@dataclass(frozen=True, eq=False)
class ModeRow:
    """Assembly modes at one row of joint values.

    ``row``: its number in the user's file from 1, 0 for home's joints; ``q`` (k,);
    ``modes`` None where they could not be had, with the ``reason``.
    """

    row: int
    q: Array
    modes: Modes | None
    reason: str = ""


def distance_unit(found: Workspace) -> tuple[float, str]:
    """Return SI value and name of the unit of distances to singularities."""
    units = found.mechanism.units
    return units.factor(found.distance_quantity), units.name(found.distance_quantity)


def size_unit(found: Workspace) -> tuple[float, str]:
    """Return SI value and name of the unit of the reachable part: ``mm^2``, ``mm^2 deg``."""
    units = found.mechanism.units
    factor, parts = 1.0, []
    turns = sum(c >= 3 for c in found.grid.coordinates)
    for quantity, count in (("length", len(found.grid.coordinates) - turns), ("angle", turns)):
        factor *= units.factor(quantity) ** count
        if count:
            parts.append(units.name(quantity) + (f"^{count}" if count > 1 else ""))
    return factor, " ".join(parts)


def size_word(found: Workspace) -> str:
    """Return what the size of the reachable part is called; ``extent`` where angles are in it."""
    if any(c >= 3 for c in found.grid.coordinates):
        return "extent"
    return {1: "length", 2: "area", 3: "volume"}.get(len(found.grid.coordinates), "extent")


def why(found: Workspace) -> dict[str, int]:
    """Return why poses of the grid are left out, and how many for each reason."""
    words: Counter[str] = Counter()
    for status, reason in zip(found.table.status, found.table.reason, strict=True):
        if status == "singular":
            reason = "next to a singularity"
        elif status == "limits":
            reason = re.sub(r" = \S+( \w+)? is outside", " is outside", reason)
        elif status == "unreachable":
            reason = re.sub(r" by \S+ \w+$", "", reason.partition(":")[0])
        if status != "ok":
            words[reason] += 1
    return dict(words.most_common())
