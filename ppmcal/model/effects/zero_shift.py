"""A joint's zero that moved in mid-run: homed anew, an encoder or a belt that slipped."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    STROKE,
    EffectKind,
    EffectParameter,
    ScanRange,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting

FEWEST = 3
"""Rows before and after an event."""
MOST = 60
"""Onsets that a search tries, evenly spread; the fit then moves to the row."""


def onsets(data: ScanRange) -> list[float]:
    """Return the rows from which on something may have happened."""
    rows = data.rows[FEWEST:len(data.rows) - FEWEST + 1]
    if len(rows) <= MOST:
        return list(rows)
    return [rows[i] for i in np.linspace(0, len(rows) - 1, MOST).astype(int)]


ONSET = EffectParameter("from_row", "1", None, low=0.0, constant=True, scan=onsets,
                        why="an event is in one row")


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = shift from the row on."""
    return linear(values, {"shift": setting.at_joints(setting.since(values["from_row"]), on)})


ZERO_SHIFT = register(EffectKind(
    "zero_shift", "du = shift from row from_row on, until the next",
    "ISO 230-2, zero point; homing repeatability",
    fixed_list(EffectParameter("shift", "joint", None, usual=(-0.2, 0.2), of_stroke=True,
                               why=STROKE), ONSET), ("row",), _terms, onset="from_row",
    remedy="home each joint again and go back to one reference pose",
    worked=Worked({"shift": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
