"""Hypotheses that these files cannot show: they move no reading, or as each file's unknowns do.

A step of the base with the first row of a file is in the frame of that file, a step of a target
after its last row in nothing. Values are as likely with such a block as without, whatever they are:
its prior would be its probability, and nothing less probable for each more of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.diagnosis.hypotheses import AS_ROUND_OFF, Hypothesis, Library, Untestable
from ppmcal.diagnosis.linear_system import System, range_basis
from ppmcal.inference.blocks import CHUNK
from ppmcal.linalg import Bools

BETWEEN = "between sessions"
TAKEN_UP = "the unknown frame, target or homing of each file would take it up"
NOTHING = "to first order it changes no reading here"


def testable(library: Library, system: System) -> Library:
    """Return a library without what moves no reading, or only as frames, targets or homing do.

    These are as good as free, so that nothing is left of it but round-off.
    """
    gone, nothing = _absorbed(library, system)
    if not gone.any():
        return library

    def seen(some: Sequence[Hypothesis]) -> tuple[Hypothesis, ...]:
        return tuple(h for h in some if not gone[list(h.columns)].all())

    left = seen(library.hypotheses)
    lost = {_in_words(h): NOTHING if nothing[list(h.columns)].all() else TAKEN_UP
            for h in library.hypotheses}
    for h in left:
        lost.pop(_in_words(h), None)
    return replace(library, hypotheses=left, misread=seen(library.misread), untestable=(
        *library.untestable, *(Untestable(kind, (), why) for kind, why in lost.items())))


def _in_words(h: Hypothesis) -> str:
    """Return a kind, whichever of the joints, targets and sessions."""
    return f"{h.kind} {BETWEEN}" if h.begins else h.family


def _absorbed(library: Library, system: System) -> tuple[Bools, Bools]:
    """Return which columns of a library (T,) each file's unknowns absorb, and which are zero."""
    size = system.observed.size
    free = system.jacobian[..., len(system.problem.free):] * system.observed[..., None]
    basis = range_basis(free.reshape(size, -1))
    gone, nothing = np.zeros((2, library.count), dtype=bool)
    for begin in range(0, library.count, CHUNK):
        some = range(begin, min(begin + CHUNK, library.count))
        columns = (library.some(some) * system.observed[..., None]).reshape(size, -1)
        left = columns - basis @ (basis.T @ columns)
        whole, rest = (np.linalg.norm(c, axis=0) for c in (columns, left))
        gone[some.start:some.stop] = rest <= AS_ROUND_OFF * whole
        nothing[some.start:some.stop] = whole == 0.0
    return gone, nothing
