"""Instruments that measure one number, heights of a flat and distances: where they start.

A flat's unknown height and tilt are the z, rx and ry of the frame; the unknown point that
distances are measured from is the frame's origin.
"""

from __future__ import annotations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.arrays import Array, known
from ppmcal.errors import BadInput
from ppmcal.kinematics.registration import Station, predict
from ppmcal.model.dataset import Dataset


def refuse_flat(kind: str, motion: str, source: str) -> None:
    """Refuse heights of a machine that has none.

    Raises:
        BadInput: touches of a flat by a planar machine; ``source``: the file that says so.
    """
    if kind == "plane" and motion == "planar":
        raise BadInput("a planar machine cannot touch a flat: it has no z",
                       f"{source}: instrument.kind", "Use pose, position or distance")


def start_scalar(data: Dataset, pose: Array, station: Station, motion: str) -> Station:
    """Return the station from which a fit of heights or distances starts.

    Args:
        data: heights, or distances.
        pose: platform motors at the rows' joint values (N, 8 or 16).
        station: with what is known, zeros elsewhere.
        motion: the machine's motion.

    Raises:
        BadInput: fewer rows than a flat or a point needs.
    """
    if not data.frame.fitted or data.to_q is not None:
        return station
    rows = np.flatnonzero(known(pose) & np.isfinite(data.value))
    if rows.size < 3:
        raise BadInput(f"only {rows.size} usable rows: an unknown frame needs at least 3",
                       data.source, "Measure more poses")
    point, _ = predict(station, pose[rows])
    step = (_flat(point, data.value[rows]) if data.kind == "plane"
            else _origin(point, data.value[rows], motion))
    motor = cga.compose(cga.motor_from_rotation_vector(step[3:], step[:3]), station.frame)
    return Station(motor, station.target, station.target_rotation, station.homing)


def _flat(point: Array, height: Array) -> Array:
    """Return height and tilt (6,) that best turn points' z into the heights."""
    x, y, z = point.T
    columns = np.stack([np.ones_like(z), y, -x], axis=1)
    up, rx, ry = np.linalg.lstsq(columns, height - z, rcond=None)[0]
    return np.array([0.0, 0.0, up, rx, ry, 0.0])


def _origin(point: Array, distance: Array, motion: str) -> Array:
    """Return the shift (6,) that brings the point which distances are from to the origin.

    |p - c|^2 = d^2 is linear in c once its value at the mean is taken off. Of two mirrored
    answers, as to points in a plane, the nearer to that plane is where the fit starts.
    """
    free = 2 if motion == "planar" else 3
    middle = point.mean(axis=0)
    p = (point - middle)[:, :free]
    square = np.sum(p**2, axis=1) - distance**2
    columns = np.concatenate([2.0 * p, np.ones((len(p), 1))], axis=1)
    solution = np.linalg.lstsq(columns, square, rcond=1e-9)[0]
    out = np.zeros(6)
    out[:free] = -(solution[:free] + middle[:free])
    return out
