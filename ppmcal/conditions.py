"""The conditions of N rows that effects depend on: approach, speed, load, temperature, time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.arrays import Array, ways

STANDARD_GRAVITY = 9.80665
REFERENCE_TEMPERATURE = 293.15
WRENCH = ("fx", "fy", "fz", "mx", "my", "mz")


@dataclass(frozen=True)
class Conditions:
    """Conditions of N rows with k joints, SI; nan where not recorded.

    ``approach``, ``velocity`` (of q) (N, k); ``temperature`` K above 20 degrees Celsius (N,);
    ``wrench`` on the platform (N, 6); ``time`` s (N,).
    """

    approach: Array
    velocity: Array
    temperature: Array
    wrench: Array
    time: Array

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Conditions:
        """Return the conditions of some rows."""
        return Conditions(self.approach[rows], self.velocity[rows], self.temperature[rows],
                          self.wrench[rows], self.time[rows])


def unknown_conditions(rows: int, joints: int) -> Conditions:
    """Return conditions of which nothing is known."""
    one = np.full(rows, np.nan)
    many = np.full((rows, joints), np.nan)
    return Conditions(many, many, one, np.full((rows, 6), np.nan), one)


def conditions(columns: Mapping[str, Array], actuators: Sequence[str], gravity: Array,
               q: Array, sequence: bool = False) -> Conditions:
    """Return the conditions that columns in SI describe.

    Args:
        columns: ``dir_<actuator>``, ``vel_<actuator>``, ``temperature`` in K, ``payload`` in
            kg, ``fx`` ..., ``time``; (N,) each.
        actuators: names of the joints.
        gravity: direction of weight in base axes (3,).
        q: joint values (N, k).
        sequence: the rows were visited in order, so that the way from the row before is
            the direction of approach.
    """
    n = q.shape[0]
    blank = np.full(n, np.nan)
    approach = np.stack([columns.get(f"dir_{a}", blank) for a in actuators], axis=-1)
    if sequence:
        approach = ways(q)
    velocity = np.stack([columns.get(f"vel_{a}", blank) for a in actuators], axis=-1)
    wrench = np.full((n, 6), np.nan)
    if "payload" in columns or any(w in columns for w in WRENCH):
        given = [np.asarray(columns.get(w, np.zeros(n))) for w in WRENCH]
        weight = STANDARD_GRAVITY * np.asarray(columns.get("payload", np.zeros(n)))
        wrench = np.stack(given, axis=-1)
        wrench[:, :3] += weight[:, None] * gravity
    temperature = columns.get("temperature", blank) - REFERENCE_TEMPERATURE
    return Conditions(approach, velocity, temperature, wrench, columns.get("time", blank))


def with_platform_directions(found: Conditions, by_axis: Array, drive: Array) -> Conditions:
    """Fill in approach directions that were recorded for the platform.

    Args:
        found: conditions with unknown approach.
        by_axis: ``dir_x, dir_y, dir_z`` (N, 3), 0 or nan where not recorded.
        drive: dq/d(platform displacement) at each row (N, k, 3).
    """
    way = np.sign(np.einsum("nkc,nc->nk", drive, np.nan_to_num(by_axis)))
    recorded = np.asarray(np.isfinite(by_axis).any(axis=1))[:, None] & (way != 0.0)
    return replace(found, approach=np.where(np.isfinite(found.approach) | ~recorded,
                                            found.approach, way))
