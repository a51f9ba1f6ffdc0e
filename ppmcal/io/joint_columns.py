"""The joint columns of a measurement file, SI: ``q_``, ``to_q_``, or commanded poses ``cmd_``."""

from __future__ import annotations

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.io import measurement_columns as cols
from ppmcal.io.csv import Table
from ppmcal.io.measurement_columns import stacked
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units


def joint_values(table: Table, mechanism: Mechanism, units: Units, joint: Array
            ) -> tuple[Array, Array | None]:
    """Return q (N, k) and commanded poses (N, 6) or None; refuse a file without either."""
    names = [f"q_{a}" for a in mechanism.actuators]
    have = [n for n in names if n in table.header]
    commands = [c for c in table.header if c.startswith("cmd_")]
    if not commands and len(have) < len(names):
        missing = [n for n in names if n not in have]
        raise BadInput(f"there is no column {', '.join(missing)}", f"{table.source}: header",
                       "Give the joint values of all actuators, or commanded poses (cmd_x, ...)")
    for name in have:
        _not_empty(table, name)
    q = stacked(table, names) * joint
    if not commands:
        return q, None
    if len(have) == len(names):
        raise BadInput("there are joint columns (q_...) and commanded poses (cmd_...)",
                       f"{table.source}: header", "Keep the columns that the controller used: "
                       f"remove {', '.join(commands)}, or the q_ columns")
    if have and len(have) < len(names):
        raise BadInput(f"the columns {', '.join(n for n in names if n not in have)} are missing",
                       f"{table.source}: header", "Give all joint columns, or only cmd_ columns")
    commanded = cols.poses(table, mechanism, units, "cmd_")
    given = [mechanism.coordinates[i] for i, d in enumerate(mechanism.dof)
             if np.isfinite(commanded[:, d]).any()]
    if len(given) < len(mechanism.actuators):
        lacking = [f"cmd_{c}" for c in mechanism.coordinates if c not in given]
        raise BadInput(f"the commanded pose lacks {', '.join(lacking)}", f"{table.source}: header",
                       f"A pose of this machine needs {len(mechanism.actuators)} of "
                       f"{', '.join('cmd_' + c for c in mechanism.coordinates)}")
    return q, commanded


def _not_empty(table: Table, name: str) -> None:
    if not np.isfinite(table.numbers[name]).any():
        raise BadInput("all values of the column are missing", table.at(name),
                       "Fill it in, or remove the column")


def second_joints(table: Table, mechanism: Mechanism, joint: Array, kind: str) -> Array | None:
    """Return the joint values (N, k) at the other end of a distance, None where there is none."""
    names = [f"to_q_{a}" for a in mechanism.actuators]
    have = [n for n in names if n in table.header]
    if not have or kind != "distance":
        return None
    if len(have) < len(names):
        raise BadInput(f"the columns {', '.join(n for n in names if n not in have)} are missing",
                       f"{table.source}: header",
                       "Give the second position's joint values of all actuators")
    for name in have:
        _not_empty(table, name)
    return stacked(table, names) * joint
