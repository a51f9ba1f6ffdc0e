"""One family of errors: what is wrong, where it is, and how to correct it.

Every error that the program raises is a :class:`PpmcalError`; the command line turns it into one
message and an exit code. Code that looks something up by name uses :func:`unknown`, so that every
message lists the allowed names and the nearest match. Code that a signal must not interrupt, such
as taking a lock and recording it, runs in :func:`uninterrupted`; code that a signal may interrupt
but that must still clean up runs in :func:`cleaned_up`.
"""

from __future__ import annotations

import contextlib
import difflib
import signal
import threading
from collections.abc import Collection, Iterable, Iterator

LONGEST = 4000
"""Maximum characters of each part of a message; a longer part loses its middle."""


class PpmcalError(Exception):
    """Base of all errors that a user can cause or encounter.

    Args:
        what: the problem, one sentence.
        where: file and place in it (``bench.yaml: limbs.leg1.base``), empty if none.
        hint: what to do about it, one sentence; empty if ``what`` makes it obvious.
    """

    exit_code = 2

    def __init__(self, what: str, where: str = "", hint: str = "") -> None:
        """Store the three parts; ``str(error)`` joins them into one message."""
        self.what, self.where, self.hint = map(_shown, (what, where, hint))
        what, where, hint = self.what, self.where, self.hint
        parts = [f"{where}: {what}" if where else what]
        if hint:
            parts.append(hint)
        super().__init__(" ".join(p if p.endswith((".", "?", "!")) else p + "." for p in parts))

    def at(self, where: str) -> PpmcalError:
        """Return the same error with ``where`` put in front of its place."""
        place = f"{where}: {self.where}" if self.where else where
        return type(self)(self.what, place, self.hint)


def _shown(text: str) -> str:
    """Return a part of a message in printable form, a long one without its middle."""
    if len(text) > LONGEST:
        text = f"{text[:LONGEST // 2]} ... {text[-LONGEST // 2:]}"
    return printable(text)


def printable(text: str, raw: bool = False) -> str:
    """Return text that is safe to print: names from files may contain anything.

    Control characters would act on the terminal; lone surrogates cannot be encoded. ``raw`` keeps
    surrogates that stand for bytes of a file name, for streams that can write them.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\xa0" or (raw and "\udc80" <= c <= "\udcff")
                   else c.encode("unicode_escape").decode("ascii") for c in text)


class BadInput(PpmcalError):
    """A file, an option or a value that cannot be used (exit code 2)."""


class NoResult(PpmcalError):
    """The result could not be computed: singular or not converged (exit code 3)."""

    exit_code = 3


class LinearAlgebraError(NoResult):
    """A linear system or decomposition that could not be computed (exit code 3).

    Raised only in :mod:`ppmcal.linalg`: no other module calls a solver.
    """


def unknown(what: str, name: object, allowed: Iterable[object], where: str = "") -> BadInput:
    """Return the error for a name that is not in ``allowed``, with the nearest match."""
    names = [str(a) for a in allowed]
    near = [n for n in names if n.lower() == str(name).lower()] or difflib.get_close_matches(
        str(name), names, n=1, cutoff=0.5)
    if not near:
        lower = {n.lower(): n for n in names}
        near = [lower[m] for m in difflib.get_close_matches(str(name).lower(), lower, 1, 0.5)]
    hint = f" Did you mean '{near[0]}'?" if near else ""
    known = f"Allowed: {', '.join(names)}." if names else "There are none here."
    return BadInput(f"unknown {what} '{name}'", where, known + hint)


def refuse_unknown(what: str, names: Iterable[object], allowed: Collection[object], where: str = ""
                   ) -> None:
    """Raise an error for the first name that is not in ``allowed``.

    Raises:
        BadInput: as :func:`unknown`.
    """
    for name in names:
        if name not in allowed:
            raise unknown(what, name, allowed, where)


class _Uninterrupted(threading.local):
    """How many nested blocks this thread is in, and the signal pending until they end."""

    depth = 0
    waiting: int | None = None


_blocks = _Uninterrupted()


@contextlib.contextmanager
def uninterrupted() -> Iterator[None]:
    """Defer signals that end the process to the end of the block, if handlers check first."""
    _blocks.depth += 1
    try:
        yield
    finally:
        _blocks.depth -= 1
        number = _blocks.waiting
        if not _blocks.depth and number is not None:
            _blocks.waiting = None
            signal.raise_signal(signal.Signals(number))


def has_to_wait(number: int) -> bool:
    """Whether a signal arrived in an uninterrupted block; it is then raised again afterwards."""
    if _blocks.depth:
        _blocks.waiting = number
    return _blocks.depth > 0


_to_clean_up = 0


@contextlib.contextmanager
def cleaned_up() -> Iterator[None]:
    """Mark a block whose end cleans up: until then, handlers must not end the process."""
    global _to_clean_up
    _to_clean_up += 1
    try:
        yield
    finally:
        _to_clean_up -= 1


def has_to_clean_up() -> bool:
    """Whether exiting at once would leave something behind: half a folder, a lock, processes."""
    return _to_clean_up > 0
