"""Common parts of events in mid-run: the row where they start, and pose steps from there on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ppmcal.linalg import Array
from ppmcal.model.effects.kind import EffectParameter, ScanRange, Terms, linear
from ppmcal.model.effects.setting import PLACE, Setting, Shift

FEWEST = 3
"""Fewest rows before and after an event."""
MOST = 150
"""Most onsets that a search tries, evenly spread; the fit then refines the row."""


def onsets(data: ScanRange) -> list[float]:
    """Return the rows at which an event may have started."""
    rows = data.rows[FEWEST:len(data.rows) - FEWEST + 1]
    if len(rows) <= MOST:
        return list(rows)
    return [rows[i] for i in np.linspace(0, len(rows) - 1, MOST).astype(int)]


ONSET = EffectParameter("from_row", "1", None, low=0.0, constant=True, scan=onsets,
                        why="an event starts at one row")


def step_parameters(coordinates: Sequence[str]) -> tuple[EffectParameter, ...]:
    """Return one step per coordinate, and the row."""
    return (*(EffectParameter(c, "angle" if c[0] == "r" else "length", size=1e-5)
              for c in coordinates), ONSET)


def stepped(setting: Setting, values: Mapping[str, float], place: Callable[[Array], Shift]
            ) -> Terms:
    """Return the terms of steps from a row on; ``place`` makes a shift of twists (N, 6)."""
    since = setting.since(values["from_row"])[:, 0]
    by = {}
    for name in values:
        if name in PLACE:
            step = np.zeros((since.size, 6))
            step[:, PLACE[name]] = since
            by[name] = place(step)
    return linear(values, by)
