"""What a run says on standard error while it works: a line of progress, and ``-v``.

The line is there at a terminal only, and gone before anything else is printed.
"""

from __future__ import annotations

import logging
import math
import os
import re
import sys
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from contextvars import ContextVar
from time import perf_counter

from ppmcal import __version__
from ppmcal.cli import streams
from ppmcal.errors import printable
from ppmcal.wording.progress import Watch, course, watched, watching
from ppmcal.wording.told import WIDTH

EVERY = 0.25
"""Seconds between two drawings."""
FIRST = 0.5
"""Seconds before the first one: what is over by then needs no line."""
INDENT = 10
GLUE = "\ue000"
"""Stands for a space at which no line ends."""
BESIDE_UNIT = re.compile(
    r"(?<=\d) (?=(?:mm|um|m|in|deg|rad|N|kg|s|h|min|K)\b|%|1/|\+-)|(?<=\d N) (?=m\b)"
    r"|(?<=\b[xyz]) (?=[-+\d])|(?<=\br[xyz]) (?=[-+\d])|(?<=\+-) (?=\d)")
"""Where no line ends: between a number and its unit, its coordinate or its uncertainty."""
FIT = {"looking for gross errors": 0.6, "fitting some of the rows": 0.3, "coming near": 0.4,
       "fitting all rows": 1.5, "judging each row": 0.5}
INNER: Mapping[str, Mapping[str, float]] = {
    "fitting": FIT,
    "judging the fit": {
        "explaining gross errors": 0.01, "widening intervals where rows disagree": 0.8,
        "registering the nominal machine": 2.4, "predicting each session": 2.4,
        "predicting held-out poses": 2.4, "what the data leave open": 0.02,
        "where the machine is another": 0.4},
    "finding commands": {
        "inverse kinematics": 4.0, "predicting errors without correction": 4.4,
        "predicting errors with correction": 0.5, "how sure they are": 2.9},
    "registering the nominal machine": {
        "looking for gross errors": 0.5, "fitting all rows": 0.5, "judging each row": 1.4},
    "predicting held-out poses": {
        "looking for gross errors": 0.6, "fitting all rows": 1.2, "judging each row": 0.5},
}
"""Of stages that several commands have, the share of its time that each stage within takes.

The time left is reckoned from these, and from what each command says of its own stages: CPU seconds
of runs that are long enough to show a time left, on one core of an ordinary server; only their
proportions count. ``ppmcal COMMAND -v`` prints those of a run.
"""
LEVELS = (logging.WARNING, logging.INFO, logging.DEBUG)
log = logging.getLogger("ppmcal")


class ProgressLine:
    """One line on standard error: what is being done, and how long it will still take."""

    def __init__(self, watch: Watch) -> None:
        """Show what ``watch`` sees, between :meth:`start` and :meth:`stop`."""
        self.watch = watch
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._begun = perf_counter()
        self._thread = threading.Thread(target=self._run, name="progress", daemon=True)

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def stop(self) -> None:
        """Draw no more, and leave a clean line."""
        self._stop.set()
        with self._lock:
            self._clear()

    @contextmanager
    def aside(self) -> Iterator[None]:
        """Take the line away while something else is printed."""
        with self._lock:
            self._clear()
            yield

    def text(self) -> str:
        """Return the line, at most as wide as the terminal; empty where nothing is under way."""
        what = self.watch.line()
        if not what:
            return ""
        left = self.watch.left()
        gone = perf_counter() - self._begun
        end = f"  {duration(gone)} so far" if left is None else f"  about {duration(left)} left"
        return shortened(printable(what), terminal_width() - 1 - len(end)) + end

    def _run(self) -> None:
        while not self._stop.wait(EVERY):
            if perf_counter() - self._begun < FIRST:
                continue
            with self._lock:
                if self._stop.is_set():
                    return
                text = self.text()
                if text:
                    streams.line_shown = True
                    _write(f"{streams.CLEAR}{text}")
                else:
                    self._clear()

    def _clear(self) -> None:
        if streams.line_shown:
            _write(streams.CLEAR)
            streams.line_shown = False


def _write(text: str) -> None:
    sys.stderr.write(text)
    sys.stderr.flush()


def terminal_width() -> int:
    """Return how wide lines may be: as the terminal, at most 80 columns."""
    try:
        found = os.get_terminal_size(sys.stderr.fileno()).columns
    except (OSError, ValueError):
        found = 0
    return min(found or WIDTH, WIDTH)


def wrapped(text: str, whole: Iterable[str] = ()) -> str:
    """Return lines of at most 80 columns; what can be copied, such as a path, stays in one piece.

    Args:
        text: one or several lines; those that fit stay as they are.
        whole: what else is never broken, such as paths with spaces in them.
    """
    return "\n".join(_wrapped(line, whole) for line in text.split("\n"))


def _wrapped(line: str, whole: Iterable[str]) -> str:
    if len(line) <= WIDTH:
        return line
    import textwrap

    for words in sorted(filter(lambda w: " " in w, whole), key=len, reverse=True):
        line = line.replace(words, words.replace(" ", GLUE))
    line = BESIDE_UNIT.sub(GLUE, line)
    lines = textwrap.wrap(line, WIDTH, break_long_words=False, break_on_hyphens=False,
                          drop_whitespace=True, replace_whitespace=False, expand_tabs=False)
    return "\n".join(lines).replace(GLUE, " ")


def shortened(text: str, width: int) -> str:
    """Return text of at most so many columns, cut in the middle."""
    from rich.cells import cell_len, set_cell_size

    if cell_len(text) <= width:
        return text
    if width < 8:
        return ""
    head = (width - 1) // 2
    tail = text[-(width - 1 - head):]
    return set_cell_size(f"{set_cell_size(text, head)}…{tail}", width).rstrip()


def duration(seconds: float) -> str:
    """Return ``12 s``, ``3 min``, ``2.5 h``: no finer than anybody can know."""
    if seconds < 100.0:
        return f"{max(math.ceil(seconds), 1)} s"
    if seconds < 5400.0:
        return f"{seconds / 60.0:.0f} min"
    return f"{seconds / 3600.0:.1f} h"


_LINE: ContextVar[ProgressLine | None] = ContextVar("line", default=None)


def aside() -> AbstractContextManager[None]:
    """Take the line of progress away, if there is one, while something else is printed."""
    line = _LINE.get()
    return nullcontext() if line is None else line.aside()


class Remarks(logging.Handler):
    """Prints what the layers below say of their decisions, with the time since the start."""

    def __init__(self) -> None:
        """Begin to count."""
        super().__init__()
        self._begun = perf_counter()

    def emit(self, record: logging.LogRecord) -> None:
        """Print one remark, wrapped at 80 columns."""
        import textwrap

        part = record.name.removeprefix("ppmcal").lstrip(".")
        head = f"{perf_counter() - self._begun:7.2f} s "
        text = (f"{part}: " if part else "") + printable(record.getMessage())
        lines = textwrap.wrap(text, WIDTH - INDENT, break_on_hyphens=False) or [""]
        with aside():
            _write(head + ("\n" + " " * INDENT).join(lines) + "\n")


@contextmanager
def remarks(verbose: int) -> Iterator[None]:
    """Print remarks of the layers below: with 1 their decisions, with 2 each iteration too."""
    if not verbose:
        yield
        return
    import importlib.metadata
    import platform

    handler, level = Remarks(), log.level
    log.addHandler(handler)
    log.setLevel(LEVELS[min(verbose, 2)])
    try:
        packages = ", ".join(f"{name} {importlib.metadata.version(name)}"
                             for name in ("numpy", "scipy", "numba"))
        log.info("ppmcal %s, Python %s, %s", __version__, platform.python_version(), packages)
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


@contextmanager
def shown(shares: Mapping[str, float], quiet: bool) -> Iterator[None]:
    """Show how far a command is, at a terminal; within another command, as a part of that.

    Args:
        shares: of the command's stages of its time.
        quiet: show nothing.
    """
    with ExitStack() as stack:
        if watched() is None:
            watch = stack.enter_context(watching(Watch(shares=INNER)))
            if not quiet and sys.stderr.isatty() and os.environ.get("TERM") != "dumb":
                line = ProgressLine(watch)
                stack.callback(_LINE.reset, _LINE.set(line))
                stack.callback(line.stop)
                line.start()
        stack.enter_context(course(shares))
        yield
