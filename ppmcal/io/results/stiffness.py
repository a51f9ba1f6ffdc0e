"""stiffness.json, and the tables and maps beside it: how far the tool gives way, and what does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.design.statics import AppliedLoad
from ppmcal.design.stiffness import Principal, StiffnessStudy
from ppmcal.io.pose_fields import factors
from ppmcal.io.results.parts import AnalysisRecord, ShownTable
from ppmcal.io.results.record import Flag, Part, Shown, Text, Whole
from ppmcal.io.results.stiffness_wording import findings, sentences
from ppmcal.io.results.tables import map_pictures, map_table, status_counts, unit_map
from ppmcal.kinematics.region import Map
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.provenance import Provenance
from ppmcal.units import ByCoordinate, Key, Length, OfUnit

FORCE = "force_"
"""How columns of what limbs hold begin."""
WIDE = 30.0
"""Colours go with the logarithm where values differ by more than this factor."""


def maps(study: StiffnessStudy) -> list[Map]:
    """Return what the table holds, in the grid's shape, or one row per pose."""
    units, found = study.mechanism.units, study.found
    shape = study.grid.shape if study.grid else (len(found.determinant),)

    def one(name: str, title: str, quantity: str, values: Array) -> Map:
        shown = Map.of(units, name, title, quantity, values.reshape(shape))
        finite = shown.values[np.isfinite(shown.values) & (shown.values > 0.0)]
        wide = bool(finite.size) and bool(finite.max() > WIDE * finite.min())
        return replace(shown, log=wide)

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
    return [*out, *_force_maps(study, shape)]


def _force_maps(study: StiffnessStudy, shape: tuple[int, ...]) -> list[Map]:
    """Return what each limb holds, positive where it pulls."""
    held = study.found.held
    if held is None or held.forces is None:
        return []
    units = [unit for limb in study.mechanism.limbs for unit in (
        "N m" if turns else "N" for turns in limb.kind.surface.of_angles)]
    return [Map(f"{FORCE}{name}", f"Force in {name}, positive where it pulls", unit,
                values.reshape(shape)) for name, unit, values in zip(
                    study.conditions, units, held.forces.T, strict=True)]


def force_table(study: StiffnessStudy) -> ShownTable:
    """Return what surplus limbs hold at home, without a load and under it."""
    held = study.home.held
    columns = {} if held is None else {
        name: force[0] for name, force in (("without load", held.idle), ("under load", held.loaded))
        if force is not None and np.isfinite(force).all()}
    rows = tuple((name, *(f"{force[i]:.4g}" for force in columns.values()))
                 for i, name in enumerate(study.conditions)) if columns else ()
    return ShownTable(title="What limbs hold at home, N", columns=("limb", *columns), rows=rows,
                      note="Positive where they pull.")


def share_table(study: StiffnessStudy) -> ShownTable:
    """Return which part gives way most at home: limb by limb, and part by part, in percent."""
    found = study.home.compliance
    wrench, what = divided_load(study)
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

    named = [*((o, [o]) for o in owners), ("all", owners)]
    rows = tuple((name, *(cell(own, [p]) for p in parts), cell(own, parts)) for name, own in named)
    if not np.isfinite(share).all():
        rows = ()
    return ShownTable(title="What gives way at home, percent", columns=("limb", *parts, "all"),
                      rows=rows, note=f"Shares of the deflection along {what}: of twice the "
                      "energy in the springs.")


def divided_load(study: StiffnessStudy) -> tuple[Array, str]:
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


def principal_table(study: StiffnessStudy) -> ShownTable:
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
            rows.append((word, text, mechanism.units.name(quantity),
                         *(f"{v + 0.0:.3f}" for v in np.round(way, 3))))
    return ShownTable(
        title="Principal stiffness at home", rows=tuple(rows),
        columns=("motion", "stiffness", "unit", "along x", "along y", "along z"),
        note="Inverses of the translational and the rotational block of the compliance, "
        "from soft to stiff; directions and axes in base axes.")


def plotted(study: StiffnessStudy) -> list[Map]:
    """Return the maps that have a picture: over a grid all that differ."""
    one_turn = sum(c >= 3 for c in study.mechanism.dof) == 1
    return [] if study.grid is None else [
        m for m in maps(study) if not (m.name == "rotational_max" and one_turn)
        and not m.name.startswith(FORCE)]


Row = tuple[Shown | None, ...]


class PrincipalStiffness(Part):
    """Principal stiffnesses, soft to stiff, null where rigid; directions in base axes.

    ``directions``: one for each value, along ``axes``.
    """

    unit: Text = ""
    values: OfUnit[Row] = ()
    rigid: tuple[Flag, ...] = ()
    axes: tuple[Text, ...] = ()
    directions: tuple[Row, ...] = ()

    @classmethod
    def of(cls, mechanism: Mechanism, found: Principal, quantity: str) -> Self:
        """Return the principal stiffnesses of ``N/length`` or ``N.m/angle``."""
        axes = [c for c in mechanism.dof if (c < 3) == (quantity == "N/length")]
        return cls.filled(None, mechanism.units, unit=quantity, values=found.values[0],
                          rigid=np.isinf(found.values[0]),
                          axes=tuple(POSE_COORDINATES[c] for c in axes),
                          directions=found.directions[0].T)


class HomeMatrix(Part):
    """Compliance or stiffness at home; ``matrix`` null where it is not finite."""

    rows: tuple[Text, ...] = ()
    columns: tuple[Text, ...] = ()
    matrix: tuple[Row, ...] | None = None
    units: Text = ""


class StiffnessRecord(AnalysisRecord):
    """stiffness.json; ``units``: of the columns of map.csv, by name.

    ``pose`` to ``forces_without_load`` are at home, lengths and angles in the machine's units.
    """

    FILE: ClassVar[str] = "stiffness.json"
    FORMAT: ClassVar[str] = "ppmcal/stiffness/1"
    TITLE: ClassVar[str] = "Stiffness"
    TABLES: ClassVar[tuple[str, ...]] = ("stiffness.csv", "map.csv")

    pictures: Mapping[str, Text] | None = None
    tables: tuple[ShownTable, ...] = ()
    pose: Annotated[ByCoordinate[Mapping[str, Shown | None]], Key("home.pose")] = field(
        default_factory=dict)
    status_at_home: Annotated[Text, Key("home.status")] = ""
    tool: Annotated[Length[tuple[Shown, ...]], Key("home.tool")] = ()
    translational: Annotated[PrincipalStiffness, Key("home.translational")] = PrincipalStiffness()
    rotational: Annotated[PrincipalStiffness, Key("home.rotational")] = PrincipalStiffness()
    compliance: Annotated[HomeMatrix, Key("home.compliance")] = HomeMatrix()
    stiffness: Annotated[HomeMatrix, Key("home.stiffness")] = HomeMatrix()
    load: Annotated[AppliedLoad | None, Key("home.load")] = None
    deflection: Annotated[ByCoordinate[Mapping[str, Shown | None] | None],
                          Key("home.deflection")] = None
    forces: Annotated[Mapping[str, Shown | None] | None, Key("home.forces")] = None
    forces_without_load: Annotated[Mapping[str, Shown | None] | None,
                                   Key("home.forces_without_load")] = None
    poses: Whole = 0
    status: Mapping[str, Whole] = field(default_factory=dict)
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, study: StiffnessStudy, provenance: Mapping[str, Any]) -> Self:
        """Return the record of a study."""
        mechanism, status = study.mechanism, study.found.table.status
        units = {**unit_map(mechanism, mechanism.coordinates),
                 **{m.name: m.unit for m in maps(study)}}
        return cls.filled(
                   None, mechanism.units, format=cls.FORMAT, name=mechanism.name,
                   summary=tuple(sentences(study)),
                   units=units, findings=tuple(findings(study)),
                   pictures={f"map_{m.name}.png": f"{m.title}, {m.unit}." for m in plotted(study)},
                   tables=tuple(t for t in (
                       share_table(study), force_table(study), principal_table(study)) if t.rows),
                   **_at_home(study), poses=len(status),
                   status=status_counts(status), provenance=provenance)

    def files(self, study: StiffnessStudy) -> dict[str, str | bytes]:
        """Return map.csv, stiffness.json and, over a grid, a picture of each map."""
        table = study.found.table
        # poses without an answer are written as they were wanted
        pose = np.where(np.isnan(table.pose), study.wanted, table.pose)
        drawn = {} if study.grid is None else map_pictures(
            study.mechanism, study.grid, plotted(study), study.found.determinant)
        return {"map.csv": map_table(study.mechanism, pose, maps(study), table.status,
                                     table.reason),
                self.FILE: self.text(), **drawn}


def _at_home(study: StiffnessStudy) -> dict[str, Any]:
    """Return what was found at home, as fields of the record."""
    mechanism, found = study.mechanism, study.home.compliance
    units, dof = mechanism.units, list(mechanism.dof)
    factor = factors(units)[dof]
    names = tuple(POSE_COORDINATES[c] for c in dof)
    loads = tuple(WRENCH[c] for c in dof)
    compliance, stiffness = found.matrix[0] / factor[:, None], found.stiffness[0] * factor
    loaded: dict[str, Any] = {}
    if study.load is not None:
        moved = study.home.deflection(study.load.wrench)[dof]
        loaded = {"load": study.load, "deflection": dict(zip(names, moved, strict=True))}
    held = study.home.held
    for key, force in (() if held is None else (
            ("forces", held.loaded), ("forces_without_load", held.idle))):
        if force is not None:
            loaded[key] = dict(zip(study.conditions, force[0], strict=True))
    return dict(
        pose=dict(zip(names, study.home.pose[dof], strict=True)),
        status_at_home=study.home.status, tool=study.tool,
        translational=PrincipalStiffness.of(mechanism, found.translational(), "N/length"),
        rotational=PrincipalStiffness.of(mechanism, found.rotational(), "N.m/angle"),
        compliance=HomeMatrix(rows=names, columns=loads, matrix=compliance.tolist(),
                              units="rows in the units of the pose, per N or N m"),
        stiffness=HomeMatrix(
            rows=loads, columns=names, units="N or N m, per unit of the pose",
            matrix=stiffness.tolist() if np.isfinite(stiffness).all() else None), **loaded)
