"""What may come of an input: it is read, or refused with place and hint, soon, in little space."""

import re
import resource
import signal
import traceback
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from ppmcal.errors import PpmcalError

SECONDS = 2.0
"""Of processor time, in which an input is read or refused."""
BYTES = 1_000_000_000
"""That a process may take beyond what it has when it begins."""
LONGEST = 15_000


class TooLong(BaseException):
    """The time is over; no code of the package catches it."""


@dataclass(frozen=True)
class Outcome:
    """What came of an input: ``key`` without numbers and names, ``fault`` empty if all is well."""

    key: str
    fault: str = ""
    detail: str = ""


def bare(text):
    """Return a message without what depends on the input."""
    return re.sub(r"'[^']*'|\"[^\"]*\"|[-+.]?\d[-+.\de]*|\b(nan|inf)\b", "_", text)[:50]


@contextmanager
def bounded(seconds=SECONDS):
    """Raise TooLong after so much processor time."""
    signal.signal(signal.SIGPROF, _over)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)


def _over(number, frame):
    raise TooLong


def limit_memory(more=BYTES):
    """Let the process take so many bytes more than it has mapped now."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + more,
                                            resource.getrlimit(resource.RLIMIT_AS)[1]))


def judged(function, data, seconds=SECONDS):
    """Return what comes of ``function(data)``."""
    try:
        with bounded(seconds):
            found = function(data)
    except TooLong as error:
        return Outcome("slow", "slow: " + _place(error), f"over {seconds:g} s")
    except PpmcalError as error:
        return Outcome(f"{type(error).__name__}: {bare(error.what)}", _lacking(error), str(error))
    except MemoryError as error:
        return Outcome("memory", "memory: " + _place(error), "over 1 GB")
    except Exception as error:
        said = f" ({bare(str(error))})" if isinstance(error, AssertionError) else ""
        place = f"{type(error).__name__}: {_place(error)}{said}"
        return Outcome(place, place, "".join(traceback.format_exception(error))[-1500:])
    return Outcome(found if isinstance(found, str) else "read")


def _lacking(error):
    """Return what a refusal lacks, empty where it has everything."""
    text = str(error)
    if not error.what or not error.where or not error.hint:
        return f"a refusal without {'place' if not error.where else 'mend'}: {bare(error.what)}"
    if len(text) > LONGEST:
        return f"a refusal of {len(text) // 1000}000 characters"
    if not text.replace("\n", "").replace("\xa0", "").isprintable():
        return f"a refusal that cannot be shown: {bare(error.what)!r}"
    return ""


def _place(error):
    """Return the innermost function of the package that an error went through."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "/ppmcal/" in f.filename and "/site-packages/" not in f.filename
           ] or list(frames)
    last = own[-1]
    return f"{last.filename.rpartition('/ppmcal/')[2]}:{last.name}:{last.lineno}"
