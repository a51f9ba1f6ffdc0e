"""What the instrument measured: position, rotation, height or distance, with its noise."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.csv import Table
from ppmcal.io.measurement_columns import rotations, stacked
from ppmcal.io.pose_fields import COORDINATES, QUATERNION
from ppmcal.io.sidecar import SidecarFile, actuator_noise, sigma_needs
from ppmcal.linalg import Array
from ppmcal.model.dataset import unknown
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.units import Units
from ppmcal.wording import row_list


@dataclass(frozen=True)
class Measured:
    """SI; position and rotation (N, 3), value (N,), and their standard deviations."""

    position: Array
    rotation: Array
    value: Array
    sigma_position: Array
    sigma_rotation: Array
    sigma_value: Array
    findings: tuple[Note, ...]


def measured(table: Table, mechanism: Mechanism, file: SidecarFile, side: str) -> Measured:
    """Return the measured columns that the sidecar's instrument needs.

    Raises:
        BadInput: a needed column is missing or wholly empty, or a sigma is not positive.
    """
    units, kind, n = file.units.units(), file.instrument.kind, len(table)
    if kind.scalar:
        return _scalar(table, file, side, units)
    if kind.blind:
        return _nothing(table, mechanism, file, side)
    if kind.of_turn is not None:
        return _tilts(table, mechanism, file, side)
    position, rotation, findings = _pose(table, mechanism, kind, units)
    turning = bool(np.isfinite(rotation).any())
    sigma_needs(file, side, turning)
    sigma = file.instrument.sigma
    return Measured(position, rotation, unknown(n),
                    _sigmas(table, "position", sigma.position, units.factor("length")),
                    _sigmas(table, "rotation", sigma.rotation, units.factor("angle")),
                    unknown(n), tuple(findings))


def _nothing(table: Table, mechanism: Mechanism, file: SidecarFile, side: str) -> Measured:
    """Return rows of joint values alone; what stands for the noise of positions is theirs."""
    kind, n, factors = file.instrument.kind, len(table), mechanism.joint_factors(file.units.units())
    kind.refuse(mechanism.motion, mechanism.surplus, side)
    joints = actuator_noise(file.instrument.sigma.actuator, mechanism, factors, side)
    gaps = mechanism.gap_sigma
    if not np.all(joints > 0.0) and not np.all(gaps > 0.0):
        raise BadInput("the noise of the joint values is missing: without an instrument it is all "
                       "that a row may be off by", f"{side}: instrument.sigma",
                       "Add how well readings at one place repeat, such as `actuator: 0.2`; with "
                       "`estimated: true` it is only where its estimate begins. Or say what all "
                       "limbs may gap, `closure: {sigma: 0.2}` in the mechanism file")
    blank = np.full((n, 3), np.nan)
    size = float(np.median(joints * mechanism.joint_ratios) or np.median(gaps))
    findings = _unused(table, kind, lambda c: _scalar_column(c, kind) or c in (
        *COORDINATES, *QUATERNION))
    return Measured(blank, blank, unknown(n), np.full((n, 3), size), blank, unknown(n),
                    tuple(findings))


def _tilts(table: Table, mechanism: Mechanism, file: SidecarFile, side: str) -> Measured:
    """Return angles of a body's rotation in the places of their coordinates."""
    kind, n, angle = file.instrument.kind, len(table), file.units.units().factor("angle")
    kind.refuse(mechanism.motion, mechanism.surplus, side, mechanism.gravity)
    sigma_needs(file, side, False)
    names = kind.columns(mechanism.motion)
    _need(table, names, f"instrument `{kind}`")
    rotation, nothing = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    sigma = np.full((n, 3), (file.instrument.sigma.rotation or np.nan) * angle)
    for name, c in zip(names, kind.coordinates(mechanism.motion), strict=True):
        rotation[:, c - 3] = table.numbers[name] * angle
        _override(sigma[:, c - 3], table, f"sigma_{name}", angle)
    findings = _unused(table, kind, lambda c: c not in names and (
        c in COORDINATES or c in QUATERNION or _scalar_column(c, kind)))
    return Measured(nothing, rotation, unknown(n), np.full((n, 3), np.nan), sigma, unknown(n),
                    tuple(findings))


def _sigmas(table: Table, what: str, shared: float | None, factor: float) -> Array:
    """Return standard deviations (N, 3): the sidecar's, or a row's own; one row in memory."""
    out = np.broadcast_to((shared or np.nan) * factor, (len(table), 3))
    for i, name in enumerate(COORDINATES[:3] if what == "position" else COORDINATES[3:]):
        for source in (f"sigma_{what}", f"sigma_{name}"):
            if source in table.numbers:
                out = out if out.flags.writeable else out.copy()
                _override(out[:, i], table, source, factor)
    return out


def _pose(table: Table, mechanism: Mechanism, kind: InstrumentKind, units: Units
          ) -> tuple[Array, Array, list[Note]]:
    """Return position (N, 3) and rotation (N, 3) as far as the instrument and motion go."""
    planar = mechanism.motion.planar
    needed = ("x", "y") if planar else ("x", "y", "z")
    _need(table, needed, f"instrument `{kind}`")
    position = stacked(table, COORDINATES[:3]) * units.factor("length")
    findings = _unused(table, kind, lambda c: _scalar_column(c, kind))
    turns = [c for c in table.header if c in COORDINATES[3:] or c in QUATERNION]
    nothing = np.full((len(table), 3), np.nan)
    if not kind.sees_rotation:
        rotation = nothing
        if turns:
            findings.append(Note(
                f"{table.source}: columns {', '.join(turns)}: not used, because the "
                "instrument's kind is `position`; write `kind: pose` to use them."))
    else:
        rotation = _rotation(table, mechanism, units)
    if planar:
        position[:, 2] = np.nan
        rotation = np.where([False, False, True], rotation, np.nan)
        unused = [c for c in table.header if c in ("z", "rx", "ry")]
        if unused:
            findings.append(Note(
                f"{table.source}: columns {', '.join(unused)}: not used, because a "
                "planar pose is x, y, rz."))
    return position, rotation, findings


def _rotation(table: Table, mechanism: Mechanism, units: Units) -> Array:
    """Return the measured rotation vectors (N, 3); needed unless motion is translational."""
    rotation, given = rotations(table, units.factor("angle"))
    if not mechanism.motion.turns:
        return rotation
    if not given:
        columns = "rz" if mechanism.motion.planar else "rx, ry, rz"
        raise BadInput(f"there is no column {columns}, which the instrument `pose` needs",
                       f"{table.source}: header",
                       f"Add {columns} (or quat_x, quat_y, quat_z, quat_w), or write `kind: "
                       "position` in the sidecar")
    if not any(c in table.header for c in QUATERNION):
        _need(table, ("rz",) if mechanism.motion.planar else COORDINATES[3:],
              "instrument `pose`")
    elif not np.isfinite(rotation).any():
        raise BadInput("all values of the column are missing", table.at("quat_x"),
                       "Fill it in, or write `kind: position` in the sidecar")
    return rotation


def _need(table: Table, names: tuple[str, ...], who: str) -> None:
    missing = [n for n in names if n not in table.header]
    if missing:
        raise BadInput(f"there is no column {', '.join(missing)}, which the {who} needs",
                       f"{table.source}: header", "Add it, or change `instrument.kind` in the "
                                                  "sidecar")
    for name in names:
        if not np.isfinite(table.numbers[name]).any():
            raise BadInput("all values of the column are missing", table.at(name),
                           f"Fill it in: the {who} needs it")


def _scalar(table: Table, file: SidecarFile, side: str, units: Units) -> Measured:
    """Return heights, distances or a joint's readings with their noise."""
    kind, sigma = file.instrument.kind, file.instrument.sigma
    name = kind.number
    sigma_needs(file, side, False)
    _need(table, (name,), f"instrument `{kind}`")
    n, factor = len(table), units.factor(kind.quantity)
    value = stacked(table, [name])[:, 0] * factor
    if kind.along_line and np.any(value <= 0.0):
        raise BadInput(f"a {name} must be greater than 0",
                       table.at(name, int(np.argmax(value <= 0.0))), "Check the value")
    sigma_value = np.full(n, (kind.sigma_stated(sigma) or np.nan) * factor)
    _override(sigma_value, table, f"sigma_{name}", factor)
    nothing = np.full((n, 3), np.nan)
    findings = _unused(table, kind, lambda c: (
        c in COORDINATES or c in QUATERNION or _scalar_column(c, kind)))
    return Measured(nothing, nothing.copy(), value,
                    np.repeat(sigma_value[:, None], 3, axis=1), nothing.copy(), sigma_value,
                    tuple(findings))


def _scalar_column(name: str, own: InstrumentKind) -> bool:
    """Whether a column belongs to an instrument for one number other than ``own``."""
    return (name in number_names() and name != own.number) or (
        name.startswith("to_q_") and not own.along_line)


def _unused(table: Table, kind: InstrumentKind, which: Callable[[str], bool]) -> list[Note]:
    """Return the finding that names the columns which the instrument cannot use."""
    unused = [c for c in table.header if which(c)]
    return [Note(f"{table.source}: columns {', '.join(unused)}: not used, because the instrument's "
                 f"kind is `{kind}`.")] if unused else []


def _override(into: Array, table: Table, name: str, factor: float) -> None:
    """Write a row's own standard deviations over the sidecar's, in place."""
    values = table.numbers.get(name)
    if values is None:
        return
    bad = np.flatnonzero(values <= 0.0)
    if bad.size:
        raise BadInput(f"a standard deviation must be greater than 0 ({row_list(bad)})",
                       table.at(name, int(bad[0])),
                       "Write a positive number, or leave it empty for the sidecar's")
    given = np.isfinite(values)
    into[given] = values[given] * factor
