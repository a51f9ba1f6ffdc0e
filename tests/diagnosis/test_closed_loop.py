"""What `diagnose` proposes to measure next, measured and given back to it, settles the set."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.diagnoses import DATA, diagnose, effect, simulate

ERRORS = {"leg1.base.point.x": 0.4, "leg2.offset": 0.3, "leg3.base.point.y": -0.3}
MORE = "n/measurements.csv"


def measured_again(folder: Path) -> None:
    """Measure the same hidden machine at the rows of next.csv, from the same place."""
    scenario: dict[str, Any] = yaml.safe_load((folder / "s.yaml").read_text())
    scenario |= {"poses": {"file": "d/next.csv"}, "approach": "one", "seed": 11}
    scenario.pop("conditions")
    (folder / "n.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", "m.yaml", "n.yaml", "--out", "n", cwd=folder, expect=0)


@pytest.mark.long
def test_the_proposed_measurements_settle_which_it_is(tmp_path: Path) -> None:
    """Legs or platform: the first campaign leaves both; with the proposed rows it is the legs."""
    kind = "leg_thermal"
    simulate(tmp_path, "3-RPR", [effect(kind, expansion=5e-6)], errors=ERRORS)
    _, first = diagnose(tmp_path)
    assert first["verdict"] == "named-set"
    (one,) = first["effects"]
    assert kind in {one["kind"], *one["alternatives"]}
    assert first["next_measurements"]["file"] == "next.csv"
    measured_again(tmp_path)
    assert len(rows(tmp_path / MORE)) == first["next_measurements"]["rows"]
    _, found = diagnose(tmp_path, DATA, MORE, out="e")
    assert found["verdict"] in ("named", "named-set")
    (now,) = found["effects"]
    assert now["kind"] == kind
    rivals = {one["kind"], *one["alternatives"]} - {kind}
    assert not rivals & set(now["alternatives"])
