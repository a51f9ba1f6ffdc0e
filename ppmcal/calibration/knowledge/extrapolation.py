"""What a calibration measured, and targets beyond it.

The ranges of a fit's rows, its noise check and how it ended are kept in the machine's file. Targets
far outside these ranges are refused, those a little outside are reported.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ppmcal.calibration.fit import Fit, Noise
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.rotations import vector_like
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import WRENCH, ZERO_CELSIUS
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import NOTE, Note
from ppmcal.wording import pluralize

FAR_OUTSIDE = 0.5
"""Refused: farther outside the measured range than this part of the widest measured range, of any
direction or of any axis: a bed that was touched is known as far above it as to its sides."""
OUTSIDE = 0.1
"""Reported: farther outside than this part of the range itself."""
STILL = 1e-3
"""Validity around a single measured value, relative to the reach or a radian; for temperature and
time a kelvin and a second, for loads :data:`OUTSIDE` of the load."""
Ranges = Mapping[str, tuple[float, float]]
CONDITIONS = {"temperature": (1.0, "C", ZERO_CELSIUS), "payload": (1.0, "kg", 0.0),
              "time": (1.0, "s", 0.0), **dict.fromkeys(WRENCH[:3], (1.0, "N", 0.0)),
              **dict.fromkeys(WRENCH[3:], (1.0, "N.m", 0.0))}
"""SI value of the displayed unit, the unit, and the SI value of its zero."""


def from_home(mechanism: Mechanism, full: Array) -> Array:
    """Return platform poses (N, 6) with rotation vectors near home's, without sign flips."""
    return np.concatenate([full[:, :3], vector_like(full[:, 3:], mechanism.home_pose[3:])], axis=1)


def _beyond(mechanism: Mechanism, ranges: Ranges, name: str, values: Array, more: float
            ) -> tuple[Array, Bools]:
    """Return how far values (N,) are outside the measured range, and where by ``more``, SI."""
    low, high = ranges[name]
    beyond = np.fmax(low - values, values - high)
    with np.errstate(invalid="ignore"):
        return beyond, beyond > more + _still(mechanism, name, low, high)


def _widest(mechanism: Mechanism, ranges: Ranges, name: str) -> float:
    """Return the widest measured range of a length, or of an angle, like ``name``, SI."""
    return max(high - low for own, (low, high) in ranges.items()
               if own in mechanism.coordinates and own.startswith("r") == name.startswith("r"))


def far_outside(mechanism: Mechanism, full: Array, ranges: Ranges) -> Iterator[tuple[int, str]]:
    """Yield the platform poses (N, 6), m and rad, far outside the measured range, and why."""
    full = from_home(mechanism, full)
    for c, name in zip(mechanism.dof, mechanism.coordinates, strict=True):
        if name not in ranges:
            continue
        factor, unit = _shown(mechanism, name)
        low, high = ranges[name]
        far = _beyond(mechanism, ranges, name, full[:, c],
                      FAR_OUTSIDE * _widest(mechanism, ranges, name))[1]
        for n in np.flatnonzero(far).tolist():
            yield n, (f"far outside the measured volume: {name} = {full[n, c] / factor:.6g} "
                      f"{unit}, measured {low / factor:.6g} to {high / factor:.6g}")


def extrapolated(mechanism: Mechanism, full: Array, good: Bools, ranges: Ranges,
                 columns: Mapping[str, Array]) -> Iterator[Note]:
    """Yield by how much commands exceed the measured range, column by column.

    Args:
        mechanism: the machine.
        full: platform poses (N, 6) in the base frame.
        good: rows that have a command (N,).
        ranges: measured ranges, by column, SI.
        columns: conditions of the rows, SI; they count if the machine has effects.
    """
    own = from_home(mechanism, full)
    asked = {POSE_COORDINATES[c]: own[:, c] for c in mechanism.dof}
    if mechanism.effects:
        asked |= {name: columns[name] for name in CONDITIONS if name in columns}
    for name, values in asked.items():
        if name not in ranges or not good.any():
            continue
        low, high = ranges[name]
        beyond, far = _beyond(mechanism, ranges, name, np.where(good, values, np.nan),
                              OUTSIDE * (high - low))
        if far.any():
            factor, unit = _shown(mechanism, name)
            zero = CONDITIONS[name][2] if name in CONDITIONS else 0.0
            yield Note(f"{pluralize(int(far.sum()), 'row')} outside the measured range: {name} "
                       f"up to {float(np.nanmax(beyond)) / factor:.4g} {unit} beyond "
                       f"{(low - zero) / factor:.6g} to {(high - zero) / factor:.6g}; there they "
                       "rest on the tolerances and the form of the model, as the uncertainty shows",
                        NOTE, "extrapolation")


def measured_ranges(mechanism: Mechanism, volume: Ranges | None) -> Ranges:
    """Return the measured ranges: from the machine's file, else the ``volume`` beside it."""
    seen = mechanism.measured or MeasurementBasis()
    return {**(volume or {}), **seen.ranges}


def _still(mechanism: Mechanism, name: str, low: float, high: float) -> float:
    """Return how far around a single measured value it is still valid, SI."""
    if name in ("payload", *WRENCH):    # grams are much for a small stage, tons little for a press
        return OUTSIDE * max(low, -high, 0.0)
    if name in CONDITIONS:
        return 1.0
    return STILL * (1.0 if name.startswith("r") else mechanism.reach)


def _shown(mechanism: Mechanism, name: str) -> tuple[float, str]:
    """Return SI value and name of the unit of a column."""
    if name in CONDITIONS:
        return CONDITIONS[name][:2]
    quantity = "angle" if name.startswith("r") else "length"
    return mechanism.units.factor(quantity), mechanism.units.name(quantity)


def measured_by(fit: Fit, noise: Noise) -> MeasurementBasis:
    """Return the noise check of a fit, the ranges of the rows that it used, SI, and how it ended.

    With the ranges of an earlier calibration that it continues, from the machine's file.
    """
    found: dict[str, list[Array]] = {}
    mechanism = fit.problem.mechanism
    if fit.problem.earlier is not None and mechanism.measured is not None:
        found = {name: [np.array(ends)] for name, ends in mechanism.measured.ranges.items()}
    for data, state, kept in zip(fit.problem.datasets, fit.state.poses, fit.keep, strict=True):
        # a distance has two platform positions
        full = from_home(mechanism, pose_vector(state[kept].reshape(-1, 8)))
        for c in mechanism.dof:
            found.setdefault(POSE_COORDINATES[c], []).append(full[:, c])
        joints = [data.q[kept], *([] if data.to_q is None else [data.to_q[kept]])]
        for a, name in enumerate(mechanism.actuators):
            found.setdefault(f"q_{name}", []).extend(q[:, a] for q in joints)
        for name in CONDITIONS:
            if name in data.columns:
                found.setdefault(name, []).append(data.columns[name][kept])
    ranges = {}
    for name, parts in found.items():
        values = np.concatenate(parts)
        values = values[np.isfinite(values)]
        if values.size:
            ranges[name] = (float(values.min()), float(values.max()))
    return MeasurementBasis(noise.sigma_ratio, noise.chi2_p, ranges, fit.ended)
