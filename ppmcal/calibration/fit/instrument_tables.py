"""Input to the compiled loops: a data set's instrument as tables, and its rows' likely poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit.latent_poses import ROUND_OFF, STEPS, STILL
from ppmcal.calibration.fit.nuisance_columns import (
    SCALE,
    TARGET,
    TURN,
    InstrumentTables,
    NuisanceColumns,
)
from ppmcal.calibration.fit.observation import coordinates, white_measurements
from ppmcal.kinematics import compiled_limbs
from ppmcal.kinematics.closure import Closure
from ppmcal.linalg import Array, Ints
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.chain import left_jacobian
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

ALONE = 1e-2
"""Single rows end with steps this much smaller than rows that continue until the last one ends."""


class LikelyRows(NamedTuple):
    """Compiled rows (n,) of surplus limbs.

    ``noise`` of the joint coordinates (L,) and ``gaps`` of the equations (m,); ``u`` (n, L);
    ``pose`` (n, 8): most likely poses; ``seen`` (n, 6): measurements, and ``white`` (n, k):
    1/sigma, without row weights; ``squares`` of the rows (n,), and ``number`` (n,) of values in
    each.
    """

    noise: Array
    gaps: Array
    u: Array
    pose: Array
    seen: Array
    white: Array
    squares: Array
    number: Ints


@dataclass(frozen=True, eq=False)
class Sighting:
    """A data set as its instrument observes the machine from where it stands.

    ``columns``: its nuisance parameters; ``sigma_joint`` (k,): noise of the joints, unit of q;
    ``sigma_gap`` (m,): standard uncertainty of closure gaps.
    """

    mechanism: Mechanism
    data: Dataset
    registration: Registration
    columns: NuisanceColumns
    sigma_joint: Array
    sigma_gap: Array

    @property
    def plain(self) -> bool:
        """Whether rows depend on their poses alone: no effects, no distances, no joint noise.

        Coordinates must also be uncorrelated. With surplus limbs, which contradict each other by
        the noise of joints or gaps, all joints or all gaps must have some.
        """
        data = self.data
        own_scale = data.scale.fitted or self.registration.scale != 1.0
        noisy = np.all(self.sigma_joint > 0.0) or np.all(self.sigma_gap > 0.0)
        sound = (bool(noisy) if self.mechanism.surplus
                 else not np.any(data.sigma_actuator > 0.0))
        return (sound and not self.mechanism.effects and data.kind.of_poses
                and data.covariance is None
                and not data.kind.along_line and not (data.kind.touches and own_scale))

    @property
    def open_columns(self) -> tuple[list[int], list[int]]:
        """The open parts of the registration, numbered, and their columns."""
        columns = self.columns
        parts: list[int] = []
        where: list[int] = []
        for own, names, first in ((columns.frame, columns.frame_parts, 0),
                                  (columns.target, columns.target_parts, TARGET),
                                  (columns.target_rotation, columns.turn_parts, TURN),
                                  (columns.scale, (0,), SCALE)):
            if own.stop > own.start:
                parts += [first + part for part in names]
                where += range(own.start, own.stop)
        return parts, where

    @property
    def tables(self) -> InstrumentTables:
        """The instrument at its station, as tables."""
        data, registration, motion = self.data, self.registration, self.mechanism.motion
        body = cga.motor_from_rotation_vector(registration.target_rotation, np.zeros(3))
        frame = registration.frame
        return InstrumentTables(
            np.concatenate([cga.rotation_matrix(frame).ravel(), cga.translation(frame)]),
            np.array(frame[:4]), np.array(body[:4]), np.asarray(registration.target, dtype=float),
            left_jacobian(registration.target_rotation).ravel(),
            np.asarray(self.columns.about, dtype=float),
            1.0 if data.kind.touches else float(registration.scale), motion.planar,
            np.array(coordinates(data, motion), dtype=np.int64),
            np.array(self.open_columns[0], dtype=np.int64))

    def likely(self, rows: Ints, pose: Array, tables: compiled_limbs.CompiledLimbs) -> LikelyRows:
        """Return some rows (n,), given their poses by joints alone (n, 8) and closure's tables."""
        from ppmcal.calibration.fit.compiled_surplus_rows import likely_rows

        mechanism = self.mechanism
        ratio = np.array([v.get("ratio", 1.0) for v in tables.closure.model.limb_values])
        noise = np.abs(ratio * self.sigma_joint[[limb.actuator for limb in mechanism.limbs]])
        u = np.ascontiguousarray(np.broadcast_to(tables.u, (rows.size, tables.u.shape[1])))
        seen, white, number = white_measurements(replace(self.data, weight=None), mechanism.motion,
                                                 rows)
        pose = np.array(pose)
        squares = likely_rows(tables.limbs, self.tables, noise, self.sigma_gap, u, pose, seen,
                              white, STEPS, ALONE * STILL * mechanism.length_scale, ROUND_OFF)
        return LikelyRows(noise, self.sigma_gap, u, pose, seen, white, squares,
                          number + mechanism.surplus)

    def likely_poses(self, rows: Ints, pose: Array, closure: Closure) -> Array | None:
        """Return the most likely poses (n, 8) of some rows (n,); None if NumPy is to find them."""
        if not compiled_limbs.pays(self.mechanism, rows.size) or not self.plain:
            return None
        tables = compiled_limbs.compiled_limbs(closure, rows.size)
        return None if tables is None else self.likely(rows, pose, tables).pose
