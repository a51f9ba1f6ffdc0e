"""``ppmcal diagnose``: every cause in one question, each with a probability."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.commands import ppmcal, rows
from wild_diagnosis import write

import ppmcal as api
from ppmcal.diagnosis.cause_sizes import in_proportion
from ppmcal.diagnosis.extended_model import Sized


def campaign(folder: Path, case: str, machine: str, seed: int, eta: float, count: int = 90
             ) -> dict[str, Any]:
    """Write a campaign of the benchmark's and return what is hidden in it."""
    return write(case, machine, count, seed, folder, eta)


def diagnosed(folder: Path, *options: str) -> dict[str, Any]:
    run = ppmcal("diagnose", "mechanism.yaml", "data.csv", *options, cwd=folder)
    assert run.code in (0, 1), run
    return json.loads((folder / "diagnosed" / "diagnosis.json").read_text()) | {"said": run.out}


@pytest.fixture(scope="module")
def gain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("gain")
    campaign(folder, "gain-one", "3-RPR", 5, 2.0)
    return folder, diagnosed(folder)


@pytest.mark.slow
def test_an_effect_is_named_with_its_probability(gain: tuple[Path, dict[str, Any]]) -> None:
    folder, found = gain
    assert found["verdict"] in ("named", "named-set")
    (effect,) = found["effects"]
    assert effect["kind"] == "gain"
    assert effect["probability"] + sum(effect["probabilities"]) >= 0.95
    assert len(effect["probabilities"]) == len(effect["alternatives"])
    assert found["nothing"] < 0.01 and not found["unknown"]
    assert effect["p_value"] is None and "probability" in found["said"]
    named = [r for r in rows(folder / "diagnosed/effects.csv") if r["status"] == "named"]
    assert [r["kind"] for r in named] == ["gain"]
    assert float(named[0]["probability"]) > 0.5 and named[0]["p_value"] == "nan"


@pytest.mark.slow
def test_rows_left_out_are_predicted_by_geometry_alone_and_by_all_that_may_be_there(
        gain: tuple[Path, dict[str, Any]]) -> None:
    folder, found = gain
    by = {b["by"]: b for b in found["predictive"]}
    assert {"pose", "time", "temperature"} <= by.keys()
    pose = by["pose"]
    assert pose["blocks"] > 40 and by["time"]["blocks"] == 3
    assert pose["gain"] > 5 * pose["gain_sigma"] > 0.0
    assert pose["gain"] == pytest.approx(pose["averaged"]["score"] - pose["geometry"]["score"])
    assert 0.8 < pose["averaged"]["error"] < 1.2 < pose["geometry"]["error"]
    assert pose["geometry"]["error"] == pytest.approx(found["gap"]["before"], rel=0.2)
    assert "Cross-validation error, one pose left out at a time" in " ".join(found["said"].split())
    ppmcal("report", "diagnosed", "--out", "told", cwd=folder)
    assert "log score" in next((folder / "told").glob("*.html")).read_text()


@pytest.mark.slow
def test_the_page_and_the_commands_use_the_same_probabilities(
        gain: tuple[Path, dict[str, Any]]) -> None:
    folder, found = gain
    assert ppmcal("report", "diagnosed", "--out", "page", cwd=folder).code in (0, 1)
    page = next((folder / "page").glob("*.html")).read_text()
    assert "probability" in page
    total = sum(s["probability"] for s in found["sets"])
    assert total == pytest.approx(1.0) if found["sets"] else not found["effects"][0]["alternatives"]


@pytest.mark.long
def test_nothing_hidden_is_nothing_said(tmp_path: Path) -> None:
    """Through Python; the record says what the diagnosis does."""
    campaign(tmp_path, "none-wrench", "hexapod", 3, 1.0)
    result = api.diagnose(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    found = result.record
    assert found.verdict == "none" and result.diagnosis.nothing > 0.5
    assert found.nothing == pytest.approx(result.diagnosis.nothing)
    assert not (found.effects or found.unknown or found.suspected)


@pytest.mark.long
def test_two_events_are_named_at_their_rows(tmp_path: Path) -> None:
    truth = campaign(tmp_path, "homed-twice", "3-RPR", 11, 2.0, 100)
    found = diagnosed(tmp_path)
    told = sorted(e["row"]["value"] for e in found["effects"] if e["kind"] == "zero_shift")
    true = sorted(e["row"] for e in truth["effects"])
    assert len(told) == len(true)
    assert np.all(np.abs(np.subtract(told, true)) <= 3)


@pytest.mark.long
def test_what_has_no_name_says_what_it_looks_like(tmp_path: Path) -> None:
    campaign(tmp_path, "base-walks", "3-RPR", 31, 1.0)
    found = diagnosed(tmp_path)
    assert found["verdict"] in ("unnamed", "partial")
    assert any(u["alternatives"] for u in found["unknown"])
    assert all(u["looks_like"] and u["probability"] + sum(u["probabilities"]) >= 0.95
               for u in found["unknown"])
    assert all(name.split(" (")[0] in found["said"].replace("\n", " ")
               for u in found["unknown"] for name in u["alternatives"])
    assert "Without a name: " in found["said"]


@pytest.mark.long
def test_what_has_no_name_may_be_one_of_several(tmp_path: Path) -> None:
    """A walk of the base that is most of all a step: the step has a name, the walk is beside it."""
    campaign(tmp_path, "base-walks", "3-RPR", 2, 2.0)
    found = diagnosed(tmp_path)
    assert found["unknown"] or all(any(a.startswith("unknown cause") for a in e["alternatives"])
                                   for e in found["effects"])


@pytest.mark.long
def test_what_is_not_linear_leaves_nothing_that_has_a_name(tmp_path: Path) -> None:
    """Weight in a wrong direction is no small motion; a joint off by a turn is in test_rounds."""
    campaign(tmp_path, "gravity-wrong", "3-RPR", 14046, 1.104)
    found = diagnosed(tmp_path)
    assert {e["kind"] for e in found["effects"]} == {"compliance", "gravity_tilt"}
    assert not found["unknown"]
    # on three legs, what gives way in no listed way is nearly as likely as weight elsewhere
    assert not [a for e in found["effects"] for a in e["alternatives"] if "unknown" not in a]
    assert all(e["probability"] > 0.9 for e in found["effects"])


@pytest.mark.parametrize(("carried", "ratio"), [(2.0, 0.5), (0.0, 1.0), (None, 1.0)])
def test_in_proportion_to_nothing_is_no_number(carried: float | None, ratio: float) -> None:
    """An effect that another leans on may have no size, or no place in the set."""
    base = SimpleNamespace(kind="base_compliance", on=(), requires=None)
    wrong = SimpleNamespace(kind="tilt", on=(), requires=("base_compliance", ()))
    given: Any = [Sized(wrong, np.ones(1), np.full(1, 3.0), np.full(1, 5.0))]
    if carried is not None:
        given.append(Sized(base, np.full(1, carried), np.ones(1), np.ones(1)))
    with np.errstate(all="raise"):
        found, *_ = in_proportion(given)
    assert (found.value, found.sigma, found.prior) == (ratio, 3.0 * ratio, 5.0 * ratio)
