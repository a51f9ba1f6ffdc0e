"""stiffness.json and the files beside it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import Annotated, Any, ClassVar, Self

import numpy as np

from ppmcal.design.stiffness import Principal
from ppmcal.io.pose_fields import factors
from ppmcal.io.results.parts import AnalysisRecord, ShownTable
from ppmcal.io.results.record import Flag, Part, Shown, Text, Whole
from ppmcal.io.results.stiffness_tables import (
    FORCE,
    WRENCH,
    AppliedLoad,
    StiffnessStudy,
    force_table,
    maps,
    principal_table,
    share_table,
)
from ppmcal.io.results.stiffness_wording import findings, sentences
from ppmcal.io.results.tables import map_pictures, map_table, unit_map
from ppmcal.kinematics.region import Map
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.provenance import Provenance
from ppmcal.units import ByCoordinate, Key, Length, OfUnit

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
                   status={s: status.count(s) for s in sorted(set(status))},
                   provenance=Provenance(**provenance))

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


def plotted(study: StiffnessStudy) -> list[Map]:
    """Return the maps that have a picture: over a grid all that differ."""
    one_turn = sum(c >= 3 for c in study.mechanism.dof) == 1
    return [] if study.grid is None else [
        m for m in maps(study) if not (m.name == "rotational_max" and one_turn)
        and not m.name.startswith(FORCE)]
