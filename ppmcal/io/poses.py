"""Pose, target and joint files: CSV without a sidecar, in the mechanism file's units.

A column whose header names another unit (``x [m]``) is converted.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ppmcal.errors import BadInput, unknown
from ppmcal.io import measurement_columns as cols
from ppmcal.io.column_names import ENVIRONMENT, known_columns
from ppmcal.io.csv import Table, remark_table
from ppmcal.io.header import bare_name
from ppmcal.io.measurement_columns import further_columns, stacked
from ppmcal.io.pose_fields import COORDINATES, EULER, QUATERNION, under_vector_names
from ppmcal.io.reading import in_own_units
from ppmcal.io.schema import did_you_mean
from ppmcal.io.tables import Tabular, as_table, is_path, read_table
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


Given = tuple[tuple[str, ...], tuple[Any, ...]]
"""Header and columns of a table as they stand: (N,) numbers, or a tuple of words."""


class PoseTable(NamedTuple):
    """Poses of a CSV.

    Attributes:
        poses: (N, 6) x, y, z, rx, ry, rz in SI; nan where left empty (to be solved for), 0
            for coordinates that the machine does not have.
        extra: all other columns as the file has them: (N,) numbers, or a tuple of words.
        environment: those of the other columns that effects may depend on, in SI.
        given: header and columns as they stand, to be repeated in outputs.
    """

    poses: Array
    extra: Mapping[str, Any]
    environment: Mapping[str, Array]
    given: Given


class JointTable(NamedTuple):
    """Joint values of a CSV: ``q`` (N, k) in SI, nan where empty; the rest as PoseTable."""

    q: Array
    environment: Mapping[str, Array]
    given: Given


@stage("reading the table")
def read_poses(source: Tabular, mechanism: Mechanism, rotation: str = "rotvec",
               assume: Mapping[str, float] | None = None) -> PoseTable:
    """Return the poses of a table: ``x, y, rz``, ``x, y, z``, with rx, ry, rz or a quaternion.

    ``source`` is the path of a CSV, a data frame, a mapping of columns, or an array (N, d) of
    the machine's coordinates; all in the mechanism file's units.

    ``rotation`` is one of :data:`rotations.CONVENTIONS`; Euler angles stand in the places of
    the rotation vector, rad. ``assume``: further columns that are one number throughout, in the
    units of such a column of the table.

    Coordinates of the machine may be left empty or out (nan): as many must be given as there
    are actuators, row by row; that is the solver's to refuse.

    Raises:
        BadInput: no pose column at all, a coordinate that the machine does not have, a condition
            that is assumed but there, or that nothing depends on, or any fault of the CSV.
    """
    def loose(name: str) -> bool:
        return _may_be_text(name) and not (name in EULER and rotation.startswith("euler"))

    table = _table(source, mechanism, mechanism.coordinates, "poses", loose)
    remark_table(table)
    table = _with_assumed(table, mechanism, assume or {})
    given = _as_given(table)
    if mechanism.motion.turns_freely:
        table = under_vector_names(table, rotation)
    mine = (*mechanism.coordinates,
            *(QUATERNION if mechanism.motion.turns_freely else ()))
    own = [c for c in table.header if c in mine]
    if not own:
        raise BadInput("there is no pose column", f"{table.source}: header",
                       f"Name the columns {', '.join(mechanism.coordinates)}; found "
                       f"{', '.join(table.header[:8])}")
    poses = cols.poses(table, mechanism, mechanism.units)
    _enough_columns(table, own, mechanism)
    extra = {c: cells for c, cells in zip(*_as_given(table), strict=True) if c not in own}
    return PoseTable(poses, extra, _conditions(table, mechanism), given)


def _with_assumed(table: Table, mechanism: Mechanism, assume: Mapping[str, float]) -> Table:
    """Return the table with further columns of one number each."""
    known = [c for c in known_columns(mechanism) if c in (
        *ENVIRONMENT, *(f"{w}_{a}" for w in ("dir", "vel", "tension")
                        for a in mechanism.actuators))]
    for name, value in assume.items():
        if name in table.header:
            raise BadInput(f"the column {name} is there already", f"{table.source}: header",
                           f"Leave out --assume {name}={value:g}, or the column")
        if name not in known:
            raise unknown("condition", name, known, "--assume")
        table = table.put({name: np.full(len(table), value)})
    return table


def _enough_columns(table: Table, own: list[str], mechanism: Mechanism) -> None:
    """Refuse a table that lacks coordinates which no row can then have."""
    turned = any(c in QUATERNION for c in own)
    lacking = [c for c in mechanism.coordinates
               if c not in own and not (turned and c.startswith("r"))]
    open_ = mechanism.dependent
    if len(lacking) > open_:
        strangers = [c for c in table.header if c not in own]
        near = [c for c in strangers if did_you_mean(c, lacking)]
        raise BadInput(f"there is no column {', '.join(lacking)}", f"{table.source}: header",
                       f"A pose of this machine is {', '.join(mechanism.coordinates)}."
                       + (f" Is '{near[0]}' meant for one of them?" if near else ""))


@stage("reading the table")
def read_joints(source: Tabular, mechanism: Mechanism) -> JointTable:
    """Return the joint values of a table with a column ``q_<actuator>`` for each actuator.

    ``source`` as in :func:`read_poses`; an array is (N, k), one column per actuator.

    Raises:
        BadInput: a joint column is missing, or any fault of the CSV.
    """
    names = [f"q_{a}" for a in mechanism.actuators]
    table = _table(source, mechanism, names, "joints", _may_be_text)
    missing = [n for n in names if n not in table.header]
    if missing:
        raise BadInput(f"there is no column {', '.join(missing)}", f"{table.source}: header",
                       f"Give one column for each actuator: {', '.join(names)}."
                       f"{did_you_mean(missing[0], [h for h in table.header if h not in names])}")
    q = stacked(table, names) * mechanism.joint_factors()
    return JointTable(q, _conditions(table, mechanism), _as_given(table))


def _table(source: Tabular, mechanism: Mechanism, names: Sequence[str], what: str,
           loose: Callable[[str], bool]) -> Table:
    """Return a table in the mechanism file's units, whatever unit its header names."""
    def may_be_text(header: str) -> bool:
        return loose(header) and loose(bare_name(header))

    known = {*known_columns(mechanism), *TWIST, *EULER}
    table = (read_table(source, loose=may_be_text) if is_path(source)
             else as_table(source, names, what, may_be_text))
    return in_own_units(table, mechanism,
                        lambda name: name in known or name.startswith("temperature_"))


def _conditions(table: Table, mechanism: Mechanism) -> dict[str, Array]:
    """Return the columns that effects may depend on, SI."""
    return further_columns(table, mechanism, mechanism.joint_factors())


def twists(extra: Mapping[str, Any], mechanism: Mechanism) -> Array | None:
    """Return the twist columns vx, vy, vz, wx, wy, wz as (N, 6) in m/s and rad/s.

    Missing ones are 0, empty cells nan; None where a table has none of them.
    """
    have = [c for c in TWIST if c in extra]
    if not have:
        return None
    out = np.zeros((len(extra[have[0]]), 6))
    for i, name in enumerate(TWIST):
        if name in extra:
            factor = mechanism.units.factor("length" if i < 3 else "angle")
            out[:, i] = np.asarray(extra[name], dtype=float) * factor
    return out


def _as_given(table: Table) -> Given:
    return table.header, tuple(table.numbers.get(h, table.text.get(h)) for h in table.header)


def _may_be_text(name: str) -> bool:
    """Whether a column may hold words: anything that is not a pose, joint or velocity."""
    return not (name in COORDINATES or name in QUATERNION or name in TWIST
                or name.startswith("q_"))
