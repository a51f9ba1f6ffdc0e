"""What is reported beside a result: an analysis that fails is left out, and a note says so."""

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
"""The topic of a note on an analysis that is not there."""
FAILURES = (PpmcalError, ArithmeticError, ValueError, LinAlgError)
"""What data can make of an analysis, ValueError: numbers that a library does not take.

Anything else is a fault of the program.
"""


def left_out_note(what: str) -> Note:
    """Return the note that an analysis is not there; ``what``: its name and why."""
    return Note(f"{LEFT_OUT}: {what}", topic=LEFT_OUT)


def secondary(what: str, make: Callable[[], T], instead: S, notes: list[Note]) -> T | S:
    """Return what an analysis beside a result gives; where it fails, ``instead``, and note it.

    Args:
        what: the analysis, as it is named to a user.
        make: the analysis.
        instead: what counts as nothing found.
        notes: to which the note is added.
    """
    try:
        return make()
    except FAILURES as error:
        log.info("%s is left out", what, exc_info=True)
        reason = error.what if isinstance(error, PpmcalError) else str(error)
        reason = reason or type(error).__name__
        # what linear algebra could not give is called by the same name
        notes.append(left_out_note(reason if reason.startswith(what) else f"{what} ({reason})"))
        return instead


def pictures_beside(makers: Mapping[str, Callable[[], T]]) -> dict[str, T]:
    """Return pictures beside a result, by file; one that cannot be drawn is left out.

    The result is made by then and takes no note any more: a warning says it.
    """
    notes = list[Note]()
    found = {name: secondary(f"the picture {name}", make, None, notes)
             for name, make in makers.items()}
    for line in notes:
        log.warning("%s", line)
    return {name: made for name, made in found.items() if made is not None}
