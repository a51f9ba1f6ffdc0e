"""map.csv, stiffness.json and pictures: how far the tool gives way, and what gives way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppmcal.design.stiffness import Home, Principal, Stiffnesses
from ppmcal.io import json_text
from ppmcal.io.results.stiffness_wording import (
    Load,
    across_words,
    home_findings,
    home_words,
    map_findings,
    model_words,
)
from ppmcal.io.results.tables import map_table, unit_map
from ppmcal.kinematics.region import Grid
from ppmcal.linalg import Array
from ppmcal.model.mechanism import POSE_COORDINATES, Mechanism
from ppmcal.plotting.map_data import Map

WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")
WIDE = 30.0
"""Colours go with the logarithm where values differ by more than this factor."""


@dataclass(frozen=True, eq=False)
class Study:
    """What was asked, and what was found.

    Attributes:
        mechanism: as read.
        wanted: poses (N, 6), nan where open; ``grid``: where they are one.
        tool: tool point in platform axes (3,), m.
        load: None without one.
        home: compliance at home; ``found``: over the poses.
        notes: what the command has to say itself.
    """

    mechanism: Mechanism
    wanted: Array
    grid: Grid | None
    tool: Array
    load: Load | None
    home: Home
    found: Stiffnesses
    notes: tuple[str, ...] = ()

    @property
    def said(self) -> list[str]:
        """The result in sentences."""
        return [*home_words(self.mechanism, self.home, self.tool, self.load),
                *across_words(self.mechanism, self.found, self.home), *self.notes,
                *model_words(self.mechanism)]

    @property
    def findings(self) -> list[str]:
        """What the user must look at."""
        return [*home_findings(self.mechanism, self.home, self.load),
                *map_findings(self.mechanism, self.found, self.load)]


def maps(study: Study) -> list[Map]:
    """Return what the table holds, in the grid's shape, or one row per pose."""
    units, found = study.mechanism.units, study.found
    shape = study.grid.shape if study.grid else (len(found.determinant),)

    def one(name: str, title: str, quantity: str, values: Array) -> Map:
        shown = values / units.factor(quantity)
        finite = shown[np.isfinite(shown) & (shown > 0.0)]
        wide = bool(finite.size) and bool(finite.max() > WIDE * finite.min())
        return Map(name, title, units.name(quantity), shown.reshape(shape), wide)

    soft, stiff = found.translational.T
    out = [one("stiffness_min", "Translational stiffness, softest direction", "N/length", soft),
           one("stiffness_max", "Translational stiffness, stiffest direction", "N/length", stiff)]
    turns = [c for c in study.mechanism.dof if c >= 3]
    if turns:
        soft, stiff = found.rotational.T
        out += [one("rotational_min", "Rotational stiffness, softest axis", "N.m/angle", soft),
                one("rotational_max", "Rotational stiffness, stiffest axis", "N.m/angle", stiff)]
    if found.deflection is not None and study.load is not None:
        size = [np.linalg.norm(found.deflection[:, part], axis=1)
                for part in (slice(0, 3), slice(3, 6))]
        under = f"of the tool under {study.load.words}"
        out.append(one("deflection_position", f"Displacement {under}", "length", size[0]))
        if turns:
            out.append(one("deflection_rotation", f"Rotation {under}", "angle", size[1]))
    return out


def files(study: Study, provenance: Mapping[str, Any]) -> dict[str, str | bytes]:
    """Return map.csv, stiffness.json and, over a grid, a picture of each map."""
    shown = maps(study)
    pictures: dict[str, bytes] = {}
    captions: dict[str, str] = {}
    if study.grid is not None:
        from ppmcal.plotting.maps import draw_map

        determinant = study.found.determinant.reshape(study.grid.shape)
        turns = sum(c >= 3 for c in study.mechanism.dof)
        for one in shown:
            if one.name == "rotational_max" and turns == 1:
                continue
            name = f"map_{one.name}.png"
            pictures[name] = draw_map(study.mechanism, study.grid, one, determinant)
            captions[name] = f"{one.title}, {one.unit}."
    table = study.found.table
    # poses without an answer are written as they were wanted
    pose = np.where(np.isnan(table.pose), study.wanted, table.pose)
    text = map_table(study.mechanism, pose, shown, table.status, table.reason)
    content = json_text(record(study, shown, captions, provenance))
    return {"map.csv": text, "stiffness.json": content, **pictures}


def record(study: Study, shown: Sequence[Map], pictures: Mapping[str, str],
           provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return stiffness.json."""
    status = study.found.table.status
    units = {**unit_map(study.mechanism, study.mechanism.coordinates),
             **{m.name: m.unit for m in shown}}
    return {"format": "ppmcal/stiffness/1", "name": study.mechanism.name, "said": study.said,
            "units": units, "findings": study.findings, "pictures": dict(pictures),
            "tables": [t for t in (share_table(study), principal_table(study)) if t["rows"]],
            "home": home_record(study), "poses": len(status),
            "status": {s: status.count(s) for s in sorted(set(status))},
            "provenance": dict(provenance)}


def home_record(study: Study) -> dict[str, Any]:
    """Return all numbers at home, file units; rotation rows and columns in the file's angle."""
    mechanism, found = study.mechanism, study.home.compliance
    units = mechanism.units
    factor = np.array([units.factor("length" if c < 3 else "angle") for c in mechanism.dof])
    names = [POSE_COORDINATES[c] for c in mechanism.dof]
    loads = [WRENCH[c] for c in mechanism.dof]
    out: dict[str, Any] = {
        "pose": dict(zip(names, (study.home.pose[list(mechanism.dof)] / factor).tolist(),
                         strict=True)),
        "status": study.home.status, "tool": study.tool / units.factor("length"),
        "translational": _principal(mechanism, found.translational(), "N/length"),
        "rotational": _principal(mechanism, found.rotational(), "N.m/angle"),
        "compliance": {"rows": names, "columns": loads, "matrix": found.matrix[0] / factor[:, None],
                       "units": "rows in the units of the pose, per N or N m"},
        "stiffness": {"rows": loads, "columns": names, "matrix": None,
                      "units": "N or N m, per unit of the pose"}}
    whole = found.stiffness[0]
    if np.isfinite(whole).all():
        out["stiffness"]["matrix"] = whole * factor
    if study.load is not None:
        moved = found.deflection(study.load.wrench)[0, list(mechanism.dof)] / factor
        out["load"] = {"words": study.load.words,
                       **dict(zip(WRENCH, study.load.wrench.tolist(), strict=True))}
        out["deflection"] = dict(zip(names, moved.tolist(), strict=True))
    return out


def _principal(mechanism: Mechanism, found: Principal, quantity: str) -> dict[str, Any]:
    """Return principal values, soft to stiff, null where rigid; directions in base axes."""
    axes = [c for c in mechanism.dof if (c < 3) == (quantity == "N/length")]
    values = found.values[0] / mechanism.units.factor(quantity)
    return {"unit": mechanism.units.name(quantity), "values": values, "rigid": np.isinf(values),
            "axes": [POSE_COORDINATES[c] for c in axes], "directions": found.directions[0].T}


def share_table(study: Study) -> dict[str, Any]:
    """Return which part gives way most at home: limb by limb, and part by part, in percent."""
    found = study.home.compliance
    wrench, what = asked_load(study)
    share = 100.0 * found.shares(wrench)[0]
    owners = list(dict.fromkeys(s.owner for s in found.springs))
    parts = sorted({s.part.partition(".")[0] for s in found.springs},
                   key=lambda p: (p.startswith("joint"), p))
    sums = {(o, p): [float(v) for v, s in zip(share, found.springs, strict=True)
                     if s.owner == o and s.part.partition(".")[0] == p]
            for o in owners for p in parts}

    def cell(chosen: list[str], part: list[str]) -> str:
        values = [v for o in chosen for p in part for v in sums[o, p]]
        return f"{sum(values):.1f}" if values else "-"

    rows = [[o, *(cell([o], [p]) for p in parts), cell([o], parts)] for o in owners]
    rows.append(["all", *(cell(owners, [p]) for p in parts), cell(owners, parts)])
    if not np.isfinite(share).all():
        rows = []
    return {"title": "What gives way at home, percent", "columns": ["limb", *parts, "all"],
            "rows": rows, "note": f"Shares of the deflection along {what}: of twice the energy "
                    "in the springs."}


def asked_load(study: Study) -> tuple[Array, str]:
    """Return the load whose deflection is divided up (6,), and its name."""
    if study.load is not None:
        return study.load.wrench, study.load.words
    found = study.home.compliance
    out = np.zeros(6)
    move = [c for c in study.mechanism.dof if c < 3]
    soft = found.translational()
    if np.isfinite(soft.values[0, 0]):
        out[move] = soft.directions[0, :, 0]
        return out, "a force in the softest direction"
    turn = [c for c in study.mechanism.dof if c >= 3]
    soft = found.rotational()
    if turn:
        out[turn] = soft.directions[0, :, 0]
    return out, "a moment about the softest axis"


def principal_table(study: Study) -> dict[str, Any]:
    """Return the principal stiffnesses at home with their directions."""
    mechanism, found = study.mechanism, study.home.compliance
    rows = []
    for word, principal, quantity in (("translation", found.translational(), "N/length"),
                                      ("rotation", found.rotational(), "N.m/angle")):
        axes = [c % 3 for c in mechanism.dof if (c < 3) == (word == "translation")]
        for k, value in enumerate(principal.values[0] / mechanism.units.factor(quantity)):
            way = np.zeros(3)
            way[axes] = principal.directions[0, :, k]
            text = "rigid" if np.isinf(value) else f"{value:.5g}"
            rows.append([word, text, mechanism.units.name(quantity),
                         *(f"{v + 0.0:.3f}" for v in np.round(way, 3))])
    return {"title": "Principal stiffness at home",
            "columns": ["motion", "stiffness", "unit", "along x", "along y", "along z"],
            "rows": rows,
            "note": "Inverses of the translational and the rotational block of the compliance, "
                    "from soft to stiff; directions and axes in base axes."}
