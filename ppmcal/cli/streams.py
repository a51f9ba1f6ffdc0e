"""Streams and signals of the process: a full disk, a closed pipe, Ctrl-C while modules load."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
from collections.abc import Iterator
from types import FrameType
from typing import Any, TextIO, cast

CLEAR = "\r\x1b[2K"
"""Takes what is on the terminal's line away."""
line_shown = False
"""Whether a line of progress is on standard error."""


class Steady:
    """A text stream that drops what cannot be written, and keeps the first error.

    So a command goes on to write its files although nobody can read what it says.
    """

    def __init__(self, stream: TextIO | None) -> None:
        """Write to ``stream``; None, as Python has it for one that is closed, is nowhere."""
        self.stream = io.StringIO() if stream is None else stream
        self.error: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        """Be like the stream in all else."""
        return getattr(self.stream, name)

    def write(self, text: str) -> int:
        """Write text, or drop it."""
        try:
            return self.stream.write(text)
        except OSError as error:
            self._lose(error)
            return len(text)

    def flush(self) -> None:
        """Write what is held back, or drop it."""
        try:
            self.stream.flush()
        except OSError as error:
            self._lose(error)

    def _lose(self, error: OSError) -> None:
        """Lead the stream nowhere, so that Python's own last flush succeeds."""
        self.error = self.error or error
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())
            os.close(nowhere)
            self.stream.flush()


@contextlib.contextmanager
def steady() -> Iterator[Steady]:
    """Make standard output and standard error steady; yield the former."""
    kept = sys.stdout, sys.stderr
    out, err = Steady(sys.stdout), Steady(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = kept


def stop_while_loading(number: int, frame: FrameType | None) -> None:
    """Handle Ctrl-C: leave at once while a module loads, else raise KeyboardInterrupt.

    Compiled modules print an interrupted import as a failure of their own, or turn it into
    another error. Nothing is being written while a module loads.
    """
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            with contextlib.suppress(OSError):
                os.write(2, (CLEAR * line_shown + "Stopped.\n").encode())
            os._exit(130)
        frame = frame.f_back
    raise KeyboardInterrupt


@contextlib.contextmanager
def interruptible() -> Iterator[None]:
    """Take Ctrl-C by :func:`stop_while_loading`, where Python's own handler would."""
    before = signal.getsignal(signal.SIGINT)
    ours = before is signal.default_int_handler
    with contextlib.suppress(ValueError):    # not in the main thread: no signals here
        if ours:
            signal.signal(signal.SIGINT, stop_while_loading)
    try:
        yield
    finally:
        with contextlib.suppress(ValueError):
            if ours:
                signal.signal(signal.SIGINT, before)
