"""What temperature does to z, and why Klipper's ``[z_thermal_adjust]`` does not hold it on a delta.

The section adds -temp_coeff (T - T at homing) to z, T smoothed over ``smooth_time``; but when it
connects it looks for a stepper called ``stepper_z`` (Klipper: ``z_thermal_adjust.py``), which
neither kind of delta has, and the firmware does not start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.delta.geometry import MM
from ppmcal.controllers.pose_grid import rest_columns
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note


def thermal_notes(mechanism: Mechanism, poses: Array | None) -> Iterator[Note]:
    """Yield how far each kelvin lifts the nozzle over poses (N, 6), where an effect says so."""
    own = tuple(e for e in mechanism.effects
                if "temperature" in e.kind.needs and not e.kind.instrument)
    if not own or poses is None:
        return
    rise = lifts(replace(mechanism, effects=own), poses) / MM
    if not rise.size:
        return
    names = ", ".join(dict.fromkeys(e.kind.name for e in own))
    yield Note(
        f"{names}: the nozzle rises by {rise.mean():.4g} mm in z per kelvin, from {rise.min():.4g} "
        f"to {rise.max():.4g} over the bed. temp_coeff: {rise.mean():.6f} in [z_thermal_adjust] "
        "would undo the mean, but that section asks for a stepper_z, and Klipper does not start "
        "with it on a delta: it is not written. SET_GCODE_OFFSET Z does the same by hand", NOTE)


def lifts(mechanism: Mechanism, poses: Array) -> Array:
    """Return how far one kelvin lifts the platform at poses (N, 6), at rest: (n,), m."""
    q = inverse_partial(Model(replace(mechanism, effects=())), poses).q
    q = q[finite_rows(q)]
    rest = rest_columns(mechanism, len(q))
    z = [cga.translation(reached_poses(Model(mechanism), q, environment(
        {**rest, "temperature": rest["temperature"] + by}, mechanism.actuators, mechanism.gravity,
        np.zeros_like(q))).pose)[:, 2] for by in (0.0, 1.0)]
    rise = z[1] - z[0]
    return np.asarray(rise[np.isfinite(rise)])
