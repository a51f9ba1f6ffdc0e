"""Axes of plots say in which unit they are."""

import re

import pytest
import yaml
from helpers.commands import ppmcal
from helpers.report_files import specs

from ppmcal.report import collect, to_html

BARE = re.compile(r"(row|target|parameter|pose), in the order|density$|residual / sigma|"
                  r"over the noise|p-value|smallest singular value|direction of approach|^z$")
"""Axes of bare numbers: counts, ratios and chances."""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """A simulated, identified, diagnosed and compensated planar machine on one page."""
    folder = tmp_path_factory.mktemp("axes")
    ppmcal("init", "3-RPR", cwd=folder, expect=0)
    scenario = yaml.safe_load((folder / "3-RPR.scenario.yaml").read_text())
    (folder / "s.yaml").write_text(yaml.safe_dump(scenario | {"errors": {"leg1.offset": 5.0}}))
    (folder / "t.csv").write_text("x,y,rz\n500,288,30\n510,280,31\n")
    for words in (["simulate", "3-RPR.yaml", "s.yaml", "--out", "s"],
                  ["identify", "3-RPR.yaml", "s/measurements.csv", "--out", "i"],
                  ["diagnose", "3-RPR.yaml", "s/measurements.csv", "--kind", "backlash",
                   "--out", "d"],
                  ["compensate", "i/identified.yaml", "t.csv", "--frame", "base", "--out", "c"],
                  ["kinematics", "inverse", "3-RPR.yaml", "t.csv", "--out", "k"]):
        ppmcal(*words, "--quiet", cwd=folder)
    return to_html(collect([folder / n for n in "sidck"]))


@pytest.mark.slow
def test_every_axis_of_a_page_has_its_unit(page):
    found = {}
    for spec in specs(page).values():
        for key, axis in spec["layout"].items():
            if key[1:5] == "axis" and (title := (axis.get("title") or {}).get("text")):
                found[title] = bool(re.search(r"\([^()]+\)$", title) or BARE.search(title))
    assert {"measured x (unit of the file)", "position (mm)"} <= set(found)
    assert [title for title, told in found.items() if not told] == []
