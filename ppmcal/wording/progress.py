"""What is under way, and how far it is: said from any layer, shown by whoever watches.

Work says ``with stage("fitting")``, or ``start_stage("fitting")`` for one step after the other;
where nobody watches that costs a microsecond. Say it for each pass over the rows, never for each
row.

A time left is given only where there is a basis: equal steps some of which are done, or stages
whose shares of the whole were measured (:class:`course`), some of them over.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import ContextDecorator, contextmanager
from contextvars import ContextVar
from functools import wraps
from time import perf_counter
from types import TracebackType
from typing import ParamSpec, Self, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

BASIS = 0.5
"""Seconds of work behind a time left, at least."""
SHARE = 0.03
"""Part of all work behind a time left, at least."""
OVERDUE = 1.5
"""A stage that takes more than this times its share says nothing of what is left."""

SHORT = 5e-3
"""What takes no longer than this, s, is not worth a line."""

log = logging.getLogger("ppmcal")


class Watch:
    """Those stages that are under way, the outermost first.

    Attributes:
        stages: the open ones; another thread may read them.
        listen: called with a line of text when there is something new.
        shares: by name of a stage, those of its time that the stages within it take.
    """

    def __init__(self, listen: Callable[[str], None] | None = None,
                 shares: Mapping[str, Mapping[str, float]] | None = None) -> None:
        """Watch nothing yet."""
        self.stages: tuple[stage, ...] = ()
        self.listen = listen
        self.shares = shares or {}

    def line(self) -> str:
        """Return what is being done: on the whole, and at this moment."""
        names = [s.text for s in self.stages if s.text]
        return ": ".join(dict.fromkeys([*names[:1], *names[-1:]]))

    def left(self) -> float | None:
        """Return how many seconds are left, None where nobody can tell."""
        stages, now = self.stages, perf_counter()
        found: float | None = None
        for i in reversed(range(len(stages))):
            inner = stages[i + 1] if i + 1 < len(stages) else None
            found = stages[i].left(now, inner, found)
        return found

    def notify(self) -> None:
        """Say to the listener what is new."""
        if self.listen is not None:
            self.listen(self.line())


_WATCH: ContextVar[Watch | None] = ContextVar("watch", default=None)


class stage(ContextDecorator):
    """A part of the work, within the part that is under way.

    Args:
        name: what is done, such as ``fitting``; empty where only its steps matter.
        steps: how many equal steps it has, 0 where nobody knows.
        unit: what a step is, such as ``machines``.
    """

    def __init__(self, name: str, steps: int = 0, unit: str = "") -> None:
        """Describe it; it begins with the block."""
        self.shares: Mapping[str, float] = {}
        self.name, self.steps, self.unit = name, steps, unit
        self.text, self.taken = name, 0
        self.begun = self.last = 0.0
        self.sequential = False
        self.spent: dict[str, float] = {}
        self.repeated: dict[str, float] = {}
        self._watch: Watch | None = None

    def _recreate_cm(self) -> stage:
        return type(self)(self.name, self.steps, self.unit)

    def __enter__(self) -> Self:
        """Begin."""
        self._watch = _WATCH.get()
        if self._watch is not None:
            self.begun = self.last = perf_counter()
            if self.name in self._watch.shares:
                self.shares = self._watch.shares[self.name]
            self._watch.stages = (*self._watch.stages, self)
            if self.name:
                self._watch.notify()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """End it, and what began within and goes on."""
        watch = self._watch
        if watch is None or self not in watch.stages:
            return
        place = watch.stages.index(self)
        outer, within = watch.stages[:place], watch.stages[place + 1:]
        now = perf_counter()
        if kind is None:
            for inner, around in zip(reversed(within), reversed(watch.stages[place:-1]),
                                     strict=True):
                inner._over(around, now)
            self._over(outer[-1] if outer else None, now)
        watch.stages = outer

    def _over(self, around: stage | None, now: float) -> None:
        """Count its time, and log it."""
        if around is not None and self.name:
            took = now - self.begun
            if self.name in around.spent:
                around.repeated[self.name] = around.repeated.get(self.name, 0.0) + took
            around.spent[self.name] = around.spent.get(self.name, 0.0) + took
            if around.shares or took > SHORT:
                log.log(logging.INFO if around.shares else logging.DEBUG, "%s: %.2f s",
                        self.name, took)

    def done(self, steps: int = 1) -> None:
        """Say that so many steps are done."""
        if self._watch is None:
            return
        self.taken += steps
        self.last = perf_counter()
        if self.steps and self.unit:
            self.note(f"{self.taken} of {self.steps} {self.unit}")

    def note(self, text: str) -> None:
        """Say what is being done within it."""
        if self._watch is not None:
            self.text = f"{self.name}: {text}" if self.name else text
            self._watch.notify()

    def left(self, now: float, inner: stage | None, inner_left: float | None) -> float | None:
        """Return how many seconds it still takes, None where there is no basis.

        Args:
            now: the time, s.
            inner: the stage within it, if there is one.
            inner_left: what that one still takes, s.
        """
        if self.steps:
            return self._left_by_steps(now, inner_left)
        if self.shares:
            return self._left_by_shares(now, inner, inner_left)
        return inner_left if isinstance(inner, course) else None

    def _left_by_steps(self, now: float, inner_left: float | None) -> float | None:
        spent, rest = self.last - self.begun, self.steps - self.taken
        if inner_left is not None:    # of the step that is under way
            each = (now - self.begun + inner_left) / (self.taken + 1)
            return inner_left + each * (rest - 1)
        if not self.taken or spent < BASIS:
            return None
        return max(spent / self.taken * rest - (now - self.last), 0.0)

    def _left_by_shares(self, now: float, inner: stage | None, inner_left: float | None
                        ) -> float | None:
        name, running = ("", 0.0) if inner is None else (inner.name, now - inner.begun)
        order = list(self.shares)
        over = {n: t - self.repeated.get(n, 0.0) for n, t in self.spent.items()
                if n in self.shares}
        done, spent = sum(self.shares[n] for n in over), sum(over.values())
        place = max((order.index(n) for n in (*over, name) if n in self.shares), default=-1)
        rest = sum(self.shares[n] for n in order[place + 1:])
        if name in over:    # once more: as long as before
            share, expected = 0.0, over[name]
        else:
            share = self.shares.get(name, 0.0)
            expected = share * spent / done if done else 0.0
            if inner_left is not None and share:
                expected = running + inner_left
                done, spent = done + share, spent + expected
        if done < SHARE * sum(self.shares.values()) or min(spent, now - self.begun) < BASIS:
            return None
        if inner_left is None:
            if running > OVERDUE * expected + BASIS:
                return None
            inner_left = max(expected - running, 0.0)
        return inner_left + spent / done * rest


class course(stage):
    """All work of a command: stages whose shares of the time were measured.

    Args:
        shares: name of a stage -> its share; a stage that does not come takes its share with it
            when the next one is over.
    """

    def __init__(self, shares: Mapping[str, float]) -> None:
        """Expect these stages, in this order."""
        super().__init__("")
        self.shares = shares or {"": 1.0}


def start_stage(name: str) -> None:
    """Say what is done from now on, until the next ``start_stage`` or the outer stage's end."""
    watch = _WATCH.get()
    if watch is None:
        return
    end()
    new = stage(name)
    new.sequential = True
    new.__enter__()


def end() -> None:
    """Say that what began last is over."""
    watch = _WATCH.get()
    if watch is not None and watch.stages and watch.stages[-1].sequential:
        watch.stages[-1].__exit__(None, None, None)


def note(text: str) -> None:
    """Say a detail of what is under way, such as a figure of the last iteration."""
    watch = _WATCH.get()
    if watch is not None and watch.stages:
        watch.stages[-1].note(text)


@contextmanager
def watching(watch: Watch) -> Iterator[Watch]:
    """Let a watch see what is under way in the block."""
    token = _WATCH.set(watch)
    try:
        yield watch
    finally:
        _WATCH.reset(token)


def watched() -> Watch | None:
    """Return who watches, None where nobody does."""
    return _WATCH.get()


def no_progress(text: str) -> None:
    """Take progress and show nothing."""


def reports_progress(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function's argument ``progress`` hear what the layers below it say.

    What the function began last ends with it.
    """
    @wraps(function)
    def listening(*args: P.args, **kwargs: P.kwargs) -> R:
        progress = kwargs.get("progress", no_progress)
        if progress is not no_progress and callable(progress):
            with watching(Watch(progress)):
                return function(*args, **kwargs)
        found = function(*args, **kwargs)
        end()
        return found

    return listening
