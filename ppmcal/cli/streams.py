"""Streams and signals of the process: a full disk, a closed pipe, Ctrl-C while modules load."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from time import monotonic
from types import FrameType, TracebackType
from typing import Any, TextIO, cast

from ppmcal.errors import has_to_clean_up, has_to_wait

CLEAR = "\r\x1b[2K"
"""Takes what is on the terminal's line away."""
line_shown = False
"""Whether a line of progress is on standard error."""
STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP")
              if hasattr(signal, name))
"""Signals that ask a process to end: Ctrl-C, a scheduler's or a shutdown's, a closed terminal."""
MOMENT = 0.02
"""Seconds after which a signal that has to wait is tried again."""
PATIENCE = 5.0
"""Seconds that cleaning up may take before the next signal ends it."""
_stopped: Stopped | None = None
"""What the signal has raised that ends this run."""


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

    @property
    def lost(self) -> str:
        """Why something was not written, empty where all was, or nobody wanted to read it."""
        if self.error is None or isinstance(self.error, BrokenPipeError):
            return ""
        return self.error.strerror or str(self.error)

    def _lose(self, error: OSError) -> None:
        """Lead the stream nowhere, so that Python's own last flush succeeds."""
        self.error = self.error or error
        with contextlib.suppress(OSError, ValueError):
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())
            os.close(nowhere)
            self.stream.flush()


@contextlib.contextmanager
def steady() -> Iterator[tuple[Steady, Steady]]:
    """Make standard output and standard error steady; yield both."""
    kept = sys.stdout, sys.stderr
    out, err = Steady(sys.stdout), Steady(sys.stderr)
    sys.stdout, sys.stderr = cast(TextIO, out), cast(TextIO, err)
    try:
        yield out, err
    finally:
        out.flush()
        err.flush()
        sys.stdout, sys.stderr = kept


class Stopped(BaseException):
    """A signal asks the process to end; raised wherever the program is, so that it cleans up.

    Attributes:
        number: of the signal. at: when it came, as :func:`time.monotonic` has it.
    """

    def __init__(self, number: int) -> None:
        """Remember the signal."""
        super().__init__(number)
        self.number, self.at = number, monotonic()

    @property
    def exit_code(self) -> int:
        """As a shell has it."""
        return 128 + self.number


def stop(number: int, frame: FrameType | None) -> None:
    """Handle a signal: raise :class:`Stopped`, or, while a module loads, leave at once.

    Compiled modules print an interrupted import as a failure of their own, or turn it into
    another error. Where something is to be cleaned up, it waits for the module.
    """
    global _stopped
    if _stopped is not None:    # cleaning up already
        if monotonic() - _stopped.at > PATIENCE:
            os._exit(128 + number)
        return
    if has_to_wait(number):
        return
    if _imports(frame):
        if has_to_clean_up():
            _again(number)
            return
        with contextlib.suppress(OSError):
            os.write(2, (CLEAR * line_shown + "Stopped.\n").encode())
        os._exit(128 + number)
    _stopped = Stopped(number)
    raise _stopped


def stopped() -> Stopped | None:
    """Return what a signal has raised: compiled modules may have made another error of it."""
    return _stopped


def _imports(frame: FrameType | None) -> bool:
    """Whether a module is being loaded."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _again(number: int) -> None:
    """Send the signal to this process once more, a moment later."""
    def send() -> None:
        if hasattr(signal, "pthread_kill"):    # the main thread's own waiting ends too
            signal.pthread_kill(threading.main_thread().ident or 0, number)
        else:
            signal.raise_signal(signal.Signals(number))

    timer = threading.Timer(MOMENT, send)
    timer.daemon = True
    timer.start()


def loading() -> Callable[[], None]:
    """Let Ctrl-C end the process quietly while modules load; return what ends that."""
    if (threading.current_thread() is not threading.main_thread()
            or signal.getsignal(signal.SIGINT) is not signal.default_int_handler):
        return lambda: None
    signal.signal(signal.SIGINT, stop)

    def over() -> None:
        if signal.getsignal(signal.SIGINT) is stop:
            signal.signal(signal.SIGINT, signal.default_int_handler)

    return over


@contextlib.contextmanager
def interruptible(to_the_end: bool = False) -> Iterator[None]:
    """Take signals that end a process by :func:`stop`, where nobody else takes them.

    Args:
        to_the_end: the process ends with the block: what comes later is ignored, so that
            Python's own end is quiet.
    """
    global _stopped
    _stopped = None
    kept = {}
    hook, shown = sys.unraisablehook, sys.excepthook

    def lost(what: Any) -> None:    # raised where Python drops exceptions, such as in __del__
        global _stopped
        if isinstance(what.exc_value, Stopped):
            _stopped = None
            _again(what.exc_value.number)
        else:
            hook(what)

    def quiet(kind: type[BaseException], error: BaseException, trace: TracebackType | None
              ) -> None:    # compiled modules show what they drop
        if not isinstance(error, Stopped):
            shown(kind, error, trace)

    with contextlib.suppress(ValueError):    # not in the main thread: no signals here
        for number in STOPS:
            before = signal.getsignal(number)
            if before in (signal.SIG_DFL, signal.default_int_handler):
                signal.signal(number, stop)
                kept[number] = before
    sys.unraisablehook, sys.excepthook = lost, quiet
    try:
        yield
    finally:
        for number, before in kept.items():
            signal.signal(number, signal.SIG_IGN if to_the_end else before)
        sys.unraisablehook, sys.excepthook = hook, shown


def is_entry() -> bool:
    """Whether the caller of this was called by the program's own first lines."""
    frame = sys._getframe(2)
    return frame.f_code.co_name == "<module>" and frame.f_globals.get("__name__") == "__main__"
