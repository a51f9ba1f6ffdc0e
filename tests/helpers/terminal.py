"""A command at a pseudo-terminal, as a person sees it."""

from __future__ import annotations

import os
import select
import subprocess
import sys
import time

CLEAR = "\r\x1b[2K"


class Terminal:
    """A process at a pseudo-terminal of 80 columns: all that it shows there."""

    def __init__(self, code: str, *args: object) -> None:
        import pty  # there is none on Windows

        here, there = pty.openpty()
        self.fd, self.shown = here, ""
        self.process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, args)], stdin=there, stdout=there,
            stderr=there, start_new_session=True, env={**os.environ, "TERM": "xterm"})
        os.close(there)

    def until(self, text: str, seconds: float = 60.0) -> bool:
        """Read until some text is shown or the process is at its end."""
        last = time.monotonic() + seconds
        while text not in self.shown or not text:
            if not select.select([self.fd], [], [], max(last - time.monotonic(), 0.0))[0]:
                return False
            try:
                self.shown += os.read(self.fd, 4096).decode(errors="replace")
            except OSError:    # the other end is closed
                return bool(text) and text in self.shown
        return True

    def code(self) -> int:
        """Read to the end; return the exit code."""
        self.until("")
        os.close(self.fd)
        return self.process.wait(60)

    def lines(self) -> list[str]:
        """Return what stays on the screen, line by line."""
        out = []
        for line in self.shown.replace("\r\n", "\n").split("\n"):
            out.append(line.rpartition(CLEAR)[2].rpartition("\r")[2])
        return out
