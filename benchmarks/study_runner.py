"""Campaigns on all cores or a cluster, one line of CSV each; what was stopped goes on."""

from __future__ import annotations

import csv
import multiprocessing
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path
from typing import Any


def work(path: Path, outcome: type, run: Callable[[Any], Any], todo: Sequence[Any],
         end: float | None, cores: int, scheduler: str | None = None) -> bool:
    """Run campaigns until the time is over; return whether all were run.

    ``outcome``: dataclass of a line, which ``run`` returns, or None for no line; ``end``: by the
    monotonic clock, s; ``scheduler``: of a dask cluster whose workers see this folder, in place
    of cores.
    """
    names = [f.name for f in fields(outcome)]
    with path.open("a", newline="", encoding="utf-8") as file, (
            answers(run, todo, cores, scheduler)) as found:
        writer = csv.writer(file)
        if path.stat().st_size == 0:
            writer.writerow(names)
        for n, line in enumerate(found, 1):
            if line is not None:
                writer.writerow([getattr(line, name) for name in names])
                file.flush()
            if sys.stderr.isatty():
                print(f"\r{n} of {len(todo)} campaigns", end="", file=sys.stderr)
            if end is not None and time.monotonic() > end:
                return False
    return True


@contextmanager
def answers(run: Callable[[Any], Any], todo: Sequence[Any], cores: int, scheduler: str | None
            ) -> Iterator[Iterable[Any]]:
    """Yield what campaigns come to, as they end; what has not begun by then is given up."""
    if scheduler is None:
        with multiprocessing.Pool(cores) as pool:
            yield pool.imap_unordered(run, todo)
        return
    import distributed

    with distributed.Client(scheduler) as client:
        # by what every process has: our own modules it does not find yet
        folder = str(Path(__file__).resolve().parent)
        for everywhere in (client.run, client.run_on_scheduler):
            everywhere(exec, f"import sys; sys.path.insert(0, {folder!r})", {})
        futures = client.map(run, todo, pure=False)
        try:
            yield (line for _, line in distributed.as_completed(futures, with_results=True))
        finally:
            client.cancel(futures)


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
