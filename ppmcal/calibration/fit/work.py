"""A bound on the work of a search that makes many fits, in steps: the same on every machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass
class Work:
    """Steps of fits that a search may still try; ``ended``: more were wanted than were left.

    ``within``: the enclosing bound; ``cut``: number of inner bounds that ran out.
    """

    most: int
    left: int
    ended: bool = False
    within: Work | None = None
    cut: int = 0


_WORK: ContextVar[Work | None] = ContextVar("work", default=None)


@contextmanager
def bounded(steps: int) -> Iterator[Work]:
    """Limit all fits inside to so many steps together; what is unfinished by then is abandoned.

    Steps inside nested bounds count for each of them.
    """
    within = _WORK.get()
    work = Work(steps, steps, within=within)
    token = _WORK.set(work)
    try:
        yield work
    finally:
        _WORK.reset(token)
        if within is not None:
            within.cut += work.ended or work.cut


def another_step() -> bool:
    """Count a step that a fit is about to try; return whether it may."""
    bounds = []
    work = _WORK.get()
    while work is not None:
        bounds.append(work)
        work = work.within
    for bound in reversed(bounds):
        if bound.left <= 0:
            bound.ended = True
            return False
    for bound in bounds:
        bound.left -= 1
    return True
