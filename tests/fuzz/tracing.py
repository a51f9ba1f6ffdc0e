"""Which lines of the package a call reaches that none has reached before.

From Python 3.12 on by ``sys.monitoring``, where a line that was reached is not watched again, so
that it costs nothing. Before that by ``sys.settrace``, which is slow: there only functions with
lines that nobody has reached are watched, and only in a part of the calls.
"""

import random
import sys
from contextlib import contextmanager
from pathlib import Path

import ppmcal

PACKAGE = str(Path(ppmcal.__file__).parent)
SHARE = 0.1
"""Part of the calls that are watched where watching is slow."""


class Lines:
    """The lines (code, number) reached so far."""

    def __init__(self):
        self.seen = set()
        self._new = 0
        self._full = set()
        self._ways = {}
        self._rng = random.Random(0)
        self.exact = hasattr(sys, "monitoring")

    @contextmanager
    def watching(self, always=False):
        """Count what the block reaches for the first time; see :attr:`new`."""
        self._new = 0
        if self.exact:
            with self._monitored():
                yield
        elif always or self._rng.random() < SHARE:
            sys.settrace(self._called)
            try:
                yield
            finally:
                sys.settrace(None)
        else:
            yield

    @property
    def new(self):
        """How many lines the last block reached first."""
        return self._new

    @contextmanager
    def _monitored(self):
        m = sys.monitoring
        if m.get_tool(m.COVERAGE_ID) is None:
            m.use_tool_id(m.COVERAGE_ID, "fuzz")
            m.register_callback(m.COVERAGE_ID, m.events.LINE, self._line)
            m.register_callback(m.COVERAGE_ID, m.events.BRANCH, self._branch)
        m.set_events(m.COVERAGE_ID, m.events.LINE | m.events.BRANCH)
        yield

    def _line(self, code, number):
        if code.co_filename.startswith(PACKAGE):
            self._note((code.co_filename, number))
        return sys.monitoring.DISABLE

    def _branch(self, code, start, stop):
        if not code.co_filename.startswith(PACKAGE):
            return sys.monitoring.DISABLE
        where = (code.co_filename, code.co_firstlineno, start)
        self._note((*where, stop))
        ways = self._ways.setdefault(where, set())
        ways.add(stop)
        # with both ways out known there is nothing more to learn
        return sys.monitoring.DISABLE if len(ways) > 1 else None

    def _note(self, key):
        if key not in self.seen:
            self.seen.add(key)
            self._new += 1

    def _called(self, frame, event, arg):
        code = frame.f_code
        if code in self._full or not code.co_filename.startswith(PACKAGE):
            return None
        if all((code.co_filename, n) in self.seen for _, _, n in code.co_lines() if n):
            self._full.add(code)
            return None
        return self._stepped

    def _stepped(self, frame, event, arg):
        if event == "line":
            self._note((frame.f_code.co_filename, frame.f_lineno))
        return self._stepped

    def lines(self):
        """Return how many lines of the package have been reached."""
        return sum(len(k) == 2 for k in self.seen)
