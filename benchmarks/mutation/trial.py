"""One mutant against the tests that run its line, in a forked process of its own.

A server is pytest with all tests collected: each fork takes the code with the fault in place
of a function's own, runs the tests asked for until one fails, and ends. Nothing is written. What
runs while modules are imported (declarations, defaults, constants) needs a child that has not
imported them yet, as do compiled functions: there the fault is in the module as it is read.
"""

from __future__ import annotations

import gc
import importlib
import importlib.machinery
import os
import resource
import shutil
import signal
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.abc import MetaPathFinder
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import pytest

from mutation.core import ROOT, core_files
from mutation.operators import Mutant, mutated

HEAVY = ("numpy", "scipy.linalg", "scipy.optimize", "scipy.stats", "scipy.special", "numba",
         "pydantic", "yaml", "click", "rich.console", "jinja2", "matplotlib.figure")
MEMORY = 6 * 2**30
NOT_PUT_IN = 77
QUIET = ("-x", "-q", "--no-header", "--tb=no", "--assert=plain", "-p", "no:cacheprovider",
         "-p", "no:xdist")
"""Plain: pytest rewrites, and so reads itself, every module with a name like x_test.py."""


Key = tuple[str, tuple[int | None, ...] | None]


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant: killed, survived or timed out; by which test; CPU seconds."""

    status: str
    test: str
    seconds: float


Trial = Callable[[Mutant | None, Sequence[str], float], Outcome]
"""Run tests in this order on a mutant, or on what is there, until one fails; CPU s allowed."""


def forked(run: Callable[[int, str], int], allowed: float) -> Outcome:
    """Call a function in a fork, with a pipe that takes names of failed tests, and a folder."""
    folder = tempfile.mkdtemp(prefix="mutant-")
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        os._exit(_limited(run, allowed, folder, write))
    os.close(write)
    with os.fdopen(read, encoding="utf-8") as pipe:
        failed = pipe.read().partition("\n")[0]
    _, status, usage = os.wait4(child, 0)
    shutil.rmtree(folder, ignore_errors=True)
    seconds = round(usage.ru_utime + usage.ru_stime, 1)
    if os.WIFEXITED(status) and os.WEXITSTATUS(status) == NOT_PUT_IN:
        return Outcome("not tried", "", seconds)
    if os.WIFSIGNALED(status) and os.WTERMSIG(status) in (
            signal.SIGXCPU, signal.SIGKILL, signal.SIGALRM):
        return Outcome("timed out", "", seconds)
    return Outcome("killed" if failed or status != 0 else "survived", failed, seconds)


def _limited(run: Callable[[int, str], int], allowed: float, folder: str, pipe: int) -> int:
    try:
        os.chdir(ROOT)
        resource.setrlimit(resource.RLIMIT_CPU, (int(allowed), int(allowed) + 5))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
        signal.alarm(int(20 * allowed))
        nothing = os.open(os.devnull, os.O_RDWR)
        for stream in (0, 1, 2):
            os.dup2(nothing, stream)
        return run(pipe, folder)
    except BaseException:
        return 3


def preload() -> None:
    """Import what every child of :func:`from_import` needs and no mutant is in."""
    for name in HEAVY:
        importlib.import_module(name)


def from_import(mutant: Mutant | None, tests: Sequence[str], allowed: float) -> Outcome:
    """A trial in a child that imports the module with the fault in it."""
    def run(pipe: int, folder: str) -> int:
        if mutant is not None:
            sys.meta_path.insert(0, _Finder(mutant))
            if "/compil" in mutant.file:
                _nothing_kept()
        files = sorted({test.split("::")[0] for test in tests})
        return int(pytest.main([*QUIET, f"--basetemp={folder}/tests", *files],
                               plugins=[_InOrder(tests, pipe)]))
    return forked(run, allowed)


def serve(paths: Sequence[str], work: Callable[[Trial], None]) -> None:
    """Collect tests, then call ``work`` with the trial that a fork of this process is."""
    pytest.main([*QUIET, "-m", "not slow", *paths], plugins=[_Server(work)])


class _Profile:
    def pytest_configure(self) -> None:
        from hypothesis import settings

        settings.register_profile("mutants", deadline=None, derandomize=True, database=None)
        settings.load_profile("mutants")


class _InOrder(_Profile):
    """Runs the tests asked for, in their order, and says which failed."""

    def __init__(self, tests: Sequence[str], pipe: int) -> None:
        self.place = {test: n for n, test in enumerate(tests)}
        self.pipe = pipe

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = sorted((i for i in items if i.nodeid in self.place),
                          key=lambda i: self.place[i.nodeid])

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            os.write(self.pipe, f"{report.nodeid}\n".encode())

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os.write(self.pipe, f"{report.nodeid}\n".encode())


class _Server(_Profile):
    """Has all tests collected and runs none but in forks."""

    def __init__(self, work: Callable[[Trial], None]) -> None:
        self.work = work
        self.pipe = -1
        self.functions: dict[str, list[FunctionType]] = {}

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        items = {item.nodeid: item for item in session.items}
        gc.collect()
        self.functions = functions_of(core_files())
        gc.freeze()

        def trial(mutant: Mutant | None, tests: Sequence[str], allowed: float) -> Outcome:
            asked = [items[t] for t in tests if t in items]
            return forked(lambda pipe, folder: self._run(session, mutant, asked, pipe, folder),
                          allowed)

        self.work(trial)
        return True

    def _run(self, session: pytest.Session, mutant: Mutant | None, items: list[pytest.Item],
             pipe: int, folder: str) -> int:
        self.pipe = pipe
        factory: Any = session.config
        factory._tmp_path_factory._basetemp = Path(folder)
        if mutant is not None and not put_in(mutant, self.functions[mutant.file]):
            return NOT_PUT_IN
        for item, following in zip(items, [*items[1:], None], strict=True):
            item.config.hook.pytest_runtest_protocol(item=item, nextitem=following)
            if session.testsfailed:
                return 1
        return 0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            os.write(self.pipe, f"{report.nodeid}\n".encode())


def functions_of(files: Iterable[str]) -> dict[str, list[FunctionType]]:
    """Return all functions that modules have made, by file."""
    out: dict[str, list[FunctionType]] = {file: [] for file in files}
    paths = {str(ROOT / file): file for file in out}
    for thing in gc.get_objects():
        if type(thing) is FunctionType and thing.__code__.co_filename in paths:
            out[paths[thing.__code__.co_filename]].append(thing)
    return out


def put_in(mutant: Mutant, functions: Sequence[FunctionType]) -> bool:
    """Put a fault into the functions that a module has made already; False where none has it."""
    path = str(ROOT / mutant.file)
    source = Path(path).read_text(encoding="utf-8")
    was, new = (dict(_codes(compile(tree, path, "exec", dont_inherit=True)))
                for tree in (source, mutated(source, mutant)))
    changed = {key: code for key, code in new.items() if code != was[key]}
    having = [f for f in functions if _key(f.__code__) in changed]
    for function in having:
        function.__code__ = changed[_key(function.__code__)]
    return bool(having)


def _codes(code: CodeType) -> Iterator[tuple[Key, CodeType]]:
    """Yield all functions of a module's code, also those within others."""
    for const in code.co_consts:
        if isinstance(const, CodeType):
            yield _key(const), const
            yield from _codes(const)


def _key(code: CodeType) -> Key:
    # columns tell the lambdas of a line apart
    return code.co_qualname, next(code.co_positions(), None)


def _nothing_kept() -> None:
    """What was compiled without the fault is not taken, and with it not kept."""
    compilation: Any = importlib.import_module("ppmcal.kinematics.compilation")
    compilation._folder = lambda source: ""


class _Finder(MetaPathFinder):
    """Finds the one module that has a fault."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant
        self.module = mutant.file.removesuffix(".py").replace("/", ".")

    def find_spec(self, fullname: str, path: Sequence[str] | None,
                  target: ModuleType | None = None) -> importlib.machinery.ModuleSpec | None:
        if fullname != self.module:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path)
        if spec is not None and spec.origin is not None:
            spec.loader = _Loader(fullname, spec.origin)
            spec.loader.mutant = self.mutant
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    mutant: Mutant

    def get_code(self, fullname: str) -> CodeType:
        path = self.get_filename(fullname)
        source = self.get_data(path).decode()
        return compile(mutated(source, self.mutant), path, "exec", dont_inherit=True)
