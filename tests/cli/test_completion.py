"""What the shell completes, asked as a shell asks."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from click.shell_completion import BashComplete
from click.testing import CliRunner

from ppmcal.cli import cli

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


def completed(line: str, begun: str) -> list[str]:
    """Return what stands after a line in which the last word is begun."""
    shell = BashComplete(cli, {}, "ppmcal", "_PPMCAL_COMPLETE")
    return [item.value for item in shell.get_completions(line.split()[1:], begun)]


@pytest.mark.parametrize(("line", "begun", "some"), [
    ("ppmcal", "id", ["identify"]),
    ("ppmcal init", "6-u", ["6-UPS"]),
    ("ppmcal export", "k", ["klipper"]),
    ("ppmcal import", "r", ["reprap"]),
    ("ppmcal schema", "mech", ["mechanism"]),
    ("ppmcal schema", "ident", ["identification"]),
    ("ppmcal diagnose mine.yaml run1.csv --kind", "backl", ["backlash"]),
    ("ppmcal identify mine.yaml run1.csv --method", "g", ["gcv"]),
    ("ppmcal identify", "--hold", ["--holdout"]),
])
def test_names_are_completed(line: str, begun: str, some: list[str]) -> None:
    assert completed(line, begun) == some


def test_parameters_are_those_of_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch
                                             ) -> None:
    shutil.copy(SAMPLES / "hexapod.yaml", tmp_path / "mine.yaml")
    monkeypatch.chdir(tmp_path)
    assert completed("ppmcal identify mine.yaml run1.csv --free", "leg3.off") == ["leg3.offset"]
    assert completed("ppmcal identify none.yaml run1.csv --free", "leg3") == []


def test_a_report_is_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import webbrowser

    (tmp_path / "check").mkdir()
    pages: list[str] = []
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda page: pages.append(page) is None)
    shutil.copy(SAMPLES / "hexapod.yaml", "mine.yaml")
    shutil.copy(SAMPLES / "scenario.yaml", "scenario.yaml")
    made = CliRunner().invoke(cli, ["simulate", "mine.yaml", "scenario.yaml", "-q"])
    assert (made.exit_code, made.output) == (0, "")
    found = CliRunner().invoke(cli, ["report", "simulated", "--open"])
    assert found.exit_code == 0, found.output
    assert pages == [(tmp_path / "report" / "report.html").as_uri()]
    assert "in a browser" not in found.output
    again = CliRunner().invoke(cli, ["report", "simulated"])
    assert len(pages) == 1 and "in a browser" in again.output
