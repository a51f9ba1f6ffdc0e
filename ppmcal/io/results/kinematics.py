"""kinematics.csv and kinematics.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ppmcal.io import csv_text
from ppmcal.io.results.record import Finite, Part, Provenance, Record, Text, Whole
from ppmcal.io.results.tables import filled_columns, joint_columns, pose_columns, unit_map
from ppmcal.io.rotations import EULER, columns_of
from ppmcal.kinematics.rotations import euler_like, to_quaternion
from ppmcal.kinematics.tables import KinematicsTable
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted

LOCKED = "gimbal lock: only euler_1 and euler_3 together are known, euler_3 is set to 0"


@dataclass(frozen=True)
class PoseFormat:
    """How the poses of kinematics.csv are written.

    Attributes:
        tool: the point whose poses they are, platform axes (3,), m; None for the origin.
        pose: poses (N, 6), SI, in place of the table's; None for those.
        rotation: a convention of :mod:`ppmcal.kinematics.rotations`.
        method: by which forward kinematics was solved, else empty.
    """

    tool: Array | None = None
    pose: Array | None = None
    rotation: str = "rotvec"
    method: str = ""

    def columns(self, mechanism: Mechanism, pose: Array, given: Mapping[str, Any] | None = None
                ) -> tuple[dict[str, Array], NDArray[np.bool_]]:
        """Return pose columns in file units, and rows whose Euler angles are not unique (N,).

        Angles among the columns ``given`` stay as they are; the others go with them.
        """
        own, locked = pose_columns(mechanism, pose), np.zeros(len(pose), dtype=bool)
        if self.rotation == "rotvec":
            return own, locked
        own = {k: v for k, v in own.items() if not k.startswith("r")}
        if self.rotation == "quat":
            turned = to_quaternion(pose[:, 3:])
        else:
            unit, none = mechanism.units.factor("angle"), np.full(len(pose), np.nan)
            named = np.stack([np.asarray((given or {}).get(name, none), dtype=float)
                              for name in EULER], axis=1)
            turned, locked = euler_like(pose[:, 3:], named * unit, self.rotation)
            turned = turned / unit
        return own | dict(zip(columns_of(self.rotation), turned.T, strict=True)), locked


class PosePoint(Part):
    """The point whose poses are written, platform axes, in ``unit``."""

    point: tuple[Finite, ...] = ()
    unit: Text = ""


class KinematicsRecord(Record):
    """kinematics.json: what was solved; ``status``: rows by status; ``units`` by column."""

    FILE: ClassVar[str] = "kinematics.json"
    FORMAT: ClassVar[str] = "ppmcal/kinematics/1"

    which: Text = ""
    rows: Whole | None = None
    status: Mapping[Text, Whole] = Field(default_factory=dict)
    units: Mapping[Text, Text] = Field(default_factory=dict)
    rotation: Text = ""
    tool: PosePoint | None = None
    method: Text = ""
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, mechanism: Mechanism, table: KinematicsTable, which: str, form: PoseFormat,
           names: Sequence[str], provenance: Mapping[str, Any]) -> KinematicsRecord:
        """Return the record of a table whose columns are ``names``."""
        chosen: dict[str, Any] = {"rotation": form.rotation}
        if form.tool is not None:
            point = form.tool / mechanism.units.factor("length")
            chosen["tool"] = PosePoint(point=tuple(point.tolist()), unit=mechanism.units.length)
        if form.method:
            chosen["method"] = form.method
        return cls(format=cls.FORMAT, which=which, rows=len(table.status),
                   status={s: table.status.count(s) for s in sorted(set(table.status))},
                   units=unit_map(mechanism, names), **chosen,
                   provenance=Provenance.model_validate(provenance))


def kinematics_files(mechanism: Mechanism, table: KinematicsTable, header: Sequence[str],
                     columns: Sequence[Any], which: str, provenance: Mapping[str, Any],
                     form: PoseFormat | None = None) -> tuple[dict[str, str], int]:
    """Return kinematics.csv and kinematics.json, and how many rows are in gimbal lock."""
    form = form or PoseFormat()
    own = dict(zip(header, columns, strict=True))
    pose, locked = form.columns(mechanism, table.pose if form.pose is None else form.pose,
                                own if which == "inverse" else None)
    added: dict[str, Any] = {}
    solved = list(columns)
    if which == "forward":
        added |= pose
    else:
        added |= joint_columns(mechanism, table.q, "q_{}")
        solved = filled_columns(header, columns, pose) if which == "inverse" else solved
        locked[:] = False
    if which == "inverse":
        added |= {k: v for k, v in pose.items() if k not in header}
    if which == "velocity":
        added |= joint_columns(mechanism, table.rate, "rate_{}")
    own |= dict(zip(header, solved, strict=True))
    added |= {"condition": table.singular_value, "status": list(table.status), "reason": [
        LOCKED if lock and not r else r for r, lock in zip(table.reason, locked, strict=True)]}
    # what was computed stands in place of input columns of the same name
    together = {**own, **added}
    record = KinematicsRecord.of(mechanism, table, which, form, list(together), provenance)
    return ({"kinematics.csv": csv_text(list(together), list(together.values())),
             record.FILE: record.text()}, int(locked.sum()))


def solved_sentence(solved: int, rows: int) -> str:
    """Return how many rows were solved."""
    return f"{solved} of {counted(rows, 'row')} solved"
