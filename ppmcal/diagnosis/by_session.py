"""Effects that differ between sessions: present on one day only, or of a different size on each.

Their columns are split by session, so that each session has its own size.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ppmcal.diagnosis.hypotheses import Collector, Hypothesis
from ppmcal.diagnosis.linear_system import System
from ppmcal.linalg import Bools
from ppmcal.model.sessions import session_masks


def by_session(to: Collector) -> list[Hypothesis]:
    """Return versions with a size per session of the effects with one size and no grid.

    Except events, which belong to their session anyway, and effects that require another.
    """
    sessions = list(_sessions(to.system))
    if len(sessions) < 2:
        return []
    return [found for h in to.hypotheses
            if h.effect and not (h.scanned or h.effect.onset or h.requires or h.anonymous)
            and h.shared and (found := _cut(to, h, sessions)) is not None]


def _sessions(system: System) -> Iterator[tuple[str, Bools]]:
    """Yield each session and its rows of a system (N,)."""
    for label, masks in session_masks(system.problem.datasets):
        yield label, np.array([masks[d][n] for d, n in zip(
            system.dataset.tolist(), system.row.tolist(), strict=True)], dtype=bool)


def _cut(to: Collector, h: Hypothesis, sessions: list[tuple[str, Bools]]) -> Hypothesis | None:
    """Return an effect split by the sessions that show it; None if fewer than two do."""
    columns = [to.columns.value(c) for c in h.columns]
    seen = [(label, rows) for label, rows in sessions if any(c[rows].any() for c in columns)]
    if len(seen) < 2:
        return None
    count = len(seen)
    return replace(
        h, names=tuple(f"{label}:{n}" for label, _ in seen for n in h.names),
        low=h.low * count, high=h.high * count, usual=h.usual * count,
        starts=(), sessions=tuple(label for label, _ in seen),
        columns=tuple(to.columns.later(c, rows) for _, rows in seen for c in columns))
