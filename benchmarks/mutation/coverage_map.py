"""A pytest plug-in: which test runs which line of the core, and its CPU seconds.

``python -m pytest -p mutation.coverage_map --map FILE PATHS``
"""

from __future__ import annotations

import json
import time
from collections import defaultdict
from collections.abc import Generator
from pathlib import Path
from typing import Any

import coverage
import pytest
from hypothesis import settings

from mutation.core import ROOT, core_files

SHARED = "fixture "


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--map", help="file that the map is written to")


def pytest_configure(config: pytest.Config) -> None:
    settings.register_profile("mutants", deadline=None, derandomize=True, database=None)
    settings.load_profile("mutants")
    config.pluginmanager.register(Recorder(Path(config.getoption("map"))))


class Recorder:
    """Counts lines under the name of the test that runs them."""

    def __init__(self, out: Path) -> None:
        self.out = out
        self.seconds: dict[str, float] = {}
        self.failed: set[str] = set()
        self.users: dict[str, list[str]] = defaultdict(list)
        self.current = ""
        self.coverage = coverage.Coverage(
            data_file=None, config_file=False, messages=False,
            include=[str(ROOT / f) for f in core_files()])
        self.coverage.start()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        self._switch(item.nodeid)
        begin = time.process_time()
        for name in getattr(item, "fixturenames", ()):
            self.users[name].append(item.nodeid)
        answer = yield
        self.seconds[item.nodeid] = time.process_time() - begin
        self._switch("")
        return answer

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: Any) -> Generator[None, Any, Any]:
        # what a shared fixture runs belongs to all of its tests, not to the first
        before = self.current
        if fixturedef.scope != "function":
            self._switch(SHARED + fixturedef.argname)
        try:
            return (yield)
        finally:
            self._switch(before)

    def _switch(self, name: str) -> None:
        self.current = name
        self.coverage.switch_context(name)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self.failed.add(report.nodeid)

    def pytest_sessionfinish(self) -> None:
        self.coverage.stop()
        data = self.coverage.get_data()
        names = [n for n in self.seconds if n not in self.failed]
        number = {name: n for n, name in enumerate(names)}
        lines: dict[str, dict[str, list[int]]] = {}
        for file in data.measured_files():
            found = lines[Path(file).relative_to(ROOT).as_posix()] = {}
            for line, contexts in data.contexts_by_lineno(file).items():
                tests = {t for c in contexts for t in (
                    self.users[c.removeprefix(SHARED)] if c.startswith(SHARED) else [c])}
                found[str(line)] = sorted(number[t] for t in tests if t in number)
        self.out.parent.mkdir(parents=True, exist_ok=True)
        self.out.write_text(json.dumps({
            "tests": [[name, round(self.seconds[name], 3)] for name in names],
            "left out": sorted(self.failed), "lines": lines}), encoding="utf-8")
