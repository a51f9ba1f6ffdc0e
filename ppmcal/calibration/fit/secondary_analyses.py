"""Analyses reported beside a result: one that fails is left out, with a note."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import TypeVar

from ppmcal.errors import PpmcalError
from ppmcal.linalg import LinAlgError
from ppmcal.notes import Note

T = TypeVar("T")
S = TypeVar("S")
log = logging.getLogger(__package__)
LEFT_OUT = "left out"
"""Topic of a note on an analysis that was left out."""
FAILURES = (PpmcalError, ArithmeticError, ValueError, LinAlgError)
"""Failures of an analysis that data can cause; ValueError: numbers that a library rejects.

Anything else is a fault of the program.
"""


def left_out_note(what: str) -> Note:
    """Return the note that an analysis was left out; ``what``: its name and why."""
    return Note(f"{LEFT_OUT}: {what}", topic=LEFT_OUT)


def secondary(what: str, make: Callable[[], T], instead: S, notes: list[Note]) -> T | S:
    """Return the result of a secondary analysis; if it fails, ``instead``, with a note.

    Args:
        what: the analysis, as users know it.
        make: the analysis.
        instead: the value for nothing found.
        notes: where the note is added.
    """
    try:
        return make()
    except FAILURES as error:
        log.info("%s is left out", what, exc_info=True)
        reason = error.what if isinstance(error, PpmcalError) else str(error)
        reason = reason or type(error).__name__
        # failures of linear algebra may already start with the name of the analysis
        notes.append(left_out_note(reason if reason.startswith(what) else f"{what} ({reason})"))
        return instead


def pictures_beside(makers: Mapping[str, Callable[[], T]]) -> dict[str, T]:
    """Return the pictures beside a result, by file; one that cannot be drawn is left out.

    By then the result is made and takes no more notes: a warning reports it.
    """
    notes = list[Note]()
    found = {name: secondary(f"the picture {name}", make, None, notes)
             for name, make in makers.items()}
    for line in notes:
        log.warning("%s", line)
    return {name: made for name, made in found.items() if made is not None}
