"""The same work in batches: in this process, over cores, or over a cluster.

The answers come back in the order of the batches, whatever ran them.
"""

from __future__ import annotations

import importlib
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, TypeVar

from ppmcal.errors import BadInput

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Answer = TypeVar("Answer")

PER_CORE = 2
"""Fewer batches than this for each process are not worth starting processes for."""
WAIT = "10s"


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over(work: Callable[[Shared, Item], Answer], shared: Shared, items: Sequence[Item],
         processes: int = 1, scheduler: str | None = None) -> Iterator[Answer]:
    """Yield ``work(shared, item)`` for every item, in order.

    Args:
        work: a function of a module.
        shared: what all items need; sent once to each process.
        items: the batches.
        processes: how many to run them in; 1 is this one.
        scheduler: address of a dask scheduler, ``tcp://host:8786``, instead.

    Raises:
        BadInput: dask.distributed is not installed, or no scheduler answers.
    """
    if scheduler is not None:
        yield from _cluster(work, shared, items, scheduler)
        return
    processes = min(processes, len(items) // PER_CORE)
    if processes < 2:
        for item in items:
            yield work(shared, item)
        return
    # spawn: a fork of a process that has threads may hang
    with ProcessPoolExecutor(processes, get_context("spawn"), _remember, (work, shared)) as pool:
        yield from pool.map(_do, items)


_MEMORY: dict[str, Any] = {}


def _remember(work: object, shared: object) -> None:
    """Keep in a process what all of its items need."""
    _MEMORY.update(work=work, shared=shared)


def _do(item: Any) -> Any:
    return _MEMORY["work"](_MEMORY["shared"], item)


def _cluster(work: Callable[[Shared, Item], Answer], shared: Shared, items: Sequence[Item],
             scheduler: str) -> Iterator[Answer]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise BadInput("needs dask.distributed, which is not installed", "--dask",
                       "Install it with `pip install 'ppmcal[cluster]'`") from None
    try:
        client = distributed.Client(scheduler, timeout=WAIT)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(f"no scheduler answers at {scheduler} ({error})", "--dask",
                       "Start `dask scheduler` and `dask worker`, and give its address, such as "
                       "tcp://127.0.0.1:8786") from None
    with client:
        sent = client.scatter(shared, broadcast=True)
        futures = [client.submit(work, sent, item, pure=False) for item in items]
        for future in futures:
            yield future.result()
