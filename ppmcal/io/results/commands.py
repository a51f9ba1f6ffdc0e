"""commands.csv and commands.json, and what is said of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from ppmcal.calibration.compensation import Compensation
from ppmcal.io.results.record import (
    Column,
    Finite,
    Part,
    Provenance,
    Record,
    Text,
    Whole,
    table_text,
)
from ppmcal.io.results.tables import column_units, filled_columns, joint_columns, pose_columns
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted, number

ERRORS = (("error_position_before", "position_before"), ("error_position_after", "position_after"),
          ("error_rotation_before", "rotation_before"), ("error_rotation_after", "rotation_after"),
          ("sigma_position", "sigma_position"), ("sigma_rotation", "sigma_rotation"))
"""Columns of commands.csv and what they are of a compensation, m or rad."""


class TargetError(Part):
    """Rms over the commands of errors in ``unit``, with the model's own uncertainty in ``after``.

    ``before``: of uncorrected commands, the nominal machine's; ``sigma``: the model's own standard
    deviation; ``after``: what is left of corrected ones, never less; None: unknown.
    """

    before: Finite | None = None
    after: Finite | None = None
    sigma: Finite | None = None
    unit: Text = ""

    def words(self) -> str:
        """Return ``0.34 mm rms with uncorrected commands, 0.003 mm with these``."""
        if self.before is None:
            return ""
        left = "unknown" if self.after is None else f"{number(self.after)} {self.unit}"
        return (f"{number(self.before)} {self.unit} rms with uncorrected commands, {left} with "
                "these")


class CommandsRecord(Record):
    """commands.json: how many targets have no command, and the ``units`` of every column.

    ``predicted``: errors by kind, position and rotation; ``frame``: in which they are.
    """

    FILE: ClassVar[str] = "commands.json"
    FORMAT: ClassVar[str] = "ppmcal/commands/1"

    rows: Whole | None = None
    refused: Whole | None = None
    frame: Text = ""
    predicted: Mapping[Text, TargetError] = Field(default_factory=dict)
    notes: tuple[Text, ...] = ()
    units: Mapping[Text, Text] = Field(default_factory=dict)
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, mechanism: Mechanism, result: Compensation, names: Sequence[str],
           provenance: Mapping[str, Any], notes: Sequence[str], frame: str) -> CommandsRecord:
        """Return the record of commands whose columns are ``names``."""
        return cls(format=cls.FORMAT, rows=len(result.status), frame=frame or "base",
                   predicted=_predicted(mechanism, result),
                   refused=sum(s != "ok" for s in result.status), notes=tuple(notes),
                   units=column_units(mechanism, names),
                   provenance=Provenance.model_validate(provenance))

    def summary(self) -> dict[str, Any]:
        """Return the content without the units."""
        return {k: v for k, v in self.entries().items() if k != "units"}


def _predicted(mechanism: Mechanism, result: Compensation) -> dict[str, TargetError]:
    """Return the errors of the commands in file units; what was refused has none."""
    out = {}
    good = np.isfinite(result.q).all(axis=1)
    kinds = ("position",) if mechanism.motion == "translational" else ("position", "rotation")
    for kind in kinds:
        quantity = "length" if kind == "position" else "angle"
        before, left, sigma = (getattr(result, name) for name in (
            f"{kind}_before", f"{kind}_after", f"sigma_{kind}"))
        rows = good & np.isfinite(before)
        if rows.any():
            sizes = [_rms(v[rows] / mechanism.units.factor(quantity)) for v in (
                before, np.hypot(np.nan_to_num(left), sigma), sigma)]
            out[kind] = TargetError(before=sizes[0], after=sizes[1], sigma=sizes[2],
                                       unit=mechanism.units.name(quantity))
    return out


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if np.isfinite(values).all() else None


def command_columns(mechanism: Mechanism, result: Compensation, header: Sequence[str],
                    columns: Sequence[Any]) -> list[Column]:
    """Return the columns of commands.csv: those of the targets, then the commands.

    Joints, poses and the targets' columns are in file units already, errors are SI.
    """
    added = [Column(n, v) for part in (joint_columns(mechanism, result.q, "q_{}"),
                                       joint_columns(mechanism, result.q_nominal, "q_{}_nominal"),
                                       pose_columns(mechanism, result.command, "cmd_"))
             for n, v in part.items()]
    for name, field in ERRORS:
        quantity = "length" if "position" in name else "angle"
        added.append(Column(name, getattr(result, field), quantity))
    added += [Column("status", list(result.status)), Column("reason", list(result.reason))]
    ours = {c.name for c in added}
    filled = filled_columns(header, columns, pose_columns(mechanism, result.seen))
    return [*(Column(n, c) for n, c in zip(header, filled, strict=True) if n not in ours), *added]


def command_files(mechanism: Mechanism, result: Compensation, header: Sequence[str],
                  columns: Sequence[Any], provenance: Mapping[str, Any], notes: Sequence[str],
                  frame: str = "") -> tuple[dict[str, str], CommandsRecord]:
    """Return commands.csv and commands.json, and the record in the latter."""
    found = command_columns(mechanism, result, header, columns)
    record = CommandsRecord.of(mechanism, result, [c.name for c in found], provenance, notes,
                               frame)
    return {"commands.csv": table_text(found, mechanism.units), record.FILE: record.text()}, record


def accepted_sentence(accepted: int, targets: int) -> str:
    """Return how many targets have commands."""
    return f"{accepted} of {counted(targets, 'target')} can be commanded"
