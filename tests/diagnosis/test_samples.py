"""Three effects at once in the sample campaign."""

from __future__ import annotations

from typing import Any

import pytest
import yaml
from helpers.diagnoses import found_in, named, value
from helpers.paths import ROOT
from helpers.shared import shared_demo

SAMPLES = ROOT / "sample_data"


def holds(found: dict[str, Any], effects: list[dict[str, Any]], actuators: list[str]) -> None:
    """Check kinds, actuators and sizes against the truth, and that the gap is closed."""
    assert found["verdict"] in ("named", "named-set")
    assert named(found) == {e["kind"]: set(e.get("on", actuators)) for e in effects}
    for e in effects:
        for name, truth in e["parameters"].items():
            v = value(found, e["kind"], name)
            assert abs(v["value"] - float(truth)) < 4.0 * v["sigma"], (e["kind"], v)
            assert 0.0 < v["sigma"] < 0.25 * float(truth)
    gap = found["gap"]
    assert found["confirmed"]
    assert gap["closed"] > 0.6
    assert gap["interval"][1] > 0.9
    assert gap["after"] < 1.25 < gap["before"]


@pytest.mark.long
def test_the_sample_campaign(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Its scenario, which no command of the demo is given, says what is hidden."""
    folder = shared_demo(tmp_path_factory)
    text = (SAMPLES / "hidden" / "scenario.yaml").read_text(encoding="utf-8")
    truth = yaml.load(text, yaml.BaseLoader)  # else `on` is read as true
    found = found_in(folder / "demo-results", "diagnosed")
    holds(found, truth["effects"], [f"leg{n}" for n in range(1, 7)])
    # on which joints may be open; of which kind it is, is not
    assert all(set(e["alternatives"]) <= {e["kind"]} for e in found["effects"])
    out = " ".join((folder / "said.txt").read_text(encoding="utf-8").split())
    for words in ("backlash on leg2, leg5: leg2 width", "compliance on all 6 actuators: stiffness",
                  "leg_thermal on all 6 actuators: expansion"):
        assert words in out
