"""kinematics.csv and kinematics.json, with how well the model behind them is known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any, ClassVar

import numpy as np

from ppmcal.design.every_mode import EveryMode
from ppmcal.io.pose_fields import EULER, QUATERNION, columns_of
from ppmcal.io.poses import Given
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.record import Finite, Flag, Part, Record, Shown, Text, Whole
from ppmcal.io.results.tables import (
    WrittenTable,
    column_units,
    filled_columns,
    joint_columns,
    pose_columns,
    status_counts,
    unit_map,
)
from ppmcal.kinematics.rotations import euler_like, to_quaternion
from ppmcal.kinematics.tables import SINGULAR, KinematicsTable, home_singular_value
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length
from ppmcal.wording import number, pluralize

COVARIANCE, SIGMAS, TOLERANCES, NONE = "covariance", "sigmas", "tolerances", "none"
"""Where an uncertainty is from: the calibration, the file's sigmas alone, what was designed."""
BASES = {COVARIANCE: "covariance of the calibration",
         SIGMAS: "the file's sigmas, as if independent"}


class KinematicsUncertainty(Part):
    """How well the model is known; ``source``: covariance, sigmas, tolerances or none.

    ``frame``: in which a pose is uncertain so much, ``base`` or a data set; ``sizes`` by column.
    With ``tolerances`` these are not columns of the table but what the design allows.
    """

    source: Text = NONE
    frame: Text = ""
    sizes: Mapping[Text, ErrorSize] = field(default_factory=dict)

    def words(self) -> str:
        """Return one sentence."""
        if self.source == NONE:
            return ("How sure this is is not known: the file carries neither sigmas nor "
                    "tolerances.")
        sizes = {k: f"{number(s.rms)} {s.unit}".strip() for k, s in self.sizes.items()
                 if s.rms is not None}
        if not sizes:
            return "How sure this is is not known: no row has an uncertainty."
        told = ", ".join(v if k in ("sigma_position", "sigma_rotation") else
                         f"{k.removeprefix('sigma_')} {v}" for k, v in sizes.items())
        where = f" in the frame of {self.frame}" if self.frame not in ("", "base") else (
            " in the base frame" if self.frame else "")
        if self.source == TOLERANCES:
            return ("The file is nominal, without sigmas: its tolerances, as if independent, allow "
                    f"one standard deviation of {told}{where} (rms over rows).")
        return (f"The model's own uncertainty: one standard deviation of {told}{where} (rms over "
                f"rows; {BASES[self.source]}).")


@dataclass(frozen=True, eq=False)
class ModelSigma:
    """Columns of standard deviations (N,), file units, and the entry of kinematics.json."""

    columns: Mapping[str, Array] = field(default_factory=dict)
    entry: KinematicsUncertainty = field(default_factory=KinematicsUncertainty)

    @classmethod
    def of(cls, mechanism: Mechanism, columns: Mapping[str, Array], source: str, frame: str
           ) -> ModelSigma:
        """Return the uncertainty of a table; of tolerances the columns are listed by size alone."""
        units = unit_map(mechanism, list(columns))
        sizes = {name: ErrorSize(rms=_rms(values), unit=units.get(name, ""))
                 for name, values in columns.items()}
        return cls({} if source == TOLERANCES else columns,
                   KinematicsUncertainty(source=source, frame=frame, sizes=sizes))


def _rms(values: Array) -> float | None:
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else None


KINEMATICS_TABLE = WrittenTable("kinematics.csv", lambda name: (
    name in (*POSE_COORDINATES, *EULER, *QUATERNION, "condition", "time")
    or name.startswith(("q_", "rate_"))))
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
                ) -> tuple[dict[str, Array], Bools]:
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


class KinematicsRecord(Record):
    """kinematics.json: what was solved.

    ``status``: rows by status; ``units`` by column; ``tool``: the point whose poses are written,
    platform axes; ``limits``: lowest and highest value of each joint that has limits, in its
    column's unit; ``conditioning``: the smallest singular value at ``home``, and below which a pose
    counts as ``singular``; ``modes``: how many assembly modes each row has, by which method, and
    whether these are all.
    """

    FILE: ClassVar[str] = "kinematics.json"
    FORMAT: ClassVar[str] = "ppmcal/kinematics/1"

    which: Text = ""
    rows: Whole | None = None
    status: Mapping[Text, Whole] = field(default_factory=dict)
    units: Mapping[Text, Text] = field(default_factory=dict)
    rotation: Text = ""
    tool: Annotated[Length[tuple[Finite, ...] | None], Key("tool.point")] = None
    tool_unit: Annotated[Text, Key("tool.unit")] = ""
    method: Text = ""
    limits: Mapping[Text, tuple[Finite | None, Finite | None]] = field(default_factory=dict)
    conditioning: Mapping[str, Shown | None] = field(default_factory=dict)
    mode_method: Annotated[Text, Key("modes.method")] = ""
    all_modes: Annotated[Flag, Key("modes.complete")] = False
    modes: Annotated[tuple[Whole, ...] | None, Key("modes.counts")] = None
    uncertainty: KinematicsUncertainty = KinematicsUncertainty()
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, mechanism: Mechanism, table: KinematicsTable, which: str, form: PoseFormat,
           names: Sequence[str], provenance: Mapping[str, Any], modes: EveryMode | None,
           uncertainty: KinematicsUncertainty) -> KinematicsRecord:
        """Return the record of a table whose columns are ``names``."""
        home = home_singular_value(mechanism)[0]
        chosen: dict[str, Any] = {} if form.tool is None else {
            "tool": form.tool, "tool_unit": mechanism.units.length}
        if form.method:
            chosen["method"] = form.method
        if modes is not None:
            chosen |= {"mode_method": modes.method, "all_modes": modes.complete,
                       "modes": modes.counts}
        return cls.filled(
            None, mechanism.units, format=cls.FORMAT, which=which, rows=len(table.status),
            status=status_counts(table.status), units=column_units(mechanism, names),
            rotation=form.rotation, **chosen, limits=_limits(mechanism), uncertainty=uncertainty,
            conditioning={"home": home, "singular": SINGULAR * home}, provenance=provenance)


def _limits(mechanism: Mechanism) -> dict[str, tuple[float | None, float | None]]:
    """Return both limits of each joint that has any, file units; None where there is none."""
    out = {}
    for name, ends, (factor, _) in zip(mechanism.actuators, mechanism.limits,
                                       mechanism.joint_units, strict=True):
        low, high = (float(v / factor) if np.isfinite(v) else None for v in ends)
        if low is not None or high is not None:
            out[name] = (low, high)
    return out


def kinematics_columns(mechanism: Mechanism, table: KinematicsTable, which: str, given: Given,
                       form: PoseFormat, modes: EveryMode | None, sigmas: Mapping[str, Array]
                       ) -> tuple[dict[str, Any], int]:
    """Return kinematics.csv, column by column, and how many rows are in gimbal lock.

    Args:
        mechanism: the machine.
        table: kinematics of N rows, SI.
        which: ``inverse``, ``forward`` or ``velocity``.
        given: names and values (N,) of the columns that were given, file units.
        form: tool point and convention of rotations.
        modes: which assembly mode each row is, where all of them are wanted.
        sigmas: columns of standard deviations.
    """
    header, columns = given
    own = dict(zip(header, columns, strict=True))
    pose, locked = form.columns(mechanism, table.pose if form.pose is None else form.pose,
                                own if which == "inverse" else None)
    added: dict[str, Any] = {} if modes is None else {
        "row": modes.row + 1, "mode": modes.mode, "own": modes.own.astype(int)}
    if which == "forward":
        added |= pose
    else:
        added |= joint_columns(mechanism, table.q, "q_{}")
        locked[:] = False
    if which == "inverse":
        own |= dict(zip(header, filled_columns(header, columns, pose), strict=True))
        added |= {k: v for k, v in pose.items() if k not in header}
    if which == "velocity":
        added |= joint_columns(mechanism, table.rate, "rate_{}")
    added |= {**sigmas, "condition": table.singular_value, "status": list(table.status), "reason": [
        LOCKED if lock and not r else r for r, lock in zip(table.reason, locked, strict=True)]}
    # what was computed stands in place of input columns of the same name
    return {**own, **added}, int(locked.sum())


def solved_sentence(solved: int, rows: int) -> str:
    """Return how many rows were solved."""
    return f"{solved} of {pluralize(rows, 'row')} solved"


def modes_sentence(counts: Sequence[int], method: str, complete: bool) -> str:
    """Return how many assembly modes the rows have, and whether that is all."""
    if not counts:
        return ""
    few, many = min(counts), max(counts)
    said = f"{many}" if few == many else f"{few} to {many}"
    more = "" if complete else "; there may be more"
    return f"Assembly modes in each row: {said} ({method}{more})."
