"""Residuals row by row for plots: by joint, by coordinate, against inputs.

A row's residual r (measured minus predicted) becomes joint errors dq = J_q^+ r, with J_q the
derivative of the prediction by the joint coordinates, both in units of the stated noise: how much
further each joint is than the model predicts. If an instrument observes less than the joints can
move, dq is the smallest joint error that explains the row.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Fit, Rows, coordinates, coverage_by
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.linalg import Array, Bools, Ints, finite_rows, subsample
from ppmcal.model.dataset import REFERENCE_TEMPERATURE, ZERO_CELSIUS
from ppmcal.model.effects import Inputs
from ppmcal.model.mechanism import Mechanism

MOST_ROWS = 6000
"""Most rows in a plot, evenly spread."""
BINS, FEWEST = 16, 3
"""Most bins of a continuous input, and fewest rows in a bin."""


@dataclass(frozen=True, eq=False)
class ProfileErrors:
    """Errors of N rows after one fit: ``joint`` (N, k), ``sigma`` (N, k), ``measured`` (N, 6).

    ``sigma``: standard deviation of ``joint`` from the stated noise; ``measured``: the residual by
    coordinate x, y, z, rx, ry, rz, nan where not measured. SI.
    """

    joint: Array
    sigma: Array
    measured: Array


@dataclass(frozen=True, eq=False)
class Binned:
    """Means in bins of an input, with the half width of their 95 % intervals; SI.

    ``x``: mean input of each bin (B,); ``names``: of the bins if they are classes, otherwise empty;
    ``count``: of values.
    """

    x: Array
    names: tuple[str, ...]
    count: Ints
    before: Array
    before_half: Array
    after: Array
    after_half: Array


def gather(before: Fit, after: Fit, rows: Sequence[Bools]
           ) -> tuple[ProfileErrors, ProfileErrors, Inputs, Ints]:
    """Return errors without and with the effects, inputs, and a label per row, (N, ...).

    ``rows``: masks of the rows wanted, by data set.
    """
    keep = subsample([a & finite_rows(p) & finite_rows(q) for a, p, q in
                    zip(rows, before.state.poses, after.state.poses, strict=True)], MOST_ROWS)
    old, new = (list(f.problem.rows(f.state, True, keep)) for f in (before, after))
    mechanism = after.problem.mechanism
    errors = []
    for fit, chunks in ((before, old), (after, new)):
        parts = [_errors(fit, c) for c in chunks]
        errors.append(ProfileErrors(*(np.concatenate(p) for p in zip(*parts, strict=True))))
    inputs = Inputs(*(np.concatenate(p) for p in
                      zip(*(_inputs(c, mechanism) for c in new), strict=True)))
    return errors[0], errors[1], inputs, np.arange(len(inputs.time), dtype=np.int64)


def _errors(fit: Fit, rows: Rows) -> tuple[Array, Array, Array]:
    """Return joint errors, their sigma and residuals by coordinate of one chunk."""
    assert rows.response is not None
    mechanism = fit.problem.mechanism
    drive = np.zeros((*rows.residual.shape, len(mechanism.actuators)))
    for i, limb in enumerate(mechanism.limbs):
        for end in (rows.response, rows.second):
            if end is not None:
                drive[..., limb.actuator] += rows.whitened(end.by_slot(i, "offset"), [
                    c.response.by_slot(i, "offset") for c in rows.companions])
    back = linalg.pinv(drive, rcond=1e-6)
    joint = np.asarray((back @ np.where(rows.observed, rows.residual, 0.0)[..., None])[..., 0])
    measured = np.full((len(joint), 6), np.nan)
    data = fit.problem.datasets[rows.dataset]
    if rows.measured.shape[1] > 1:
        measured[:, list(coordinates(data, mechanism.motion))] = rows.measured
    return joint, np.asarray(np.sqrt(np.sum(back**2, axis=-1))), measured


def _inputs(rows: Rows, mechanism: Mechanism) -> tuple[Array, ...]:
    assert rows.response is not None
    at = rows.response.setting()
    return (at.travel, at.approach, at.velocity, at.load,
            at.temperature + REFERENCE_TEMPERATURE - ZERO_CELSIUS, at.wrench, at.time, at.row,
            pose_vector(rows.response.pose), rows.response.seen.points[0], at.move)


def binned(x: Array, before: Array, after: Array, row: Ints,
           name: Callable[[float], str] | None = None) -> Binned | None:
    """Return mean errors in bins of an input, None if there is nothing to draw.

    Args:
        x: input (V,), nan where not recorded.
        before: errors without the effects (V,).
        after: errors with the effects (V,).
        row: label of each value's measurement; values of one row are not independent.
        name: gives each value of ``x`` a name; each value is then a bin.
    """
    good = np.isfinite(x) & np.isfinite(before) & np.isfinite(after)
    x, before, after, row = x[good], before[good], after[good], row[good]
    if x.size < 2 * FEWEST or np.ptp(x) == 0.0:
        return None
    label = _labels(x, name is not None)
    bins = [b for b in np.unique(label)
            if np.unique(row[label == b]).size >= FEWEST]
    if len(bins) < 2:
        return None
    table = [_bin(label == b, x, before, after, row) for b in bins]
    columns = [np.array(c) for c in zip(*table, strict=True)]
    names = tuple(name(float(v)) for v in columns[0]) if name else ()
    return Binned(columns[0], names, columns[1].astype(np.int64), *columns[2:])


def _labels(x: Array, classes: bool) -> Ints:
    """Return the bin of each value: one per distinct value if few, otherwise by quantiles."""
    values, label = np.unique(np.round(x, 12), return_inverse=True)
    if classes or values.size <= 12:
        return np.asarray(label).reshape(-1).astype(np.int64)
    count = int(np.clip(x.size // 6, 4, BINS))
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, count + 1)))
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2).astype(np.int64)


def _bin(mine: Bools, x: Array, before: Array, after: Array, row: Ints) -> list[float]:
    out = [float(x[mine].mean()), float(mine.sum())]
    for values in (before, after):
        out += [float(values[mine].mean()), half_width(values[mine], row[mine])]
    return out


def half_width(values: Array, row: Ints) -> float:
    """Return half the 95 % interval of a mean of values, some of which share a row."""
    _, label = np.unique(row, return_inverse=True)
    sums = np.bincount(np.asarray(label).reshape(-1), weights=values - values.mean())
    rows = sums.size
    error = np.sqrt(np.sum(sums**2) * rows / (rows - 1)) / values.size
    return coverage_by(rows - 1) * float(error)
