"""A column of commands.csv is added in two places, a sentence in one; a package adds both."""

from __future__ import annotations

import json
import re
import subprocess
import sys

import numpy as np
import pytest
import yaml
from helpers.commands import columns, number, rows
from helpers.paths import ROOT

import ppmcal

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
COLUMN = re.search(r"^## Add a column of `commands.csv`$.*?^```python\n(.*?)^```", PAGE,
                   re.M | re.S)[1]
SENTENCE = '''
from ppmcal.commands.compensate import run

known = run.doubts


def doubts(found, machine, knowledge):
    return [*known(found, machine, knowledge), "the bench was moved"]


run.doubts = doubts
'''


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The results of two commands of a process in which a package has added both."""
    folder = tmp_path_factory.mktemp("added")
    (folder / "workshop.py").write_text(COLUMN + SENTENCE)
    machine = ppmcal.load(ppmcal.shipped("3-RPR"))
    home = machine.home_pose
    (folder / "t.csv").write_text("x,y,rz\n" + "".join(
        f"{1e3 * home[0] + dx},{1e3 * home[1]},{np.degrees(home[5])}\n" for dx in (0.0, 5.0)))
    tree = yaml.safe_load(ppmcal.shipped("3-RPR").read_text())
    tree["limbs"][0]["offset"] = {"value": 0.3, "nominal": 0.0}
    (folder / "m.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    main = "import workshop\nfrom ppmcal.cli import main\nmain()"
    for words in (("compensate", "m.yaml", "t.csv", "--frame", "base", "--out", "c"),
                  ("report", "c", "--out", "r")):
        done = subprocess.run([sys.executable, "-c", main, *words], cwd=folder, text=True,
                              capture_output=True, check=False)
        assert done.returncode in (0, 1), done.stderr
        (folder / f"{words[0]}.txt").write_text(done.stdout + done.stderr)
    return folder


@pytest.mark.slow
def test_the_column_has_its_values_and_its_unit(made):
    assert columns(made / "c" / "commands.csv")[-1] == "correction"
    for row in rows(made / "c" / "commands.csv"):
        away = [number(row, f"cmd_{c}") - number(row, c) for c in "xy"]
        assert number(row, "correction") == pytest.approx(np.hypot(*away), abs=1e-9)
        assert number(row, "correction") > 0.05
    assert json.loads((made / "c" / "commands.json").read_text())["units"]["correction"] == "mm"


@pytest.mark.slow
def test_the_sentence_is_on_the_console_in_the_file_and_on_the_page(made):
    said = "the bench was moved"
    assert said in " ".join((made / "compensate.txt").read_text().split())
    assert said in json.loads((made / "c" / "commands.json").read_text())["notes"]
    assert said in (made / "r" / "report.html").read_text()
