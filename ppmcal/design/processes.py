"""The same work in batches: in this process, over cores, or over a cluster.

The answers come back in the order of the batches, whatever ran them.
"""

from __future__ import annotations

import asyncio
import importlib
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing import active_children, get_context, parent_process, resource_tracker
from multiprocessing.process import BaseProcess
from time import monotonic
from typing import Any, TypeVar

from ppmcal import __version__
from ppmcal.errors import BadInput, NoResult, cleaned_up, has_to_wait

Shared = TypeVar("Shared")
Item = TypeVar("Item")
Answer = TypeVar("Answer")

PER_CORE = 2
"""Fewer batches than this for each process are not worth starting processes for."""
PIECES = 16
"""Pieces for each worker: one that ends last keeps the others waiting for a part of this."""
WAIT = "10s"
PATIENCE = 2.0
"""Seconds that processes have to clean up when they are ended."""


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def over(work: Callable[[Shared, Item], Answer], shared: Shared, items: Sequence[Item],
         processes: int = 1, scheduler: str | None = None) -> Iterator[Answer]:
    """Yield ``work(shared, item)`` for every item, in order.

    Items go to a process several at a time, so that sending them costs little of their work.

    Args:
        work: a function of a module.
        shared: what all items need; sent once to each process.
        items: the batches.
        processes: how many to run them in; 1 is this one.
        scheduler: address of a dask scheduler, ``tcp://host:8786``, instead.

    Raises:
        BadInput: dask.distributed is not installed, no scheduler answers, or it has no workers.
        NoResult: a process was ended from outside.
    """
    if scheduler is not None:
        yield from _cluster(work, shared, items, scheduler)
        return
    processes = min(processes, len(items) // PER_CORE)
    if processes < 2:
        for item in items:
            yield work(shared, item)
        return
    yield from _processes(work, shared, items, processes)


def shares(items: Sequence[Item], workers: int) -> list[Sequence[Item]]:
    """Return items as pieces for workers: few to send, and enough that all end together."""
    size = max(1, len(items) // (workers * PIECES))
    return [items[i:i + size] for i in range(0, len(items), size)]


def _processes(work: Callable[[Shared, Item], Answer], shared: Shared, items: Sequence[Item],
               processes: int) -> Iterator[Answer]:
    # spawn: a fork of a process that has threads may hang
    context = get_context("spawn")
    before = set(active_children())
    pool = None
    with cleaned_up():
        try:
            with _held():
                _track()
            with _held():
                pool = ProcessPoolExecutor(processes, context, _remember, (work, shared))
                # not pool.map: what it cancels, a pool whose processes have ended stumbles over
                answers = deque(pool.submit(_do, share) for share in shares(items, processes))
            while answers:
                yield from answers.popleft().result()
        except BrokenProcessPool:
            raise NoResult("a process was ended from outside, or ran out of memory", "",
                           "Run it again with fewer --cores") from None
        except BaseException:
            # nobody waits for answers any more
            _end(set(active_children()) - before)
            raise
        finally:
            if pool is not None:
                pool.shutdown(cancel_futures=True)


@contextmanager
def _held() -> Iterator[None]:
    """Let what begins in the block never see a signal that ends a process; here it waits.

    A terminal sends Ctrl-C to all, also while they load modules or read what to do.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    kept = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *_endings()})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, kept)


def _track() -> None:
    """Begin Python's tracker of semaphores, which survives all but a closed terminal by itself."""
    if os.name == "posix":
        resource_tracker.ensure_running()


def _end(children: Iterable[BaseProcess]) -> None:
    """End processes: each may clean up for a moment."""
    for child in children:
        child.terminate()
    end = monotonic() + PATIENCE
    for child in children:
        child.join(max(end - monotonic(), 0.0))
        if child.is_alive():
            child.kill()


_MEMORY: dict[str, Any] = {}
"""What all items of a pool's process need."""
_state = "idle"
"""Of a process of a pool: idle, at work, or leaving."""


def _remember(work: object, shared: object) -> None:
    """Keep in a process what all of its items need; it ends cleanly, and with the first one."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in _endings():
        if signal.getsignal(number) is not signal.SIG_IGN:    # nohup is for all of them
            signal.signal(number, _leave)
    if hasattr(signal, "pthread_sigmask"):    # it was begun without them
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _endings())
    threading.Thread(target=_follow, daemon=True).start()
    _MEMORY.update(work=work, shared=shared)


def _endings() -> list[int]:
    """Return the signals that end a process of the pool: the pool's own, a closed terminal's."""
    return [getattr(signal, n) for n in ("SIGTERM", "SIGHUP") if hasattr(signal, n)]


def _leave(number: int, frame: object) -> None:
    """End a process from where it is, so that no half-written file is left.

    A second signal would end the cleaning up: a closed terminal's is followed by the pool's own.
    """
    global _state
    if _state == "idle":
        os._exit(128 + number)
    if _state == "at work" and not has_to_wait(number):
        _state = "leaving"
        raise SystemExit(128 + number)


def _follow() -> None:
    """End this process when the first one has gone without a word."""
    first = parent_process()
    if first is not None:
        first.join()
        os._exit(1)


def _do(items: Sequence[Any]) -> list[Any]:
    global _state
    try:
        _state = "at work"
        answers = _all(_MEMORY["work"], _MEMORY["shared"], items)
        _state = "idle"
        return answers
    except SystemExit as stop:    # the pool would go on with the next items
        os._exit(stop.code if isinstance(stop.code, int) else 1)


def _all(work: Callable[[Shared, Item], Answer], shared: Shared, items: Sequence[Item]
         ) -> list[Answer]:
    return [work(shared, item) for item in items]


def _cluster(work: Callable[[Shared, Item], Answer], shared: Shared, items: Sequence[Item],
             scheduler: str) -> Iterator[Answer]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise BadInput("needs dask.distributed, which is not installed", "--scheduler",
                       "Install it with `pip install 'ppmcal[cluster]'`") from None
    try:
        client = distributed.Client(scheduler, timeout=WAIT)
    except (OSError, ValueError, TypeError) as error:
        raise BadInput(f"no scheduler answers at {scheduler} ({error})", "--scheduler",
                       "Start `dask scheduler` and `dask worker`, and give its address, such as "
                       "tcp://127.0.0.1:8786") from None
    with client:
        workers = sum(client.nthreads().values())
        if not workers:
            raise BadInput(f"the scheduler at {scheduler} has no workers", "--scheduler",
                           f"Start some: `dask worker {scheduler} --nthreads 1`")
        _refuse_other_versions(client, scheduler)
        sent = client.scatter(shared, broadcast=True)
        futures = [client.submit(_all, work, sent, list(piece), pure=False)
                   for piece in shares(items, workers)]
        while futures:
            try:
                yield from futures.pop(0).result()
            except (distributed.scheduler.KilledWorker, asyncio.CancelledError) as error:
                raise NoResult(f"the workers were lost ({error})", "--scheduler",
                               "Look at their logs, and run it again") from None


def version() -> str:
    """Return the version of ppmcal in this process."""
    return __version__


def _refuse_other_versions(client: Any, scheduler: str) -> None:
    """Refuse workers that would compute something else, or nothing."""
    place, hint = f"--scheduler {scheduler}", f"Install ppmcal {__version__} where workers run"
    try:
        others = set(client.run(version).values()) - {__version__}
    except Exception as error:
        raise BadInput(f"workers do not run ppmcal ({error})", place, hint) from None
    if others:
        raise BadInput(f"workers have ppmcal {', '.join(sorted(others))}", place, hint)
