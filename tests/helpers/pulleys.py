"""How long a rope over a pulley is, in plain NumPy: the contract's formula, without the algebra."""

import numpy as np
from scipy.optimize import brentq

from helpers.machines import matrices


def over_circle(point, radius):
    """Return tangent and arc to a point (2,) off a circle about 0, wound left from -y on.

    The tangent's end is found as the only place from which the rest is square to the radius.
    """
    way = np.arctan2(point[1], point[0])

    def missing(t):
        return radius * np.cos(way - t) * np.hypot(*point) / radius - radius

    t = brentq(missing, way - np.pi / 2, way, xtol=1e-16)
    leaves = radius * np.array([np.cos(t), np.sin(t)])
    return float(np.linalg.norm(point - leaves)), float(np.mod(t + np.pi, 2 * np.pi)
                                                       - np.pi / 2), leaves


def rope_length(values, constants, end):
    """Return the length (N,) of a rope to points (N, 3), by its slots; errors of the axis are 0.

    As the contract has it: sqrt(D^2 - r^2) + r wrap in the pulley's plane, and off it the tangent
    with what the point is off that plane.
    """
    def place(name):
        return np.array([values.get(f"{name}.{a}", 0.0) for a in "xyz"])

    if "base.pulley.radius" in values:
        r, away = values["base.pulley.radius"], end - place("base.pulley.center")
        axis, zero = constants["base.pulley.axis"], constants["base.pulley.zero"]
        side = np.cross(axis, zero)
        # -y of the circle is where the rope comes onto it
        flat = np.stack([away @ side, -(away @ zero)], axis=1)
        off = away @ axis
    else:
        r, away = values["base.swivel_pulley.radius"], end - place("base.swivel_pulley.point")
        axis = constants["base.swivel_pulley.axis"]
        up = away @ axis
        out = np.linalg.norm(away - up[:, None] * axis, axis=1)
        # seen so that the rope runs left round it: its way, up, is x; the platform is towards y
        flat, off = np.stack([up, out - r], axis=1), np.zeros(len(end))
    parts = [over_circle(p, r) for p in flat]
    return np.array([np.hypot(free, h) + r * wrap
                     for (free, wrap, _), h in zip(parts, off, strict=True)])


def rope_lengths(mechanism, g, pose):
    """Return the joint values (N, k) of a machine on ropes over pulleys at motors (N, 8)."""
    turn, origin = matrices(pose)
    out = []
    for limb in mechanism.limbs:
        v = limb.slots.values(g)
        own = np.array([v.get(f"platform.point.{a}", 0.0) for a in "xyz"])
        u = rope_length(v, limb.constants, origin + turn @ own)
        out.append((u - v.get("offset", 0.0)) / v.get("ratio", 1.0))
    return np.stack(out, axis=1)
