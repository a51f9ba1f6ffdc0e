"""Ten short examples print the first lines that they show; the citation is the package's."""

from __future__ import annotations

import re
import shutil
import tomllib
from pathlib import Path

import pytest
import yaml
from generators.pages import WHOLE, Ran, perform, steps
from helpers.commands import ppmcal
from helpers.paths import ROOT

import ppmcal as face

EXAMPLES = sorted((ROOT / "examples").glob("*.md"))
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
CFF = {"cff-version", "message", "type", "title", "abstract", "authors", "version", "license",
       "keywords"}
"""Keys of the format 1.2.0 that are in use."""


def run(words: list[str], folder: Path) -> Ran:
    done = ppmcal(*words, cwd=folder)
    return Ran(done.code, done.out + done.err)


def same(shown: str, printed: str) -> bool:
    """Whether two lines are alike but for the last digits of numbers and the room they take."""
    numbers = [[float(n) for n in NUMBER.findall(line)] for line in (shown, printed)]
    words = [NUMBER.sub("0", line).split() for line in (shown, printed)]
    return words[0] == words[1] and numbers[0] == pytest.approx(numbers[1], rel=0.02, abs=1e-3)


@pytest.mark.long_cases(
    "cable-robot", "delta-printer", "diagnose", "hexapod", "maslow", "next-poses", "three-rps-head")
@pytest.mark.slow
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.stem)
def test_an_example_prints_what_it_shows(path: Path, tmp_path: Path) -> None:
    shutil.copytree(ROOT / "sample_data", tmp_path / "sample_data")
    for step in steps(path.read_text(encoding="utf-8")):
        ran = perform(step, tmp_path, run)
        assert ran.code in step.codes, f"{step.line or step.name}\n{ran.text}"
        shown = [line for line in step.output if line != "..."]
        printed = ran.text.splitlines()[:len(shown)]
        assert len(printed) == len(shown), ran.text
        assert all(map(same, shown, printed)), f"{step.line}\n{ran.text}"


def test_examples_are_ten_and_short() -> None:
    texts = {p.stem: p.read_text(encoding="utf-8") for p in EXAMPLES}
    assert len(texts) == 10
    for name, text in texts.items():
        assert text.startswith(WHOLE) and len(text.splitlines()) <= 40, name
        assert re.search(r"^# \w", text, re.M) and "```console" in text, name
        assert "... " not in re.sub(r"^ .*", "", text, flags=re.M), f"{name}: docs/refresh.py"


def test_lines_are_alike_but_for_round_off() -> None:
    assert same("rms 0.1234 mm", "rms  0.1235 mm") and not same("rms 0.12 mm", "rms 0.15 mm")
    assert not same("3 rows", "3 lines")


def test_the_citation_is_that_of_the_package() -> None:
    """Citation File Format 1.2.0: required keys, authors as entities with a name."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert set(cited) <= CFF and {"cff-version", "message", "title", "authors"} <= set(cited)
    assert str(cited["cff-version"]) == "1.2.0" and cited["type"] == "software"
    assert all(isinstance(cited[k], str) for k in ("message", "title", "abstract", "version"))
    assert (cited["title"], cited["version"]) == (project["name"], face.__version__)
    assert cited["license"] == project["license"]
    assert cited["abstract"] == project["description"]
    assert cited["keywords"] == project["keywords"]
    holder = re.search(r"^Copyright \(c\) \d+ (.*)$", (ROOT / "LICENSE").read_text("utf-8"), re.M)
    assert holder is not None and cited["authors"] == [{"name": holder[1]}]
