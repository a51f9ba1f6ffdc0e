"""workspace.json, its tables and maps, and what is said of reach, singularities and modes."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import field, replace
from math import log10
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.design.assembly_modes import ModeRow
from ppmcal.design.workspace import Nearest, Workspace
from ppmcal.io import csv_text
from ppmcal.io.results.parts import Range, ShownTable
from ppmcal.io.results.record import Flag, Part, PlainCell, Record, Shown, Text, Whole
from ppmcal.io.results.tables import (
    joint_columns,
    map_pictures,
    map_table,
    pose_columns,
    status_counts,
    unit_map,
)
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.region import Map
from ppmcal.kinematics.tables import SINGULAR_HOME, limit_reason
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import Note
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length
from ppmcal.wording import pluralize

LISTED = 10
"""Rows without assembly modes that are findings of their own."""


def maps(found: Workspace) -> list[Map]:
    """Return the columns of map.csv, values wherever there are joint values."""
    q, units, far = found.quality, found.mechanism.units, found.distance_quantity
    columns = (
        ("condition", "smallest singular value of A", "1", found.table.singular_value),
        ("condition_relative", "smallest singular value of A, home = 1", "1",
         found.table.singular_value / found.home.singular_value[0]),
        ("dexterity", "dexterity, from joint rates to platform: 1 is isotropic", "1", q.dexterity),
        ("dexterity_legs", "how evenly the legs hold the platform: 1 is isotropic", "1", q.legs),
        ("singularity_distance", "distance to the nearest singularity", far, found.distance),
        ("grid_end", "distance to the end of the grid", far, found.edge),
        ("determinant", "det A, home = 1", "1", q.determinant / found.home.determinant[0]))
    return [Map.of(units, name, title, quantity, values.reshape(found.grid.shape))
            for name, title, quantity, values in columns]


def plotted(found: Workspace) -> list[Map]:
    """Return the maps worth a picture.

    What the machine reaches within limits; the determinant everywhere, as it changes sign
    beyond. Legs that drive the platform each by itself hold it as they move it: one picture.
    """
    reached = found.reached.reshape(found.grid.shape)
    same = np.allclose(found.quality.dexterity, found.quality.legs, equal_nan=True)
    out = []
    for m in maps(found):
        if m.name in ("condition", "grid_end") or (m.name == "dexterity_legs" and same):
            continue
        there = reached & found.sure.reshape(reached.shape) if (
            m.name == "singularity_distance") else reached
        values = np.asarray(m.values if m.name == "determinant" else
                            np.where(there, m.values, np.nan), dtype=float)
        if np.isfinite(values).any():
            out.append(replace(m, values=values))
    return out


def modes_file(mechanism: Mechanism, rows: Sequence[ModeRow]) -> str:
    """Return modes.csv: one line for each mode, or one with the reason where there is none.

    ``reason`` also says which joint value is outside limits; modes are found there all the same.
    """
    parts: dict[str, list[Any]] = {}
    for entry in rows:
        for name, values in _mode_lines(mechanism, entry).items():
            parts.setdefault(name, []).extend(values)
    return csv_text(list(parts), [np.array(v) if isinstance(v[0], float) else v
                                  for v in parts.values()])


def _mode_lines(mechanism: Mechanism, entry: ModeRow) -> dict[str, list[Any]]:
    """Return the columns of one row's modes."""
    modes = entry.modes
    if modes is None or not len(modes):
        reason = entry.reason or "no pose closes" + (
            "" if modes is None or modes.complete else " that the search would find")
        count, nan = 1, np.full(1, np.nan)
        pose, sign, condition = np.full((1, 6), np.nan), nan, nan
        number, home = [0], ["no"]
        status, reasons = ["refused" if modes is None else "none"], [reason]
    else:
        count, pose = len(modes), pose_vector(modes.motors)
        sign, condition = modes.sign, modes.singular_value
        number = list(range(1, count + 1))
        home = ["yes" if i == modes.home else "no" for i in range(count)]
        status = ["singular" if s else "ok" for s in modes.singular]
        beyond = limit_reason(mechanism, entry.q)
        reasons = ["; ".join(filter(None, ("two modes meet here, or nearly" if s else "", beyond)))
                   for s in modes.singular]
    joints = joint_columns(mechanism, np.tile(entry.q, (count, 1)), "q_{}")
    return {"row": [entry.row] * count, "mode": number,
            **{n: v.tolist() for n, v in joints.items()},
            **{n: v.tolist() for n, v in pose_columns(mechanism, pose).items()},
            "determinant": sign.tolist(), "condition": condition.tolist(), "home": home,
            "status": status, "reason": reasons}


def left_table(found: Workspace) -> ShownTable:
    """Return why poses are left out."""
    return ShownTable(title="Poses left out", columns=("left out because", "poses"), note="",
                      rows=tuple((reason, str(n)) for reason, n in left_out(found).items()))


def modes_table(found: Workspace, rows: Sequence[ModeRow]) -> ShownTable | None:
    """Return home's modes, or how many each row of the user's file has."""
    known = [(r.row, r.modes) for r in rows if r.modes is not None]
    if not known:
        return None
    if known[0][0]:
        return ShownTable(
            title="Assembly modes by row", columns=("row", "modes", "singular", "all of them"),
            rows=tuple((str(n), str(len(m)), str(int(m.singular.sum())),
                        "yes" if m.complete else "there may be more") for n, m in known), note="")
    own, units = known[0][1], found.mechanism.units
    columns = places(found.mechanism, pose_vector(own.motors))
    cells = ((str(i + 1), *(v[i] for v in columns.values()), f"{own.sign[i]:+.0f}",
              f"{own.singular_value[i]:.3g}",
              "home" if i == own.home else "singular" if own.singular[i] else "")
             for i in range(len(own)))
    heads = [f"{n} {units.angle if n.startswith('r') else units.length}" for n in columns]
    return ShownTable(title="Assembly modes at home's joint values", rows=tuple(cells), note="",
                      columns=("", *heads, "det", "cond.", ""))


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


def left_out(found: Workspace) -> dict[str, int]:
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


def reach(found: Workspace) -> list[str]:
    """Return how much of the grid the machine reaches."""
    axes = [f"{name} {r.low:.4g} to {r.high:.4g} {r.unit} ({r.levels} levels)"
            for name, r in _axes(found).items()]
    factor, unit = size_unit(found)
    out = [f"{found.mechanism.name}: {', '.join(axes)}; other coordinates as at home"
           + (", or as the closure decides." if found.mechanism.dependent > 0 else "."),
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
    pose = np.zeros(6)
    pose[list(found.mechanism.dof)] = list(near.pose.values())
    out = ["Nearest singularity to home on this grid: "
           + units.words(near.distance, quantity)
           + (f" (rotations times {scale})" if mixed else "")
           + f", at {_place(found, pose)}; {pluralize(len(found.singular), 'singular pose')} in "
           "singular.csv."]
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


def modes_sentences(found: Workspace, rows: Sequence[ModeRow]) -> list[str]:
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


MEANING = {
    "condition": "smallest singular value of A, rotation columns divided by length_scale",
    "condition_relative": "condition, home = 1",
    "dexterity": "smallest over largest singular value of J = -inv(A) Jq, rotation rows times "
                 "length_scale, joint angles as arcs at length_scale (local conditioning index)",
    "dexterity_legs": "smallest over largest singular value of A",
    "singularity_distance": "to the nearest pose of singular.csv, in the grid's coordinates; "
                            "rotations times length_scale unless all coordinates are rotations",
    "grid_end": "distance to the end of the grid: where singularity_distance is larger, a nearer "
                "singularity may lie beyond",
    "determinant": "det A, home = 1; 0 on the singular curve, negative beyond it",
}
"""What the columns of map.csv are."""


class ModeCount(Part):
    """How many assembly modes one row has, and how far that is known; ``home``: from 1."""

    row: Whole = 0
    count: Whole | None = None
    singular: Whole = 0
    home: Whole | None = None
    complete: Flag = False
    method: Text = ""
    reason: Text = ""

    @classmethod
    def of(cls, entry: ModeRow) -> Self:
        """Return the count of one row's modes, or why there is none."""
        modes = entry.modes
        if modes is None:
            return cls(row=entry.row, count=None, reason=entry.reason)
        return cls(row=entry.row, count=len(modes), singular=int(modes.singular.sum()),
                   home=None if modes.home is None else modes.home + 1,
                   complete=modes.complete, method=modes.method)


class WorkspaceRecord(Record):
    """workspace.json; ``columns``: what those of map.csv are; ``units``: theirs, by name.

    ``reachable``: share of the grid within limits, and its size by what that is called;
    ``conditioning_index``: mean dexterity there; ``home``: figures there, bare, and which joint is
    outside its limits; ``nearest``: of ``singular_poses`` of the grid, if they were ``searched``.
    """

    FILE: ClassVar[str] = "workspace.json"
    FORMAT: ClassVar[str] = "ppmcal/workspace/1"
    TITLE: ClassVar[str] = "Workspace and singularities"
    TABLES: ClassVar[tuple[str, ...]] = ("workspace.csv", "map.csv", "singular.csv", "modes.csv")

    name: Text = ""
    grid: Mapping[str, Range] = field(default_factory=dict)
    poses: Whole = 0
    status: Mapping[str, Whole] = field(default_factory=dict)
    left_out: Mapping[str, Whole] = field(default_factory=dict)
    reachable: Mapping[str, PlainCell] = field(default_factory=dict)
    conditioning_index: Mapping[str, Shown | None] = field(default_factory=dict)
    home: Mapping[str, PlainCell] = field(default_factory=dict)
    searched: Annotated[Flag, Key("singular.searched")] = False
    singular_poses: Annotated[Whole, Key("singular.points")] = 0
    nearest: Annotated[Nearest | None, Key("singular.nearest_to_home")] = None
    modes: tuple[ModeCount, ...] = ()
    summary: Annotated[tuple[Text, ...], Key("said")] = ()
    findings: tuple[Text, ...] = ()
    pictures: Mapping[str, Text] | None = None
    tables: tuple[ShownTable, ...] = ()
    columns: Mapping[str, Text] = field(default_factory=dict)
    units: Mapping[str, Text] = field(default_factory=dict)
    length_scale: Annotated[Length[Shown | None], Key("length_scale.value")] = None
    length_scale_unit: Annotated[Text, Key("length_scale.unit")] = ""
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, found: Workspace, rows: Sequence[ModeRow], provenance: Mapping[str, Any]) -> Self:
        """Return the record of a workspace and the assembly modes of rows of joint values."""
        machine, home = found.mechanism, found.home
        size, unit = size_unit(found)
        header = (*machine.coordinates, *(f"q_{a}" for a in machine.actuators))
        return cls.filled(
            None, machine.units, format=cls.FORMAT, name=machine.name, grid=_axes(found),
            poses=len(found.table.status),
            status=status_counts(found.table.status), left_out=left_out(found),
            reachable={"share": found.share, size_word(found): found.size / size, "unit": unit},
            conditioning_index={"dexterity": found.index, "dexterity_legs": found.index_legs},
            home={"condition": home.singular_value[0], "dexterity": home.dexterity[0],
                  "dexterity_legs": home.legs[0], "determinant": np.sign(home.determinant[0]),
                  "outside_limits": found.home_limits or None},
            searched=found.searched, singular_poses=len(found.singular), nearest=found.nearest,
            modes=tuple(ModeCount.of(r) for r in rows),
            summary=(*reach(found), *singularities(found), *modes_sentences(found, rows)),
            findings=tuple(findings(found, rows)),
            pictures={f"map_{m.name}.png": m.title for m in plotted(found)},
            tables=tuple(t for t in (left_table(found), modes_table(found, rows)) if t),
            columns=MEANING,
            units=unit_map(machine, header) | {
                "singularity_distance": machine.units.name(found.distance_quantity)},
            length_scale=machine.length_scale, length_scale_unit=machine.units.length,
            provenance=provenance)

    def files(self, found: Workspace, rows: Sequence[ModeRow]) -> dict[str, str | bytes]:
        """Return map.csv, singular.csv, modes.csv, workspace.json and the pictures."""
        machine, table = found.mechanism, found.table
        pose = np.where(finite_rows(table.pose)[:, None], table.pose, found.grid.poses(machine))
        edge = pose_columns(machine, found.singular)
        return {"map.csv": map_table(machine, pose, maps(found), table.status, table.reason),
                "singular.csv": csv_text(list(edge), list(edge.values())),
                "modes.csv": modes_file(machine, rows), self.FILE: self.text(),
                **map_pictures(machine, found.grid, plotted(found), found.quality.determinant)}


def _axes(found: Workspace) -> dict[str, Range]:
    return {POSE_COORDINATES[c]: Range.filled(
        None, found.mechanism.units, low=float(level[0]), high=float(level[-1]),
        levels=len(level), unit="length" if c < 3 else "angle")
        for c, level in zip(found.grid.coordinates, found.grid.levels, strict=True)}
