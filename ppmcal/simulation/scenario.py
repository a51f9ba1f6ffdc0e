"""A scenario as plain data, SI: what simulate measures (contract section 3)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ppmcal.linalg import Array
from ppmcal.model.instruments import InstrumentKind
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units


@dataclass(frozen=True)
class Circle:
    """``count`` poses on a circle in the x-y plane; other coordinates go through one period.

    ``center`` (6,), nan where to be solved for; ``swing`` (6,) amplitudes; ``radius`` m.
    """

    center: Array
    radius: float
    count: int
    swing: Array

    @property
    def size(self) -> int:
        """How many poses it has."""
        return self.count


@dataclass(frozen=True)
class GridPattern:
    """All combinations of ``counts`` (6,) values over center ± half_range, (6,) each."""

    center: Array
    half_range: Array
    counts: NDArray[np.int64]

    @property
    def size(self) -> int:
        """How many poses it has."""
        return math.prod(self.counts.tolist())


@dataclass(frozen=True)
class Random:
    """``count`` poses drawn uniformly from center ± half_range, (6,) each."""

    center: Array
    half_range: Array
    count: int

    @property
    def size(self) -> int:
        """How many poses it has."""
        return self.count


@dataclass(frozen=True)
class Helix:
    """``count`` poses on a helix about z through ``center`` (6,); diameter, pitch in m."""

    center: Array
    diameter: float
    pitch: float
    turns: float
    count: int

    @property
    def size(self) -> int:
        """How many poses it has."""
        return self.count


@dataclass(frozen=True)
class Listed:
    """Poses of a file, (N, 6), nan where left empty, with settings from its other columns.

    ``columns``: ``dir_...``, ``vel_...``, ``payload``, ``temperature`` in SI (N,), those present in
    the file; ``labels``: its column ``pose`` (N,), or None.
    """

    poses: Array
    path: str
    columns: Mapping[str, Array] = field(default_factory=dict)
    labels: NDArray[np.int64] | None = None

    def take(self, keep: NDArray[np.bool_]) -> Listed:
        """Return some of the rows."""
        return Listed(self.poses[keep], self.path, {n: c[keep] for n, c in self.columns.items()},
                      None if self.labels is None else self.labels[keep])

    @property
    def size(self) -> int:
        """How many poses it has."""
        return len(self.poses)


Pattern: TypeAlias = Circle | GridPattern | Random | Helix | Listed
"""Where a scenario measures."""


@dataclass(frozen=True)
class Scenario:
    """A scenario in SI.

    Attributes:
        source: path of the file; units: its units, in which measurements are written.
        poses: where to measure.
        errors: parameter name -> difference from its present value, SI.
        error_scale: draw errors from the tolerances times this, or None.
        kind: of instrument.
        sigma_position, sigma_rotation: noise of the instrument, 0 where none, m and rad.
        sigma_value: noise of a height, distance or joint reading, m or rad.
        sigma_actuator: noise of the joints (k,), unit of q.
        tracker: noise of a tracker's distances and angles, m and rad, or None; station: its
            position in the measuring frame (3,).
        point: the fixed point of a distance instrument (3,); point_known: whether the
            sidecar gives it.
        pairs: distances are between two platform positions.
        offset: reading of an encoder at a joint minus the true value, rad or m.
        frame: the base's pose in the measuring frame (6,); frame_known: left at the default.
        target, target_rotation: (3,) each; target_known, target_rotation_known likewise.
        targets: points (3,) by name, if several targets are on the platform, in place of
            ``target``.
        ar, outliers, tails: correlation of successive noise, share of outliers, ``normal`` or
            ``t4``.
        repeats: measurements per pose; approach: ``both``, ``sequence`` or ``one``.
        payload: kg, the loads to apply in turn, or empty.
        tension: N, the mean rope tensions to apply in turn, or empty.
        temperature: (mean in K, swing in K) or None.
        velocity: largest speed of each joint at the trigger (k,), 0 where at rest.
        with_effects: the machine with the effects that act on it.
        seed: of the generator.
    """

    source: str
    units: Units
    poses: Pattern
    errors: Mapping[str, float]
    error_scale: float | None
    kind: InstrumentKind
    sigma_position: float
    sigma_rotation: float
    sigma_value: float
    sigma_actuator: Array
    point: Array
    point_known: bool
    frame: Array
    frame_known: bool
    target: Array
    target_known: bool
    target_rotation: Array
    target_rotation_known: bool
    ar: float
    outliers: float
    tails: str
    repeats: int
    approach: str
    payload: tuple[float, ...]
    temperature: tuple[float, float] | None
    velocity: Array
    with_effects: Mechanism
    seed: int
    pairs: bool = False
    offset: float = 0.0
    tension: tuple[float, ...] = ()
    tracker: tuple[float, float] | None = None
    station: Array = field(default_factory=lambda: np.zeros(3))
    targets: Mapping[str, Array] = field(default_factory=dict)

    @property
    def places(self) -> Mapping[str, Array]:
        """The targets (3,) by name; the name of a single one is empty."""
        return self.targets or {"": self.target}
