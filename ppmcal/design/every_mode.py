"""Forward kinematics with all assembly modes of each row of joint values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.design.assembly_modes import Modes, assembly_modes, judged
from ppmcal.design.assembly_modes_spatial import FoundModes
from ppmcal.design.intersection import intersections, require_meet
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import KinematicsTable, home_singular_value
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

OTHER = "other mode"
"""Status of a pose that is not the machine's own assembly mode."""


@dataclass(frozen=True, eq=False)
class EveryMode:
    """All poses of N rows of joint values, M in all.

    Attributes:
        table: of the M poses; a row without any has one line without a pose.
        row: the row of joint values that each belongs to, from 0 (M,).
        mode: its number in its row, from 1, home's mode first (M,); 0 where there is no pose.
        own: whether it is home's assembly mode (M,).
        method: by which they were found; complete: whether there can be no others in any row.
        home: of the N rows, home's assembly mode.
    """

    table: KinematicsTable
    row: Ints
    mode: Ints
    own: Bools
    method: str
    complete: bool
    home: KinematicsTable

    @property
    def counts(self) -> tuple[int, ...]:
        """How many modes each of the N rows has."""
        return tuple(int((self.mode[self.row == n] > 0).sum()) for n in np.unique(self.row))


def require_rigid(mechanism: Mechanism) -> None:
    """Refuse a machine with effects.

    Raises:
        BadInput: it has effects.
    """
    if mechanism.effects:
        kinds = ", ".join(dict.fromkeys(e.kind.name for e in mechanism.effects))
        raise BadInput(f"assembly modes are those of the geometry alone, and the file has effects "
                       f"({kinds})", f"{mechanism.source} with --all",
                       "Leave --all out, or take the effects out of the file")


def every_mode(model: Model, own: KinematicsTable, method: str, seed: int = 0
               ) -> EveryMode:
    """Return all assembly modes of the rows of a table of forward kinematics.

    Args:
        model: the machine at its parameters.
        own: what forward kinematics found in home's mode, N rows.
        method: ``newton``: as :func:`assembly_modes`, or ``intersection``.
        seed: of a search, where there is no closed form.

    Raises:
        BadInput: the machine has effects, or no intersection where one is asked for.
    """
    require_rigid(model.mechanism)
    if method == "intersection":
        require_meet(model.mechanism)
    parts, methods, complete = [], dict[str, None](), True
    with stage("assembly modes", len(own.q), "rows") as work:
        for n, q in enumerate(own.q):
            try:
                modes = _modes(model, q, method, seed)
            except NoResult as refused:
                parts.append(_row_without(own, n, own.reason[n] or refused.what))
            else:
                methods[modes.method] = None
                complete &= modes.complete
                parts.append(_row(model.mechanism, own, n, modes) if len(modes) else
                             _row_without(own, n, "no pose closes at these joint values"))
            work.done()
    tables = [t for t, _ in parts]
    return EveryMode(
        _together(tables) if tables else own,
        np.repeat(np.arange(len(parts)), [len(t.status) for t in tables]),
        np.array([m for t in tables for m in _numbers(t)], dtype=np.int64),
        np.concatenate([o for _, o in parts]) if parts else np.zeros(0, dtype=bool),
        ", ".join(methods), complete, own)


def _together(tables: Sequence[KinematicsTable]) -> KinematicsTable:
    """Return the rows of several tables."""
    return KinematicsTable(
        np.concatenate([t.q for t in tables]), np.concatenate([t.pose for t in tables]),
        np.concatenate([t.rate for t in tables]),
        np.concatenate([t.singular_value for t in tables]),
        tuple(s for t in tables for s in t.status), tuple(r for t in tables for r in t.reason))


def _modes(model: Model, q: Array, method: str, seed: int) -> Modes:
    if method != "intersection" or not finite_rows(q[None]).all():
        return assembly_modes(model, q, seed)
    closure = model.closure(q)
    motors = intersections(closure)
    return judged(model, closure, FoundModes(motors, np.ones(len(motors), dtype=bool)), method)


def _numbers(table: KinematicsTable) -> list[int]:
    """Return the modes' numbers; 0 for the line of a row without a pose."""
    if not finite_rows(table.pose).any():
        return [0]
    return list(range(1, len(table.status) + 1))


def _row(mechanism: Mechanism, own: KinematicsTable, n: int, modes: Modes
         ) -> tuple[KinematicsTable, Bools]:
    """Return the modes of one row; home's keeps the status that it has on its path."""
    mine = np.arange(len(modes)) == (-1 if modes.home is None else modes.home)
    side = home_singular_value(mechanism)[1]
    status = [own.status[n] if m else OTHER for m in mine]
    reason = [own.reason[n] if m else "singular" if flat else
              f"on {'the same side as home' if sign == side else 'the other side of a singularity'}"
              for m, flat, sign in zip(mine, modes.singular, modes.sign, strict=True)]
    count = len(modes)
    return KinematicsTable(
        np.tile(own.q[n], (count, 1)), pose_vector(modes.motors), np.tile(own.rate[n], (count, 1)),
        modes.singular_value, tuple(status), tuple(reason)), mine


def _row_without(own: KinematicsTable, n: int, reason: str) -> tuple[KinematicsTable, Bools]:
    """Return one line for a row that has no pose."""
    nil = np.full((1, 6), np.nan)
    return KinematicsTable(own.q[n:n + 1], nil, own.rate[n:n + 1], np.array([np.nan]),
                           ("not converged",), (reason,)), np.zeros(1, dtype=bool)
