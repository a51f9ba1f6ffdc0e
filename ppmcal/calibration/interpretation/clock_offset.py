"""The offset between two recorders' clocks, found from the motion that both recorded.

A point fixed to the platform is m = F (p + R b): for any frame F and target b its coordinates
are a linear function of the entries of p and R. So for each trial offset the measured
points are regressed on the nominal machine's poses at these times; at the true offset the
residuals are those of an uncalibrated machine, elsewhere those of one that stood somewhere else.
Several targets share F and p, and each has its own entries of R, unless its b is known.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.mechanism import Mechanism

FEWEST = 10
TRIALS = 4000
MOST_ROWS = 5000
"""Rows of a log at which poses are computed."""
INSIDE = 0.8
"""At least this part of the points must lie within the time of the log."""
CLEAR = 2.0
"""The next best offset must fit worse by this factor (rms)."""
FOLLOWS = 0.05
"""If residuals exceed this part of the points' spread, no offset fits."""


@dataclass(frozen=True)
class ClockOffset:
    """How far the points' clock is ahead of the log's, s, and its alternatives.

    ``low``, ``high``: the interval; ``next_best``: another offset, and how many times worse it
    fits (rms); ``rest``: residual rms over the points' spread.
    """

    value: float
    low: float
    high: float
    rest: float
    next_best: float = np.nan
    worse: float = np.inf

    def __str__(self) -> str:
        """Return a sentence."""
        text = (f"The points' clock is {abs(self.value):.3f} s "
                f"{'ahead of' if self.value >= 0.0 else 'behind'} the log's: found from the motion "
                f"({self.low:.3f} to {self.high:.3f} s fit as well")
        if np.isfinite(self.next_best):
            text += f"; the next best, {self.next_best:.3f} s, {self.worse:.2g} times worse"
        return text + ")."


@dataclass(frozen=True, eq=False)
class SeenTargets:
    """Which of K targets on the platform each of M points belongs to.

    Attributes:
        names: of the K targets.
        label: of each point, from 0 (M,).
        points: positions of the targets on the platform (K, 3), m; nan where unknown.
    """

    names: tuple[str, ...]
    label: Ints
    points: Array


def one_target(count: int) -> SeenTargets:
    """Return that all points belong to one target at an unknown position."""
    return SeenTargets(("",), np.zeros(count, dtype=np.int64), np.full((1, 3), np.nan))


def find_clock_offset(mechanism: Mechanism, times: Array, q: Array, seen_at: Array, seen: Array,
                      place: str, targets: SeenTargets | None = None) -> ClockOffset:
    """Return how far the points' clock is ahead of a joint log's.

    Args:
        mechanism: whose nominal geometry gives the platform's poses.
        times: of the log's N rows, s, ascending.
        q: joint values (N, k), SI.
        seen_at: times of M points, s, on their own clock.
        seen: points (M, 3), in any unit; nan where not measured.
        place: name of the points in messages.
        targets: the target of each point  [default: a single one at an unknown position].

    Raises:
        BadInput: too few points, a log shorter than their time, or no offset that is clearly best.
    """
    targets = one_target(len(seen)) if targets is None else targets
    axes = np.flatnonzero(np.isfinite(seen).any(axis=0))
    good = np.isfinite(seen_at) & finite_rows(seen[:, axes])
    seen, seen_at = seen[good][:, axes], seen_at[good]
    targets = replace(targets, label=targets.label[good])
    if len(seen) < FEWEST:
        raise BadInput(f"{len(seen)} points with a time are too few to find a clock's offset",
                       place, f"Give it, --clock-offset S, or {FEWEST} points")
    rows, poses = _poses(mechanism, times, q)
    if len(rows) < 2:
        raise BadInput("the joint log has no two rows with a time at which the machine can stand",
                       place, "Check units and order of the joints (ppmcal check)")
    late = float(np.quantile(seen_at, 0.5 + INSIDE / 2)) - rows[-1]
    early = float(np.quantile(seen_at, 0.5 - INSIDE / 2)) - rows[0]
    if not early > late:
        raise BadInput("the points were taken over a longer time than the joint log holds", place,
                       "Give the whole log")
    trial = _PoseRegression(rows, poses, seen_at, seen, targets)
    trials = np.linspace(late, early, TRIALS)
    rms = np.array([trial.rms(o) for o in trials])
    best = int(np.argmin(rms))
    step = trials[1] - trials[0]
    fine = np.linspace(trials[best] - 2 * step, trials[best] + 2 * step, 81)
    trials = np.concatenate([trials, fine])
    rms = np.concatenate([rms, [trial.rms(o) for o in fine]])
    order = np.argsort(trials, kind="stable")
    return _judged(trials[order], rms[order], trial, place)


def _judged(trials: Array, rms: Array, trial: _PoseRegression, place: str) -> ClockOffset:
    """Return the best trial and its alternatives; refuse one that is not clearly best."""
    best, spread = int(np.argmin(rms)), trial.spread
    if not rms[best] < FOLLOWS * spread:
        raise BadInput(f"no offset of the clocks makes the points{trial.of_targets} follow the "
                       f"machine (the residuals are {100 * rms[best] / spread:.2g} % of their "
                       f"spread)", place, trial.why)
    # 95 % by the likelihood ratio of one parameter
    alike = rms <= rms[best] * np.sqrt(1.0 + 3.84 / trial.freedom)
    low = high = best
    while low > 0 and alike[low - 1]:
        low -= 1
    while high < len(rms) - 1 and alike[high + 1]:
        high += 1
    inner = np.r_[False, (rms[1:-1] <= rms[:-2]) & (rms[1:-1] <= rms[2:]), False]
    value = 0.5 * float(trials[low] + trials[high])
    # steps of the log and of the trials cause ripples beside the best
    apart = max(5.0 * (trials[high] - trials[low]), 5.0 * trial.step)
    inner &= np.abs(trials - value) > apart
    other = np.flatnonzero(inner & np.isfinite(rms))
    found = ClockOffset(value, float(trials[low]), float(trials[high]), float(rms[best] / spread))
    if not other.size:
        return found
    rival = int(other[np.argmin(rms[other])])
    worse = float(rms[rival] / rms[best])
    if worse < CLEAR:
        raise BadInput(f"two offsets of the clocks fit almost alike: {value:.3f} s and "
                       f"{trials[rival]:.3f} s ({worse:.2g} times worse)", place,
                       "Give the one that is right, --clock-offset S, or join by name")
    return ClockOffset(value, found.low, found.high, found.rest, float(trials[rival]), worse)


def _poses(mechanism: Mechanism, times: Array, q: Array) -> tuple[Array, Array]:
    """Return some times of a log, ascending, and p and R of the nominal machine there (N, 12)."""
    good = np.flatnonzero(finite_rows(q) & np.isfinite(times))
    good = good[np.unique(np.linspace(0, len(good) - 1, MOST_ROWS).astype(int))]
    motors = reached_poses(Model(mechanism.nominal()), q[good]).pose
    whole = finite_rows(motors)
    motors, times = motors[whole], times[good[whole]]
    turn = cga.rotation_matrix(motors).reshape(-1, 9)
    return times, np.column_stack([cga.translation(motors), turn])


class _PoseRegression:
    """The regression of measured points on poses at shifted times.

    Attributes:
        needed: fewest points with which the rotation of every target at an unknown position can
            be followed, with a separate column for each entry of R that changes.
    """

    def __init__(self, times: Array, poses: Array, seen_at: Array, seen: Array,
                 targets: SeenTargets) -> None:
        """Prepare what all trials share."""
        self.times, self.poses, self.seen_at, self.seen = times, poses, seen_at, seen
        self.step = max(float(np.median(np.diff(times))),
                        (np.ptp(times) - np.ptp(seen_at)) / TRIALS)
        self.names = targets.names
        known = finite_rows(targets.points)
        self.known = known[targets.label]
        self.place = np.where(known[:, None], targets.points, 0.0)[targets.label]
        each = (targets.label[:, None] == np.flatnonzero(~known)).astype(float)
        self.each = each[:, each.any(axis=0)]
        constants = self.each.shape[1] + bool(self.known.any())
        entries = np.flatnonzero(np.ptp(poses[:, 3:], axis=0) > 1e-9)
        most = constants + 3 + self.each.shape[1] * len(entries)
        self.needed = 2 * most + FEWEST if len(self.names) == 1 else most + 2 * FEWEST
        self.followed = len(seen) >= self.needed
        self.entries = 3 + (entries if self.followed else entries[:0])
        self.columns = most if self.followed else constants + 3
        self.freedom = max(len(seen) - self.columns, 1)
        middle = np.stack([seen[targets.label == k].mean(axis=0) if (targets.label == k).any()
                           else np.zeros(seen.shape[1]) for k in range(len(self.names))])
        self.spread = float(np.sqrt(np.mean((seen - middle[targets.label]) ** 2)))

    @property
    def of_targets(self) -> str:
        """The targets of the points, if there are several."""
        return f" of the targets {', '.join(self.names[:4])}" if len(self.names) > 1 else ""

    @property
    def why(self) -> str:
        """What the user can do if nothing fits."""
        give = "; or give the offset, --clock-offset S"
        if not self.followed:
            return (f"{len(self.seen)} points do not tell how their positions on the platform turn "
                    f"with it: measure {self.needed} or more, or write where the targets are, "
                    f"read.targets{give}")
        one = ("that each target is one point of the platform" if len(self.names) > 1 else
               "that all points are of one target on the platform (else say how they are named, "
               "--names)")
        return (f"Check that log and points are of one run, {one}, and the machine (ppmcal check)"
                f"{give}")

    def _design(self, inside: Bools, at: Array) -> Array:
        """Return the columns of the regression at times of the log (m, c)."""
        i = np.clip(np.searchsorted(self.times, at) - 1, 0, len(self.times) - 2)
        width = self.times[i + 1] - self.times[i]
        part = (np.where(width > 0.0, (at - self.times[i]) / np.where(width > 0, width, 1.0), 0.0)
                )[:, None]
        poses = self.poses[i] * (1.0 - part) + self.poses[i + 1] * part
        p = poses[:, :3] + np.einsum("mij,mj->mi", poses[:, 3:].reshape(-1, 3, 3),
                                     self.place[inside])
        each, known = self.each[inside], self.known[inside, None].astype(float)
        turned = each[:, :, None] * poses[:, None, self.entries]
        return np.column_stack([each, known, p, turned.reshape(len(at), -1)])

    def rms(self, offset: float) -> float:
        """Return the residuals' rms, corrected for degrees of freedom; inf with too few points."""
        at = self.seen_at - offset
        inside = (at >= self.times[0]) & (at <= self.times[-1])
        if inside.sum() < max(INSIDE * len(at) - 1, self.columns + 2):
            return np.inf
        seen = self.seen[inside]
        left, values, _ = linalg.svd(self._design(inside, at[inside]))
        left = left[:, values > 1e-9 * values[0]]
        rest = seen - left @ (left.T @ seen)
        return float(np.sqrt(np.sum(rest ** 2) / seen.shape[1] / (len(seen) - left.shape[1])))
