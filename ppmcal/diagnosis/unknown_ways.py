"""Functions of the moves between rows: of each joint's move, and of how far the platform moved.

A joint need not have come from the previous row, yet an unknown cause may depend on that move. A
reading that is late or early includes part of the move from the previous row, or to the next one.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ppmcal.algebra.conversions import rotation_vector
from ppmcal.algebra.motors import compose, reverse, translation
from ppmcal.diagnosis.kernels import LENGTHS, beyond_mean, matern
from ppmcal.diagnosis.term_candidates import (
    PER_NODE,
    Visible,
    columns_from,
)
from ppmcal.diagnosis.unknown_courses import WAVES, time_in
from ppmcal.diagnosis.unknown_functions import Made, coordinates, functions_of, joints, told
from ppmcal.linalg import Array
from ppmcal.model.effects.learned_curve import spline_basis
from ppmcal.model.effects.setting import PLACE

SHORT = LENGTHS[:2]
"""Moves within which a reversal is taken up: over longer ones it is a slope and not a reversal."""
AT_REST = ("read only when the platform is at rest, and check that joints and instrument are read "
           "at the same moment")
BOTH_WAYS = "record how each row was reached (`dir_`), and approach some poses from both sides"


def of_ways(seen: Visible) -> Iterator[Made]:
    """Yield functions of the moves.

    Except of the move from the previous row if files say how rows were reached: the library has it.
    """
    system = seen.system
    joints = [np.diff(data.q, axis=0) for data in system.problem.datasets]
    none = np.full((1, len(system.problem.mechanism.actuators)), np.nan)
    if not all(np.isfinite(p.setting.move).any() for p in system.parts):
        came = at_rows(seen, [np.concatenate([none, way]) for way in joints])
        yield from _of_joints(seen, "move from the previous row", came)
        approach = [p.setting.approach for p in system.parts]
        sides = np.concatenate(approach)
        if np.isfinite(sides).all() and np.ptp(sides) > 0.0:
            yield from _of_joints(seen, "move from the previous row", came, approach)
    earlier = [np.concatenate([none, none, way])[:-1] for way in joints]
    yield from _of_joints(seen, "move before last", at_rows(seen, earlier))
    goes = at_rows(seen, [np.concatenate([way, none]) for way in joints])
    yield from _of_joints(seen, "move to the next row", goes)
    yield from _of_platform(seen)


def _of_platform(seen: Visible) -> Iterator[Made]:
    """Yield causes by the platform's move: readings early or late, by direction, by distance."""
    acted, still = coordinates(seen), np.zeros((1, 6))
    moved = [(still, _moved(poses[:, :8]), still) for poses in seen.system.state.poses]
    behind = [np.concatenate(m[:2]) for m in moved]
    yield from _part_of(seen, "from the previous row", [-way for way in behind])
    yield from _part_of(seen, "to the next row", [np.concatenate(m[1:]) for m in moved])
    for along in told(seen):
        way = at_rows(seen, [b[:, PLACE[along]] for b in behind])
        yield from functions_of(seen, f"the platform's last move in {along}", way, acted, BOTH_WAYS)
    far = [np.linalg.norm(way[:, :3], axis=1) for way in behind]
    yield from functions_of(seen, "how far the platform moved", at_rows(seen, far), acted, AT_REST)


def _moved(poses: Array) -> Array:
    """Return the displacements (N-1, 6) between poses (N, 8), base axes; 0 if one is unknown."""
    turned = rotation_vector(compose(poses[1:], reverse(poses[:-1])))
    ways = np.concatenate([np.diff(translation(poses), axis=0), turned], axis=1)
    return np.asarray(np.nan_to_num(ways))


def _part_of(seen: Visible, name: str, ways: Sequence[Array]) -> Iterator[Made]:
    """Yield errors of readings that include part of the platform's move (N, 6), axis by axis.

    By a constant part, or one that changes over the campaign. Coordinates that hardly vary except
    by errors are omitted: their moves are errors too.
    """
    late = [time_in(seen.system)[p.at, None] for p in seen.system.parts]
    along = {c: [way[:, [PLACE[c]]] for way in at_rows(seen, ways)] for c in told(seen)}
    if not along:
        return
    for more, parts in (("", along), (", changing over the campaign", {
            c: [way * np.hstack([1.0 - t, t]) for way, t in zip(own, late, strict=True)]
            for c, own in along.items()})):
        yield Made(f"readings that include part of the move {name}{more}", np.concatenate(
            [columns_from(seen, c, (), own) for c, own in parts.items()], axis=1),
            remedy=AT_REST, low=0.0, high=1.0)


def at_rows(seen: Visible, values: Sequence[Array]) -> list[Array]:
    """Return each data set's values by row, for the rows of each part of the system."""
    return [values[p.dataset][seen.system.row[p.at]] for p in seen.system.parts]


def _of_joints(seen: Visible, name: str, ways: Sequence[Array], sides: Sequence[Array] = ()
               ) -> Iterator[Made]:
    """Yield functions of joints' moves (N, k), each by its own move.

    ``sides`` (N, k): directions of approach, along which moves then count; beyond a full reversal,
    which the library has, or a reversal that short moves take up in part.
    """
    along = [way * side for way, side in zip(ways, sides, strict=True)] if sides else ways
    for acted in joints(seen):
        known = np.concatenate([x[:, np.array(acted.on)] for x in along])
        known = known[np.isfinite(known)]
        if known.size < PER_NODE * WAVES or not np.ptp(known) > 0.0:
            continue
        nodes = np.linspace(known.min(), known.max(), WAVES)
        kernels = [matern(nodes, length) for length in LENGTHS]
        if sides:
            kernels = [*beyond_mean(kernels, nodes, known),
                       *(1.0 + matern(nodes, length) for length in SHORT)]
        weights = [spline_basis(nodes, np.nan_to_num(x)) * np.isfinite(x)[..., None] for x in along]
        if sides:
            weights = [w * side[..., None] for w, side in zip(weights, sides, strict=True)]
        yield acted.made(seen, f"a function of the {name}{' by direction' if sides else ''}",
                         weights, kernels, remedy=BOTH_WAYS)
