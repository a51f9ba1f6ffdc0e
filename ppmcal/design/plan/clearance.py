"""Whether legs stay clear of each other, struts of no thickness."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.linalg import Array, Bools

OF_HOME = 0.5
OF_REACH = 0.02
"""Legs are too close below the smaller of these parts, of their distance at home and of the
reach."""


def too_close(model: Model, q: Array, pose: Array) -> Bools:
    """Return where two legs of a spatial machine come too close to each other (N,).

    Args:
        model: the machine.
        q: joint values (N, k).
        pose: full poses (N, 6).

    What counts is the scale of a collision, not its surfaces: the least distance between two
    struts, each the segment from its base-side joint to the platform. Pairs that touch at home
    (double ball joints) are not watched. Machines of other motions have no legs that could meet
    in this sense (planar ones are built in layers): nowhere too close.
    """
    mechanism = model.mechanism
    if not mechanism.motion.turns_freely:
        return np.zeros(len(q), dtype=np.bool_)
    at_home = leg_distances(model, home_state(mechanism).q[None], mechanism.home[None])[0]
    least = np.minimum(OF_HOME * at_home, OF_REACH * mechanism.reach)
    least = np.where(at_home > 1e-9 * mechanism.reach, least, -1.0)
    return np.asarray((leg_distances(model, q, pose_motor(pose)) < least).any(axis=1))


def leg_distances(model: Model, q: Array, pose: Array) -> Array:
    """Return the least distances between struts (N, pairs), m; motors ``pose`` (N, 8)."""
    start, end = struts(model, q, pose)
    pairs = list(combinations(range(start.shape[1]), 2))
    if not pairs:
        return np.full((len(q), 0), np.inf)
    one, two = (list(side) for side in zip(*pairs, strict=True))
    return segment_distance(start[:, one], end[:, one], start[:, two], end[:, two])


def struts(model: Model, q: Array, pose: Array) -> tuple[Array, Array]:
    """Return where each strut begins and ends (N, L, 3), base axes, m.

    From the base-side joint (centre of the sphere on which the contact lies) to the platform.
    """
    bare = model.closure(q)
    closure = bare.at(pose)
    carried = closure.carried(pose)
    # planes (the hinge of an R(P)S) have no centre; every strut has a sphere
    spheres = np.flatnonzero(bare.radius.max(axis=0) > 0.0)
    fixed, carried = closure.fixed[:, spheres], carried[:, spheres]
    mobile = closure.point_moves[spheres, None]
    return (cga.coordinates(np.where(mobile, fixed, carried)),
            cga.coordinates(np.where(mobile, carried, fixed)))


def segment_distance(p: Array, p_end: Array, r: Array, r_end: Array) -> Array:
    """Return least distances between segments (...), ends (..., 3) each.

    The nearest points lie inside both segments or at an end of one: of the five candidates the
    least counts (Ericson, Real-Time Collision Detection, 5.1.9).
    """
    u, v, w = p_end - p, r_end - r, p - r
    a, b, c = _dot(u, u), _dot(u, v), _dot(v, v)
    d, e = _dot(u, w), _dot(v, w)
    det = a * c - b * b
    with np.errstate(divide="ignore", invalid="ignore"):
        s, t = (b * e - c * d) / det, (a * e - b * d) / det
    inside = (det > 1e-14 * a * c) & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    middle = np.linalg.norm(w + np.where(inside, s, 0.0)[..., None] * u
                            - np.where(inside, t, 0.0)[..., None] * v, axis=-1)
    ends = [_to_segment(p, r, r_end), _to_segment(p_end, r, r_end),
            _to_segment(r, p, p_end), _to_segment(r_end, p, p_end)]
    return np.asarray(np.min([np.where(inside, middle, np.inf), *ends], axis=0))


def _to_segment(point: Array, start: Array, end: Array) -> Array:
    way = end - start
    length = _dot(way, way)
    part = np.clip(_dot(point - start, way) / np.where(length > 0.0, length, 1.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(point - start - part[..., None] * way, axis=-1))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.sum(a * b, axis=-1))
