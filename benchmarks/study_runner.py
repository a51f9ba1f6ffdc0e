"""Running campaigns on all cores, one line of CSV each; what was stopped goes on where it was."""

from __future__ import annotations

import csv
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any


def work(path: Path, outcome: type, run: Callable[[Any], Any], todo: Sequence[Any],
         end: float | None, cores: int) -> bool:
    """Run campaigns until the time is over; return whether all were run.

    ``outcome``: dataclass of a line, which ``run`` returns, or None for no line; ``end``: by the
    monotonic clock, s.
    """
    names = [f.name for f in fields(outcome)]
    with path.open("a", newline="", encoding="utf-8") as file, multiprocessing.Pool(cores) as pool:
        writer = csv.writer(file)
        if path.stat().st_size == 0:
            writer.writerow(names)
        for n, line in enumerate(pool.imap_unordered(run, todo), 1):
            if line is not None:
                writer.writerow([getattr(line, name) for name in names])
                file.flush()
            if sys.stderr.isatty():
                print(f"\r{n} of {len(todo)} campaigns", end="", file=sys.stderr)
            if end is not None and time.monotonic() > end:
                pool.terminate()
                return False
    return True


def remaining(path: Path, jobs: Iterable[Any]) -> list[Any]:
    """Return the jobs (dataclasses whose fields are columns) that have no line yet."""
    lines, todo = read(path), list(jobs)
    names = [f.name for f in fields(todo[0])] if todo else []
    done = {tuple(line[n] for n in names) for line in lines}
    return [j for j in todo if tuple(str(getattr(j, n)) for n in names) not in done]


def read(path: Path) -> list[dict[str, str]]:
    """Return the lines of a study."""
    if not path.exists():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
