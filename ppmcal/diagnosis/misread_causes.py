"""Files with a misinterpreted column, detected by the probabilities of causes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ppmcal.calibration.interpretation import (
    NOISE,
    FileFault,
    Interpretation,
    InterpretationError,
    with_line,
)
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.hypotheses import Hypothesis


def refuse_misread(last: Round) -> None:
    """Reject files with a misinterpreted column.

    Next to an unknown cause it may be only the appearance of that cause: nothing is certain until
    everything is explained.

    Raises:
        InterpretationError: with the column, its files, and the rows unless all are affected.
    """
    if any(p.sure and p.hypothesis is None for p in last.places):
        return
    found = [m for p in last.places if p.sure and p.only_misread and p.hypothesis is not None
             for m in _misreadings(last, p.hypothesis)]
    if found:
        raise InterpretationError.of(found, last.fit.problem.mechanism.units)


def _misreadings(last: Round, h: Hypothesis) -> list[Interpretation]:
    """Return how the columns of an effect are misread, for each file that has them."""
    system, mechanism = last.asked.system, last.fit.problem.mechanism
    effect = replace(h, misread="", follows="").label
    block, rows = None, tuple[int, ...]()
    if h.stretch:
        names = tuple(f"dir_{a}" for a in h.on or mechanism.actuators)
        at = slice(*h.stretch)
        files = np.unique(system.dataset[at])
        data = system.problem.datasets[int(files[0])]
        if system.row[at].size < np.count_nonzero(system.dataset == files[0]):
            begin, end = data.rows[system.row[at][[0, -1]]].tolist()
            rows = tuple(range(begin, end + 1))
        else:
            block = with_line(data, "signs", dict.fromkeys(names, -1))
        mistake = FileFault("sign", names, f"{h.follows}: {', '.join(names)} has the opposite sign "
                            f"to the other {'rows' if rows else 'files'}: once reversed, {effect} "
                            "explains all of them alike", rows)
    else:
        moved = last.asked.question.columns.some(h.columns).reshape(len(system.row), -1)
        files = np.unique(system.dataset[moved.any(axis=1)])
        mistake = FileFault("unit", (h.misread,), f"{h.misread}: {effect} would have an "
                            "implausible size")
    return [Interpretation(system.problem.datasets[i].source, (mistake,), block, NOISE, np.nan,
                           np.nan, np.nan) for i in files.tolist()]
