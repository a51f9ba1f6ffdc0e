"""Every command's help ends with examples, and each of them runs in a folder that has its files."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import pytest
from helpers.desk import examples_of, run
from helpers.shared import shared_desk

from ppmcal.commands import command, names

SLOW = {"tolerances", "workspace", "batch", "plan", "diagnose", "stiffness"}
"""Commands whose examples take more than some seconds."""


HERE = [(name, line) for name in names() for line in examples_of(name) if not command(name).script]
"""The demo runs where its results are verified, in `api/test_verify.py`."""


@pytest.mark.parametrize("name", names())
def test_every_command_has_an_example(name: str) -> None:
    lines = examples_of(name)
    assert lines
    for line in lines:
        assert shlex.split(line)[:2] == ["ppmcal", name]
        assert len(line) <= 78


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return shared_desk(tmp_path_factory)


@pytest.mark.slow
@pytest.mark.long_cases(
    "certify identified run2.csv --about about.yaml", "compare identified identified-may",
    "diagnose mine.yaml run2.csv", "figures identified --width 174mm",
    "identify mine.yaml run1.csv run2.csv --leave-out session",
    "identify mine.yaml run2.csv --start identified --keep --out kept",
    "validate identified run2.csv --against identified-may", "plan mine.yaml --count 15")
@pytest.mark.parametrize("line", [
    pytest.param(line, marks=pytest.mark.slow if name in SLOW else ()) for name, line in HERE],
    ids=[line.removeprefix("ppmcal ") for _, line in HERE])
def test_an_example_runs(line: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                         ) -> None:
    here = tmp_path / "desk"
    shutil.copytree(desk, here)
    monkeypatch.chdir(here)
    if line.startswith("ppmcal compare"):
        shutil.rmtree("compared")
    run(line)
