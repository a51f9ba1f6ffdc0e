"""A bound on the work of a search that makes many fits, in steps: the same on every machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass


@dataclass
class Work:
    """Steps of fits that a search may still try; ``ended``: more were wanted than there were."""

    most: int
    left: int
    ended: bool = False


_WORK: ContextVar[Work | None] = ContextVar("work", default=None)


@contextmanager
def bounded(steps: int) -> Iterator[Work]:
    """Let all fits inside try so many steps together; what is not done by then is given up."""
    work = Work(steps, steps)
    token = _WORK.set(work)
    try:
        yield work
    finally:
        _WORK.reset(token)


def another_step() -> bool:
    """Count a step that a fit is about to try; whether it may."""
    work = _WORK.get()
    if work is None:
        return True
    if work.left <= 0:
        work.ended = True
        return False
    work.left -= 1
    return True
