"""Measurements, checked once at the border; SI, plain arrays, one row per measurement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.arrays import Array, ways

KINDS = ("pose", "position", "plane", "distance")


@dataclass(frozen=True)
class Unknown:
    """A pose, point or rotation that is either given or to be fitted.

    ``value`` holds the given one, or zeros; ``same_as`` names another data set whose
    fitted one is shared.
    """

    fitted: bool
    value: Array
    same_as: str | None = None


@dataclass(frozen=True)
class Dataset:
    """One CSV with its sidecar.

    Attributes:
        name: the sidecar's name, unique within a campaign.
        source: path of the CSV, for messages.
        kind: ``pose``, ``position``, ``plane`` or ``distance``.
        rows: row numbers in the CSV, counting data rows from 1, (N,).
        q: joint values by actuator in SI (m, rad; bare numbers where the drive has a
            ratio), (N, k); nan where the file gives a commanded pose instead.
        commanded: commanded poses (N, 6), nan where unused, or None.
        position: measured position (N, 3), nan where not measured (planar: z is nan).
        rotation: measured rotation vector (N, 3), nan where not measured (planar: only z).
        value: heights or distances (N,), nan for other instruments.
        to_q: second joint values of a distance between two platform positions, or None.
        sigma_position, sigma_rotation: standard deviations (N, 3).
        sigma_value: of ``value`` (N,).
        sigma_actuator: noise of the joints, by actuator (k,), 0 where none; unit of q.
        groups: integer label per commanded pose (repeats share it), (N,).
        columns: further columns by name in SI: ``dir_leg1``, ``vel_leg1``,
            ``temperature``, ``payload``, ``time``, ``fx`` ...; (N,) each, nan = missing.
        sessions: label per row, or None.
        frame, target, target_rotation: known or to be fitted; (6,), (3,), (3,).
        homing: ``shared`` or ``per-file``; inside the program also ``alone``: open even in the
            first file.
        approach: ``columns``, ``sequence`` or ``unknown``.
        visited: direction of approach of each joint (N, k), +1 or -1, nan where unknown; None:
            as columns and ``approach`` say. What follows from the order of the rows is kept here
            when rows are taken out.
        unusable: why a row must not be used, "" where it may, by row; None: all may.
        findings: warnings that reading gave, each naming the row or column.
        dropped: rows of the CSV that hold nothing usable: (row number, reason).
        extra: what only one kind of instrument has.
    """

    name: str
    source: str
    kind: str
    rows: NDArray[np.int64]
    q: Array
    commanded: Array | None
    position: Array
    rotation: Array
    value: Array
    to_q: Array | None
    sigma_position: Array
    sigma_rotation: Array
    sigma_value: Array
    sigma_actuator: Array
    groups: NDArray[np.int64]
    columns: Mapping[str, Array]
    sessions: tuple[str, ...] | None
    frame: Unknown
    target: Unknown
    target_rotation: Unknown
    homing: str = "shared"
    approach: str = "unknown"
    visited: Array | None = None
    unusable: tuple[str, ...] | None = None
    findings: tuple[str, ...] = ()
    dropped: tuple[tuple[int, str], ...] = ()
    extra: Mapping[str, object] = field(default_factory=dict)

    @classmethod
    def of_poses(cls, name: str, q: Array, pose: Array, sigma: tuple[float, float],
                 fitted: bool) -> Dataset:
        """Return full poses (N, 6) at joints ``q`` (N, k) as if measured, nan where not.

        ``sigma``: standard deviations of position and rotation; ``fitted``: whether frame,
        target and target rotation are open, else they are the base's own.
        """
        n, one = pose.shape[0], np.ones((pose.shape[0], 3))
        point = Unknown(fitted, np.zeros(3))
        return cls(
            name=name, source=name, kind="pose", rows=np.arange(1, n + 1), q=q, commanded=None,
            position=pose[:, :3], rotation=pose[:, 3:], value=np.full(n, np.nan), to_q=None,
            sigma_position=sigma[0] * one, sigma_rotation=sigma[1] * one,
            sigma_value=np.ones(n), sigma_actuator=np.zeros(q.shape[1]), groups=np.arange(n),
            columns={}, sessions=None, frame=Unknown(fitted, np.zeros(6)), target=point,
            target_rotation=point)

    def __len__(self) -> int:
        """Return the number of rows N."""
        return int(self.rows.shape[0])

    def take(self, keep: NDArray[np.int64] | NDArray[np.bool_]) -> Dataset:
        """Return the data set with only the rows ``keep`` (indices or mask)."""
        sessions, unusable = (
            None if words is None else tuple(np.asarray(words, dtype=object)[keep])
            for words in (self.sessions, self.unusable))
        visited = self.directions()
        return replace(
            self, rows=self.rows[keep], q=self.q[keep],
            commanded=None if self.commanded is None else self.commanded[keep],
            position=self.position[keep], rotation=self.rotation[keep], value=self.value[keep],
            to_q=None if self.to_q is None else self.to_q[keep],
            sigma_position=self.sigma_position[keep], sigma_rotation=self.sigma_rotation[keep],
            sigma_value=self.sigma_value[keep], groups=self.groups[keep],
            columns={n: c[keep] for n, c in self.columns.items()}, sessions=sessions,
            visited=None if visited is None else visited[keep], unusable=unusable)

    def directions(self) -> Array | None:
        """Return the directions of approach that the order of the rows gives (N, k), or None."""
        if self.visited is None and self.approach == "sequence":
            return ways(self.q)
        return self.visited
