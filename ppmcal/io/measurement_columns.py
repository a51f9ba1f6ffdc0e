"""What measurement files hold, in SI: joints, poses, conditions, and what the instrument saw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io.column_names import ENVIRONMENT, MissingColumns, tension_columns
from ppmcal.io.csv import Table, refuse_absurd
from ppmcal.io.noise_limits import correlated_noise
from ppmcal.io.pose_fields import (
    COORDINATES,
    CORRELATIONS,
    NORM_TOLERANCE,
    QUATERNION,
    factors,
    rotation_vectors,
)
from ppmcal.io.sidecar import SidecarFile, sigma_needs, station_of
from ppmcal.io.sidecar_values import actuator_noise
from ppmcal.linalg import Array
from ppmcal.model.dataset import ZERO_CELSIUS, tracker_noise, unknown
from ppmcal.model.instruments import InstrumentKind, number_names
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.units import Units
from ppmcal.wording import row_list

PLACES = (*COORDINATES, *QUATERNION)
"""Columns of where something is."""
NOT_MOVED = 1e-12
K95 = 1.96
"""Coverage factor of the 95 % uncertainties that trackers list (normal)."""


def stacked(table: Table, names: Sequence[str]) -> Array:
    """Return columns side by side (N, len(names)), nan where the file has none."""
    out = np.full((len(table), len(names)), np.nan)
    for i, name in enumerate(names):
        if name in table.numbers:
            out[:, i] = table.numbers[name]
    return out


def poses(table: Table, mechanism: Mechanism, units: Units, prefix: str = "") -> Array:
    """Return poses (N, 6) in SI: nan where left empty, 0 where the machine cannot move.

    Raises:
        BadInput: a coordinate that the machine does not have, other than 0.
    """
    out = stacked(table, [f"{prefix}{c}" for c in COORDINATES]) * factors(units)
    out[:, 3:] = rotations(table, units.factor("angle"), prefix)[0]
    for i, name in enumerate(COORDINATES):
        if i in mechanism.dof:
            continue
        own = prefix + (name if f"{prefix}{name}" in table.header else QUATERNION[i - 3])
        table.refuse_rows(np.abs(np.nan_to_num(out[:, i])) > NOT_MOVED, own,
                          f"a {mechanism.motion} machine has no coordinate {name}",
                          "Remove the column; a pose here is "
                          f"{', '.join(prefix + c for c in mechanism.coordinates)}", listed=True)
        out[:, i] = 0.0
    return out


def rotations(table: Table, angle: float, prefix: str = "") -> tuple[Array, bool]:
    """Return rotation vectors (N, 3), rad, nan where not given; and whether any column is.

    Quaternions must have length 1 within 1e-3 and are normalised.

    Raises:
        BadInput: rotation given twice, an incomplete quaternion, or rows off the norm.
    """
    vector = [f"{prefix}{c}" for c in COORDINATES[3:] if f"{prefix}{c}" in table.header]
    quaternion = [f"{prefix}{c}" for c in QUATERNION if f"{prefix}{c}" in table.header]
    if vector and quaternion:
        raise BadInput(f"the rotation is given twice, as {vector[0]} and as {quaternion[0]}",
                       f"{table.source}: header", "Remove one of the two")
    if not quaternion:
        return stacked(table, [f"{prefix}{c}" for c in COORDINATES[3:]]) * angle, bool(vector)
    if len(quaternion) < 4:
        raise BadInput(f"the quaternion has only {', '.join(quaternion)}",
                       f"{table.source}: header", "Give the four columns "
                       f"{', '.join(prefix + c for c in QUATERNION)}")
    q = stacked(table, quaternion)
    norm = np.sqrt(np.sum(q * q, axis=1))
    bad = np.flatnonzero(np.abs(norm - 1.0) > NORM_TOLERANCE)
    if bad.size:
        raise BadInput(f"the quaternion does not have length 1 in {row_list(bad)} "
                       f"(row {bad[0] + 1}: {norm[bad[0]]:.6g})",
                       table.at(quaternion[0], int(bad[0])),
                       "Check the order x, y, z, w and the digits")
    return rotation_vectors(q / norm[:, None]), True


def joint_values(table: Table, mechanism: Mechanism, units: Units, joint: Array
            ) -> tuple[Array, Array | None]:
    """Return q (N, k) and commanded poses (N, 6) or None; refuse a file without either."""
    names = [f"q_{a}" for a in mechanism.actuators]
    commands, place = [c for c in table.header if c.startswith("cmd_")], f"{table.source}: header"
    missing = [n for n in names if n not in table.header]
    if missing and not commands:
        raise MissingColumns.of(missing, "", place, "Give the joint values of all actuators, or "
                                "commanded poses (cmd_x, ...)")
    _refuse_empty(table, [n for n in names if n not in missing],
                  "Fill it in, or remove the column")
    q = stacked(table, names) * joint
    if not commands:
        return q, None
    if not missing:
        raise BadInput("there are joint columns (q_...) and commanded poses (cmd_...)", place,
                       "Keep the columns that the controller used: "
                       f"remove {', '.join(commands)}, or the q_ columns")
    if len(missing) < len(names):
        raise BadInput(f"the columns {', '.join(missing)} are missing", place,
                       "Give all joint columns, or only cmd_ columns")
    commanded = poses(table, mechanism, units, "cmd_")
    given = [mechanism.coordinates[i] for i, d in enumerate(mechanism.dof)
             if np.isfinite(commanded[:, d]).any()]
    if len(given) < mechanism.freedoms:
        lacking = [f"cmd_{c}" for c in mechanism.coordinates if c not in given]
        raise BadInput(f"the commanded pose lacks {', '.join(lacking)}", place,
                       f"A pose of this machine needs {mechanism.freedoms} of "
                       f"{', '.join('cmd_' + c for c in mechanism.coordinates)}")
    return q, commanded


def _refuse_empty(table: Table, names: Sequence[str], hint: str) -> None:
    """Refuse a column without any number."""
    for name in names:
        if not np.isfinite(table.numbers[name]).any():
            raise BadInput("all values of the column are missing", table.at(name), hint)


def second_joints(table: Table, mechanism: Mechanism, joint: Array, kind: InstrumentKind
                  ) -> Array | None:
    """Return the joint values (N, k) at the other end of a distance, None where there is none."""
    names = [f"to_q_{a}" for a in mechanism.actuators]
    have = [n for n in names if n in table.header]
    if not have or not kind.along_line:
        return None
    if len(have) < len(names):
        raise BadInput(f"the columns {', '.join(n for n in names if n not in have)} are missing",
                       f"{table.source}: header",
                       "Give the second position's joint values of all actuators")
    _refuse_empty(table, have, "Fill it in, or remove the column")
    return stacked(table, names) * joint


def further_columns(table: Table, mechanism: Mechanism, joint: Array) -> dict[str, Array]:
    """Return the columns of the environment in SI: directions, velocities, temperature (K) ..."""
    factor = {f"vel_{a}": joint[i] for i, a in enumerate(mechanism.actuators)}
    factor |= dict.fromkeys(tension_columns(mechanism), 1.0)
    directions = {f"dir_{a}" for a in (*mechanism.actuators, "x", "y", "z")}
    out: dict[str, Array] = {}
    for name in table.header:
        warm = name == "temperature" or name.startswith("temperature_")
        mine = warm or name in directions or name in factor or name in ENVIRONMENT
        if not mine or name not in table.numbers:
            continue
        values = table.numbers[name]
        refuse_absurd({name: values}, table.source)
        if name in directions:
            bad = np.flatnonzero(np.isfinite(values) & (np.abs(values) != 1.0))
            if bad.size:
                raise BadInput(f"{values[bad[0]]:g} is not a direction of approach",
                               table.at(name, int(bad[0])), "Write 1, -1, or leave it empty")
        if name == "payload":
            table.refuse_rows(values < 0.0, name, "a payload cannot be negative",
                              "Write kg, 0 or more")
        out[name] = values + ZERO_CELSIUS if warm else values * factor.get(name, 1.0)
    return out


# ---- what the instrument saw


Measured = tuple[dict[str, Any], list[Note]]
"""Fields of a data set by name, SI: position, rotation, value, what sigmas they have and perhaps
their covariance; and findings."""


def _measured(n: int, findings: list[Note], **known: Array) -> Measured:
    """Return what was measured in N rows, nan where that is not among ``known``."""
    nothing = {"position": unknown(n, 3), "rotation": unknown(n, 3), "value": unknown(n)}
    return {**nothing, **{f"sigma_{name}": blank for name, blank in nothing.items()},
            **known}, findings


def measured(table: Table, mechanism: Mechanism, file: SidecarFile, side: str) -> Measured:
    """Return the measured columns that the sidecar's instrument needs.

    Raises:
        BadInput: a needed column is missing or wholly empty, or a sigma is not positive.
    """
    units, kind = file.units.units(), file.instrument.kind
    if kind.scalar:
        return _scalar(table, file, side, units)
    if kind.blind:
        return _nothing(table, mechanism, file, side)
    if kind.of_turn is not None:
        return _tilts(table, mechanism, file, side)
    position, rotation, findings = _pose(table, mechanism, kind, units)
    sigma_needs(file, side, bool(np.isfinite(rotation).any()))
    sigma, length = file.instrument.sigma, units.factor("length")
    own = _sigmas(table, "position", sigma.position, length)
    turns = _sigmas(table, "rotation", sigma.rotation, units.factor("angle"))
    seen = {"position": position, "rotation": rotation, "sigma_position": own,
            "sigma_rotation": turns}
    told = [name for name in CORRELATIONS if name in table.numbers]
    if told:
        _refuse_correlations(file, side, told[0])
        both = np.concatenate([own, turns], axis=1)
        seen["covariance"] = correlated_noise(table, told, both if kind.sees_rotation else own)
    if told or sigma.range is None:
        return _measured(len(table), findings, **seen)
    station = station_of(file.instrument, mechanism.motion, units, side)
    root = tracker_noise(np.nan_to_num(position), station, sigma.range * length,
                         (sigma.angle or 0.0) * units.factor("angle"))
    found = root @ root
    # coordinates with a standard deviation of their own keep it
    total = np.where(np.isfinite(own), own, np.sqrt(np.diagonal(found, axis1=1, axis2=2)))
    alone = np.isfinite(own)[:, :, None] | np.isfinite(own)[:, None, :]
    found = np.where(alone, total[:, :, None] ** 2 * np.eye(3), found)
    return _measured(len(table), findings, **seen | {"sigma_position": total, "covariance": found})


def _refuse_correlations(file: SidecarFile, side: str, column: str) -> None:
    """Refuse correlations beside noise that is not of x ... rz as they stand in the columns."""
    for place, other in (("instrument.sigma.range", file.instrument.sigma.range is not None),
                         ("read", bool(file.read.mirror) or file.read.pose == "inverse")):
        if other:
            raise BadInput("the noise is not that of x ... rz as they were measured, whose "
                           "correlations stand in columns", f"{side}: {place}",
                           f"Take it out, or the column {column}")


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
    size = float(np.median(joints * mechanism.joint_ratios) or np.median(gaps))
    return _measured(n, _unused(table, kind, lambda c: c in PLACES), sigma_position=np.full(
        (n, 3), size))


def _tilts(table: Table, mechanism: Mechanism, file: SidecarFile, side: str) -> Measured:
    """Return angles of a body's rotation in the places of their coordinates."""
    kind, n, angle = file.instrument.kind, len(table), file.units.units().factor("angle")
    kind.refuse(mechanism.motion, mechanism.surplus, side, mechanism.gravity)
    sigma_needs(file, side, False)
    names = kind.columns(mechanism.motion)
    _need(table, names, f"instrument `{kind}`")
    rotation = np.full((n, 3), np.nan)
    sigma = np.full((n, 3), (file.instrument.sigma.rotation or np.nan) * angle)
    for name, c in zip(names, kind.coordinates(mechanism.motion), strict=True):
        rotation[:, c - 3] = table.numbers[name] * angle
        _override(sigma[:, c - 3], table, f"sigma_{name}", angle)
    return _measured(n, _unused(table, kind, lambda c: c in PLACES and c not in names),
                     rotation=rotation, sigma_rotation=sigma)


def _sigmas(table: Table, what: str, shared: float | None, factor: float) -> Array:
    """Return standard deviations (N, 3): the sidecar's, or a row's own; else one row in memory."""
    out = np.broadcast_to((shared or np.nan) * factor, (len(table), 3))
    for i, name in enumerate(COORDINATES[:3] if what == "position" else COORDINATES[3:]):
        for source, k in ((f"u95_{what}", K95), (f"u95_{name}", K95), (f"sigma_{what}", 1.0),
                          (f"sigma_{name}", 1.0)):
            if source in table.numbers:
                out = out if out.flags.writeable else out.copy()
                _override(out[:, i], table, source, factor / k)
    return out


def _pose(table: Table, mechanism: Mechanism, kind: InstrumentKind, units: Units
          ) -> tuple[Array, Array, list[Note]]:
    """Return position (N, 3) and rotation (N, 3) as far as the instrument and motion go."""
    planar = mechanism.motion.planar
    needed = ("x", "y") if planar else ("x", "y", "z")
    _need(table, needed, f"instrument `{kind}`")
    position = stacked(table, COORDINATES[:3]) * units.factor("length")
    findings = _unused(table, kind)
    turns = [c for c in table.header if c in COORDINATES[3:] or c in QUATERNION]
    if not kind.sees_rotation:
        rotation = unknown(len(table), 3)
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
        raise MissingColumns.of(missing, f", which the {who} needs", f"{table.source}: header",
                                "Add it, or change `instrument.kind` in the sidecar")
    _refuse_empty(table, names, f"Fill it in: the {who} needs it")


def _scalar(table: Table, file: SidecarFile, side: str, units: Units) -> Measured:
    """Return heights, distances or a joint's readings with their noise."""
    kind, sigma = file.instrument.kind, file.instrument.sigma
    name = kind.number
    sigma_needs(file, side, False)
    _need(table, (name,), f"instrument `{kind}`")
    n, factor = len(table), units.factor(kind.quantity)
    value = stacked(table, [name])[:, 0] * factor
    table.refuse_rows(kind.along_line & (value <= 0.0), name, f"a {name} must be greater than 0",
                      "Check the value")
    sigma_value = np.full(n, (kind.sigma_stated(sigma) or np.nan) * factor)
    _override(sigma_value, table, f"sigma_{name}", factor)
    return _measured(n, _unused(table, kind, lambda c: c in PLACES), value=value,
                     sigma_position=np.repeat(sigma_value[:, None], 3, axis=1),
                     sigma_value=sigma_value)


def _scalar_column(name: str, own: InstrumentKind) -> bool:
    """Whether a column belongs to an instrument for one number other than ``own``."""
    return (name in number_names() and name != own.number) or (
        name.startswith("to_q_") and not own.along_line)


def _unused(table: Table, kind: InstrumentKind,
            which: Callable[[str], bool] = lambda c: False) -> list[Note]:
    """Return the finding that names the columns which the instrument cannot use."""
    unused = [c for c in table.header if which(c) or _scalar_column(c, kind)]
    return [Note(f"{table.source}: columns {', '.join(unused)}: not used, because the instrument's "
                 f"kind is `{kind}`.")] if unused else []


def _override(into: Array, table: Table, name: str, factor: float) -> None:
    """Write a row's own standard deviations over the sidecar's, in place."""
    values = table.numbers.get(name)
    if values is None:
        return
    table.refuse_rows(values <= 0.0, name, "a standard deviation must be greater than 0",
                      "Write a positive number, or leave it empty for the sidecar's", listed=True)
    given = np.isfinite(values)
    into[given] = values[given] * factor
