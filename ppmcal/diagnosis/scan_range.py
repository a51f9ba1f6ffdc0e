"""Summary of the data from which a search chooses the constants of a kind to try."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.diagnosis.linear_system import System
from ppmcal.model.effects import ScanRange


def scan_range(system: System) -> ScanRange:
    """Return stroke, joints, rows, loads, moves, times and speeds of a system's rows, SI.

    Moves and times are those of whole files; defaults apply if there are none.
    """
    rows = [p.response.rows for p in system.parts]
    numbers = np.unique(np.concatenate([r.row for r in rows]))
    pasts = list({id(r.history): r.history for r in rows if r.history is not None}.values())
    ratio = np.abs(system.parts[0].setting.ratio)
    moves = np.concatenate([(ratio * np.abs(np.diff(h.q, axis=0))).ravel() for h in pasts]
                           or [np.zeros(0)])
    times = [h.time for h in pasts if h.timed and h.time.size > 1]
    steps = np.concatenate([np.diff(t) for t in times] or [np.zeros(0)])
    speed = np.abs(np.concatenate([p.setting.velocity.ravel() for p in system.parts]))
    loads = [p.setting.load for p in system.parts]
    found = ScanRange(
        system.stroke or 1.0, np.unique(system.group).size, tuple(numbers.tolist()),
        max(float(np.max(np.abs(f[np.isfinite(f)]), initial=0.0)) for f in loads),
        moves=tuple(np.sort(moves[moves > 0.0]).tolist()),
        joints=frozenset(system.problem.mechanism.actuator_quantity))
    if (steps > 0.0).any():
        found = replace(found, step=float(np.median(steps[steps > 0.0])),
                        duration=max(float(np.ptp(t)) for t in times))
    if (speed > 0.0).any():
        found = replace(found, speed=float(np.median(speed[speed > 0.0])))
    return found
