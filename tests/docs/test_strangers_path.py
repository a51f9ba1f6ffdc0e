"""A stranger's usual mistakes: the answer names the cause and the mend, and the page shows it."""

from __future__ import annotations

import re

import pytest
from generators.mistakes import MISTAKES, happen
from generators.pages import Ran
from helpers.commands import ppmcal
from helpers.paths import ROOT

PAGE = (ROOT / "docs" / "strangers-path.md").read_text(encoding="utf-8")


def run(words, folder):
    done = ppmcal(*words, cwd=folder)
    return Ran(done.code, done.out + done.err)


@pytest.mark.long_cases("Euler angles", "Swapped columns", "Degrees for radians", "Wrong unit")
@pytest.mark.slow_cases("Wrong branch", "Wrong sign", "Diameters for radii", "Too few poses")
@pytest.mark.parametrize("mistake", MISTAKES, ids=lambda m: m.title)
def test_a_mistake_is_answered_with_its_cause_and_its_mend(mistake, tmp_path):
    ran = happen(mistake, tmp_path / "desk", run)
    told = " ".join(ran.text.split())
    assert ran.code == mistake.code, told
    assert re.search(mistake.cause, told), told
    assert re.search(mistake.hint, told), told


def test_the_page_shows_every_mistake():
    assert len(MISTAKES) >= 10
    for i, mistake in enumerate(MISTAKES, 1):
        section = re.search(rf"^### {i}\. {mistake.title}$(.*?)(?=^##|\Z)", PAGE, re.M | re.S)
        assert section, f"{mistake.title}: run `make strangers-path`"
        assert f"Exit code {mistake.code}" in section[1]
        assert re.search(mistake.hint, " ".join(section[1].split())), mistake.title
