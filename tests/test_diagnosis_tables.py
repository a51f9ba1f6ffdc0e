"""The tables of a diagnosis: one row and one p-value per effect, the same groups before and after."""

from __future__ import annotations

import csv
import io
import json
import sys
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ppmcal.diagnose.gap import Gap
from ppmcal.diagnose.result import Diagnosis
from ppmcal.diagnose.run import Options, _findings, _proposal, diagnose
from ppmcal.files.output import plain
from ppmcal.outputs.diagnosis import effects_csv, summary
from ppmcal.problem import Problem

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))

import hidden

Record = dict[str, Any]
SUBSETS = {"shared": [("leg2", "leg5")], "each": [("leg2",), ("leg5",)]}


@dataclass(frozen=True)
class Case:
    """A diagnosis, what diagnosis.json holds of it, and the rows of effects.csv."""

    result: Diagnosis
    record: Record
    table: list[dict[str, str]]


@cache
def case(name: str, later: float = 0.0) -> Case:
    """Backlash on two of six legs; ``later``: seconds by which the clock is ahead."""
    options = hidden.Options(poses=24)
    causes = [hidden.scaled("6-UPS", 3, hidden.draw("6-UPS", 3, "backlash", options, on=on),
                            1.0 + 0.5 * n, options) for n, on in enumerate(SUBSETS[name])]
    made = hidden.campaign("6-UPS", 3, causes, options)
    columns = made.dataset.columns
    data = replace(made.dataset, columns={**columns, "time": columns["time"] + later})
    problem = Problem(made.mechanism, (data,), made.mechanism.free)
    result = diagnose(problem, Options(draws=400))
    assert result.verdict == "named"
    record = json.loads(json.dumps(plain(summary(result, {})), allow_nan=False))
    return Case(result, record, list(csv.DictReader(io.StringIO(effects_csv(result)))))


@pytest.mark.parametrize("name", list(SUBSETS))
def test_every_named_effect_has_its_row(name: str) -> None:
    """Those on a few actuators too, whose form the library did not hold."""
    found = case(name)
    wanted = sorted((e["kind"], " ".join(e["on"])) for e in found.record["effects"])
    assert {a for _, on in wanted for a in on.split()} == {"leg2", "leg5"}
    named = [r for r in found.table if r["status"] == "named"]
    assert sorted((r["kind"], r["on"]) for r in named) == wanted
    assert found.table[:len(named)] == named
    others = {(r["kind"], r["on"], r["form"]) for r in found.table if r["status"] != "named"}
    for row in named:
        assert (row["kind"], row["on"], row["form"]) not in others


@pytest.mark.parametrize("name", list(SUBSETS))
def test_one_p_value_per_effect(name: str) -> None:
    """effects.csv, diagnosis.json and the ranking agree; what was before has its own column."""
    found = case(name)
    ranked = {(r["kind"], *r["on"]): r for r in found.record["story"]["ranking"]
              if r["status"] == "named"}
    for e in found.record["effects"]:
        row = next(r for r in found.table if (r["kind"], r["on"], r["status"])
                   == (e["kind"], " ".join(e["on"]), "named"))
        assert float(row["p_value"]) == pytest.approx(e["p_value"], rel=1e-12, abs=0.0)
        assert float(row["survival"]) == pytest.approx(e["survival"], rel=1e-12)
        entry = ranked[e["kind"], *e["on"]]
        assert entry["log10_p"] == pytest.approx(e["log10_p"], rel=1e-5)
        alone = np.log10(float(row["p_value_alone"]))
        assert alone == pytest.approx(entry["log10_p_alone"], rel=1e-5)
    for row in found.table:
        if row["status"] not in ("named", "not testable"):
            assert row["p_value"] == row["p_value_alone"]
    if name == "each":  # one leg's error hides the other's
        assert any(abs(r["log10_p"] - r["log10_p_alone"]) > 1.0 for r in ranked.values())


@pytest.mark.parametrize("later", [0.0, 1.7e9])
def test_groups_are_the_same_before_and_after(later: float) -> None:
    """Each group of rows has its own figure with the effects, near the noise in all of them."""
    found = case("shared", later)
    places = found.record["localised"]
    assert {"actuator", "direction", "region", "load", "time", "temperature"} == {
        p["by"] for p in places}
    keys = [(p["by"], p["value"]) for p in places]
    assert len(keys) == len(set(keys))
    for p in places:
        if p["by"] != "actuator":
            assert p["rms_ratio"] > 1.3, p
            assert 0.7 < p["rms_ratio_after"] < 1.3, p


def test_next_step_agrees_with_the_findings() -> None:
    """Nothing is settled that the held-out poses do not confirm."""
    result = case("shared").result
    gap = result.gap
    assert isinstance(gap, Gap)
    last, left = result.found.last, result.remainder
    for confirmed in (True, False):
        seen = replace(gap, confirmed=confirmed)
        said = _findings(result.before, result.before, left, result.effects, seen)
        step = _proposal(last, {}, "named", 0, seen).reason
        assert any("do not confirm" in f for f in said) == (not confirmed)
        assert ("settled" in step) == confirmed
        assert ("do not confirm" in step) == (not confirmed)
