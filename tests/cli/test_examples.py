"""Every command's help ends with examples, and each of them runs in a folder that has its files."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path

import click
import pytest
from helpers.desk import lay_desk, run

from ppmcal.cli import COMMANDS, cli

SLOW = {"demo", "tolerances", "workspace", "batch", "plan", "diagnose", "stiffness"}
"""Commands whose examples take more than some seconds."""


def examples_of(name: str) -> list[str]:
    """Return the lines that follow the word in a command's help, as a user would copy them."""
    command = cli.get_command(click.Context(cli), name)
    assert command is not None
    context = click.Context(command, info_name=name, terminal_width=80)
    _, _, end = command.get_help(context).partition("Examples:")
    lines = [line.strip() for line in end.splitlines() if line.strip()]
    assert all(line.startswith("ppmcal ") for line in lines), lines
    return lines


ALL = [(name, line) for name in COMMANDS for line in examples_of(name)]


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_an_example(name: str) -> None:
    lines = examples_of(name)
    assert lines
    for line in lines:
        assert shlex.split(line)[:2] == ["ppmcal", name]
        assert len(line) <= 78


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with everything that the examples name."""
    folder = tmp_path_factory.mktemp("desk")
    lay_desk(folder)
    return folder


@pytest.mark.parametrize("line", [
    pytest.param(line, marks=pytest.mark.slow if name in SLOW else ()) for name, line in ALL],
    ids=[line.removeprefix("ppmcal ") for _, line in ALL])
def test_an_example_runs(line: str, desk: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                         ) -> None:
    here = tmp_path / "desk"
    shutil.copytree(desk, here)
    monkeypatch.chdir(here)
    if line.startswith("ppmcal compare"):
        shutil.rmtree("compared")
    run(line)
