"""Candidates for other readings of a file.

Joint columns. About the middle of the measured motion the positions follow the columns as
dp = B dq. If joint i stands in another column, with another sign or unit, the columns of B are
those of the machine's own Jacobian J in another order, with that sign and factor; rotating the
measuring frame, or mirroring or exchanging axes, does not change B^T B. So the orders and signs
that bring the correlations B^T B closest to J^T J are the ones to try: all of them are compared
at once (at most 720 orders of 32 signs), before anything is registered or solved. Measured
rotations follow the columns in the same way, wherever the target is.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, islice, permutations, product
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.calibration.interpretation.readings import ColumnInterpretation, ReadColumns
from ppmcal.errors import LinearAlgebraError
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.pose_readings import AXES
from ppmcal.kinematics.rotations import ORDERS
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import ANGLES, LENGTHS, TURN

MOST_JOINTS = 6
"""With more joints than this, only single changes are compared and not all orders."""
KEPT = 40
"""Orders and signs kept, best first, by positions and by rotations together."""
FEW = 12
NEAR = 1.6
"""A column may be in a unit if it moves the point by that unit's factor to within this."""
TURNED = {**ANGLES, "turn": TURN}
ONE_SIGN, ALL_SIGNS = ((-1, 1, 1), (1, -1, 1), (1, 1, -1)), (-1, -1, -1)


def joint_readings(mechanism: Mechanism, data: Dataset, single: bool = True) -> list[ReadColumns]:
    """Return the candidate readings of the joint columns, as declared first.

    Those suggested by the slopes of positions by the columns; with ``single`` also each single
    change (two columns exchanged, a sign, a unit), else only the most likely few.
    """
    plain = ColumnInterpretation.as_declared(mechanism, data).joints
    found = [plain]
    if data.commanded is None:
        found += [*(_single(plain, other_units(mechanism, plain)) if single else ())]
        if len(plain.own) <= MOST_JOINTS:
            found += [*_by_slopes(mechanism, data, plain)][:None if single else FEW]
    return list(dict.fromkeys(found))


def other_units(mechanism: Mechanism, plain: ReadColumns) -> list[dict[str, float]]:
    """Return, by joint, the other units that its column may be in, and their factors."""
    return [{} if bare else units_beside(LENGTHS if quantity == "length" else TURNED, declared)
            for quantity, bare, declared in zip(
                mechanism.actuator_quantity, mechanism.actuator_has_ratio, plain.factors,
                strict=True)]


def units_beside(known: Mapping[str, float], declared: float) -> dict[str, float]:
    """Return the units other than the declared one, and their factors on the values."""
    return {u: v / declared for u, v in known.items() if not np.isclose(v, declared)}


def _single(plain: ReadColumns, units: Sequence[Mapping[str, float]]) -> Iterator[ReadColumns]:
    k = len(plain.own)
    for i, j in combinations(range(k), 2):
        yield replace(plain, order=tuple({i: j, j: i}.get(n, n) for n in range(k)))
    for own in (*([i] for i in range(k)), range(k)):
        yield replace(plain, signs=tuple(-1 if n in own else 1 for n in range(k)))
        for unit in dict.fromkeys(u for i in own for u in units[i]):
            yield replace(plain, units=tuple(
                unit if n in own and unit in units[n] else "" for n in range(k)))


def _by_slopes(mechanism: Mechanism, data: Dataset, plain: ReadColumns) -> Iterator[ReadColumns]:
    """Yield readings by how positions, and measured rotations, follow the columns.

    The most likely first, by positions before by rotations.
    """
    closure, pose = Model(mechanism).closure(home_state(mechanism).q[None]), mechanism.home[None]
    try:
        speeds = -linalg.solve(closure.pose_matrix(pose)[0], closure.joint_matrix(pose)[0])
    except LinearAlgebraError:
        return
    seen = _motions(mechanism, data)
    for turn, values in enumerate(seen):
        measured = _slopes(data.q, values)
        own = speeds[[n for n, c in enumerate(mechanism.dof) if (c >= 3) == bool(turn)]]
        if measured is not None:
            yield from islice(_by_correlations(plain, other_units(mechanism, plain), measured, own),
                              2 * KEPT // len(seen))


def _motions(mechanism: Mechanism, data: Dataset) -> list[Array]:
    """Return positions, and rotations relative to the middle row, as vectors (N, 3).

    Rotations follow the joints alike wherever the target is; positions of a far target do not.
    """
    position = np.where(np.isfinite(data.position).any(axis=0), data.position, 0.0)
    known = np.flatnonzero(finite_rows(data.rotation))
    if not mechanism.motion.measures_rotation_vectors or not known.size:
        return [position]
    rotation = data.rotation[known]
    turns = cga.rotation_matrix(cga.motor_from_rotation_vector(rotation, np.zeros(3)))
    middle = turns[np.argmin(np.linalg.norm(rotation - np.median(rotation, axis=0), axis=1))]
    out = np.full_like(data.rotation, np.nan)
    out[known] = cga.rotation_vector(cga.motor_from_matrix(middle.T @ turns, np.zeros(3)))
    return [position, out]


def _by_correlations(plain: ReadColumns, units: Sequence[Mapping[str, float]], measured: Array,
                     own: Array) -> Iterator[ReadColumns]:
    """Yield readings by matching the cosines of measured slopes (3, k) to the machine's."""
    (shape, size), (nominal, length) = _correlations(measured), _correlations(own)
    if min(size.min(), length.min()) <= 0.0:
        return
    k = len(size)
    orders = np.array(list(permutations(range(k))))
    turned = shape[orders[:, :, None], orders[:, None, :]]
    signs = np.array([(1, *s) for s in product((1, -1), repeat=k - 1)])
    both = signs[:, :, None] * signs[:, None, :]
    # |S o C - N|^2 = |C|^2 + |N|^2 - 2 <S, C o N>: one product for all signs and orders
    match = (turned * nominal).reshape(len(orders), -1) @ both.reshape(len(signs), -1).T
    apart = (turned**2).sum(axis=(1, 2))[:, None] - 2.0 * match
    for flat in np.argsort(apart, axis=None, kind="stable")[:KEPT]:
        o, s = np.unravel_index(flat, apart.shape)
        order = orders[o]
        factors = size[order] / length
        named = tuple(_nearest_unit(f, u) for f, u in zip(factors.tolist(), units, strict=True))
        for way in (1, -1):
            yield replace(plain, order=tuple(order.tolist()), units=named,
                          signs=tuple((way * signs[s]).tolist()))


def _nearest_unit(slope: float, units: Mapping[str, float]) -> str:
    """Return the unit whose numbers are larger by the factor by which the slope is too small."""
    off = {u: abs(float(np.log(max(slope, 1e-300) / f))) for u, f in {"": 1.0, **units}.items()}
    best = min(off, key=lambda u: off[u])
    return best if off[best] < np.log(NEAR) else ""


def _slopes(columns: Array, values: Array) -> Array | None:
    """Return d values / d column (3, k) over all rows, None if they do not determine it."""
    rows, k = np.flatnonzero(finite_rows(values) & finite_rows(columns)), columns.shape[1]
    if len(rows) < 2 * k + 2:
        return None
    q, p = (v[rows] - np.median(v[rows], axis=0) for v in (columns, values))
    spread = np.median(np.abs(q), axis=0)
    if not np.all(spread > 0.0):
        return None
    x = np.column_stack([q / spread, np.ones(len(q))])
    # mistyped values have the most leverage when far out: a few rounds without them
    keep = (np.abs(x) < 20.0).all(axis=1)
    for _ in range(4):
        if keep.sum() < 2 * k + 2:
            return None
        slopes, rank = linalg.lstsq(x[keep], p[keep], rcond=1e-8)
        if rank <= k:
            return None
        away = np.linalg.norm(p - x @ slopes, axis=1)
        keep = away <= 4.0 * np.median(away) + 1e-300
    return np.asarray((slopes[:-1] / spread[:, None]).T)


def _correlations(columns: Array) -> tuple[Array, Array]:
    """Return the cosines between columns (k, k) and their lengths (k,)."""
    size = np.linalg.norm(columns, axis=0)
    unit = columns / np.where(size > 0.0, size, 1.0)
    return unit.T @ unit, size


def pose_readings(plain: ColumnInterpretation, data: Dataset) -> list[ColumnInterpretation]:
    """Return single changes of the measured columns, as declared first."""
    return [*position_readings(plain), *rotation_readings(plain, data)[1:],
            *whole_pose_readings(plain, data)]


def position_readings(plain: ColumnInterpretation) -> list[ColumnInterpretation]:
    """Return readings of the measured positions, as declared first."""
    planar = len(plain.places.own) == 2
    axes = [AXES[1], AXES[0]] if planar else [AXES[2], *AXES[:2]]
    out = [plain, *(replace(plain, mirror=a) for a in axes), *(
        _placed(plain, order=o) for o in _orders() if not planar or o[2] == 2), *(
        _placed(plain, signs=s) for s in (
            (*ONE_SIGN[:2], (-1, -1, 1)) if planar else (*ONE_SIGN, ALL_SIGNS)))]
    units = units_beside(LENGTHS, plain.places.factors[0])
    return [*out, *(_placed(p, units=(u, u, u)) for u in units for p in out), *(
        _placed(plain, units=tuple(u if i == axis else "" for i in range(3)))
        for u in units for axis in plain.places.own)]


def rotation_readings(plain: ColumnInterpretation, data: Dataset) -> list[ColumnInterpretation]:
    """Return readings of the rotation columns, as declared first; only that one without rotations.

    Matrices are only read as in the sidecar, which has no other option for them.
    """
    convention = plain.convention
    if not np.isfinite(data.rotation).any() or convention == "matrix":
        return [plain]
    units = ["", *units_beside(TURNED, plain.turns.factors[0])]
    if len(plain.places.own) == 2:
        return [_turned(plain, units=(u, u, u), signs=(1, 1, s)) for u in units for s in (1, -1)]
    both = ((1, 1, 1), ALL_SIGNS)
    if convention.startswith("quat"):
        other = "quat-wxyz" if convention == "quat-xyzw" else "quat-xyzw"
        return [replace(_turned(plain, signs=s), rotation=r) for r in ("", other) for s in both]
    others = [c for c in ("rotvec", *(f"euler-{o}" for o in ORDERS)) if c != convention]
    whole = [replace(_turned(plain, units=(u, u, u), signs=s), rotation=c) for u in units
             for s in both for c in ("", *others)]
    return [*whole, *(_turned(plain, signs=s) for s in ONE_SIGN),
            *(_turned(plain, order=o) for o in _orders()),
            *(replace(_turned(plain, order=(2, 1, 0)), rotation=c) for c in others)]


def whole_pose_readings(plain: ColumnInterpretation, data: Dataset) -> list[ColumnInterpretation]:
    """Return readings in which positions depend on the rotations: inverse poses."""
    if not np.isfinite(data.rotation).any() or not data.kind.sees_rotation:
        return []
    units = units_beside(LENGTHS, plain.places.factors[0])
    return [replace(_placed(r, units=(u, u, u)), inverse=True)
            for r in rotation_readings(plain, data) for u in ("", *(units if r == plain else ()))]


def _orders() -> Iterator[tuple[int, ...]]:
    """Yield the orders of three columns other than their own."""
    return islice(permutations(range(3)), 1, None)


def _placed(reading: ColumnInterpretation, **other: tuple[Any, ...]) -> ColumnInterpretation:
    return replace(reading, places=replace(reading.places, **other))


def _turned(reading: ColumnInterpretation, **other: tuple[Any, ...]) -> ColumnInterpretation:
    return replace(reading, turns=replace(reading.turns, **other))
