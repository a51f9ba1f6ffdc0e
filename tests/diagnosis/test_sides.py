"""Either sign of a reversal is a machine's: it tells on which side of the play the encoder sits."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import number, ppmcal, rows, write_csv
from helpers.diagnoses import CONFIGS, DATA, diagnose, effect, simulate, value

from ppmcal.io.results.diagnosis_parts import DiagnosedEffect
from ppmcal.io.results.diagnosis_wording import side
from ppmcal.model.effects import effect_kinds, find_effect
from ppmcal.model.motions import PLANAR

REVERSED = [w for kind in ("backlash", "lag", "friction") for w in ("--kind", kind)]
REVERSALS = [name for name, kind in effect_kinds().items() if kind.reversal]


@pytest.mark.parametrize("name", REVERSALS)
def test_a_side_goes_with_what_the_kind_adds_after_a_move_up(name: str) -> None:
    kind = find_effect(name)
    worked, told = kind.worked, kind.reversal
    assert worked is not None and told is not None
    at = worked.setting
    way = at["approach"] if "approach" in at else at["travel"] - at["travel_before"]
    other = {n: -v for n, v in worked.values.items()}
    leads = worked.result * way > 0.0
    assert [told.side(worked.values), told.side(other)] == (
        ["leads", "lags"] if leads else ["lags", "leads"])
    assert told.side(dict.fromkeys(worked.values, 0.0)) == ""


def test_all_that_changes_with_the_direction_has_sides_and_takes_either_sign() -> None:
    """The sign of a product may change along its column."""
    kinds = [k for k in effect_kinds().values() if "dir" in k.needs]
    assert {k.name for k in kinds if k.reversal is None} == {"product"}
    for kind in kinds:
        for spec in kind.parameters(PLANAR):
            if spec.name != "speed" and not spec.constant:
                assert spec.low == -spec.high and spec.usual[0] == -spec.usual[1]


def test_sides_in_words() -> None:
    first = DiagnosedEffect(kind="backlash", on=("a",), side="lags")
    second = DiagnosedEffect(kind="backlash", on=("b",), side="leads")
    assert side([first, first]) == [
        "the joint lags its reading: its encoder sits before the play."]
    assert side([first, second]) == [
        "a: the joint lags its reading: its encoder sits before the play.",
        "b: the joint leads its reading: its encoder sits behind the play, or dir_ tells the side "
        "it came from."]
    assert side([DiagnosedEffect(kind="play", on=("a",), side="leads")]) == [
        "the joint leads its reading: its encoder sits behind the play."]
    assert side([DiagnosedEffect(kind="gain", on=("a",))]) == []


def bench(folder: Path, effects: list[dict[str, Any]]) -> Path:
    return simulate(folder, "3-RPR", effects, count=12, conditions={})


def turned(folder: Path, names: tuple[str, ...]) -> None:
    """Write some columns of directions the other way round."""
    table = rows(folder / DATA)
    write_csv(folder / DATA, [r | {n: f"{-float(r[n]):g}" for n in names} for r in table])


@pytest.mark.long
def test_a_drive_behind_its_encoder_is_named_with_its_side(tmp_path: Path) -> None:
    """``simulate`` makes it, ``check`` has nothing against it, and turned directions lead."""
    bench(tmp_path, [effect("backlash", width=-0.03)])
    ppmcal("check", "m.yaml", DATA, cwd=tmp_path, expect=0)
    run, found = diagnose(tmp_path, DATA, *REVERSED)
    (one,) = found["effects"]
    assert (found["verdict"], one["kind"], one["side"]) == ("named", "backlash", "lags")
    width = value(found, "backlash", "width")
    assert abs(width["value"] + 0.03) < 4.0 * width["sigma"]
    assert "The joint lags its reading: its encoder sits before the play." in run.out
    (line,) = [r for r in rows(tmp_path / "d/effects.csv") if r["status"] == "named"]
    assert line["side"] == "lags"
    turned(tmp_path, ("dir_leg1", "dir_leg2", "dir_leg3"))
    _, other = diagnose(tmp_path, DATA, *REVERSED, out="t")
    assert other["effects"][0]["side"] == "leads"
    assert value(other, "backlash", "width")["value"] == pytest.approx(-width["value"], rel=1e-6)
    assert other["effects"][0]["probability"] == pytest.approx(one["probability"], rel=1e-6)


@pytest.mark.long
def test_one_column_against_the_others_is_a_note(tmp_path: Path) -> None:
    bench(tmp_path, [effect("backlash", width=-0.03)])
    turned(tmp_path, ("dir_leg2",))
    run, found = diagnose(tmp_path, DATA, *REVERSED)
    sides = {a: e["side"] for e in found["effects"] for a in e["on"]}
    assert {e["kind"] for e in found["effects"]} == {"backlash"}
    assert sides == {"leg1": "lags", "leg2": "leads", "leg3": "lags"}
    assert any("backlash has one sign on leg1, leg3 and the other on leg2" in f
               for f in json.loads((tmp_path / "d/diagnosis.json").read_text())["findings"])
    assert run.code == 1


@pytest.mark.parametrize("width", [-0.4, 0.4])
def test_commands_make_up_for_a_reversal_on_either_side(tmp_path: Path, width: float) -> None:
    """The joints are where the commands are, plus the direction times half the width."""
    machine = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text(encoding="utf-8"))
    (tmp_path / "bare.yaml").write_text(yaml.safe_dump(machine))
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(machine | {
        "effects": [effect("backlash", width=width)]}))
    rng = np.random.default_rng(2)
    way = rng.choice([-1.0, 1.0], (6, 3))
    pose = np.array([500.0, 288.675, 30.0]) + rng.uniform(-1, 1, (6, 3)) * (40.0, 40.0, 5.0)
    write_csv(tmp_path / "t.csv", [
        dict(zip(("x", "y", "rz", "dir_leg1", "dir_leg2", "dir_leg3"), map(repr, row), strict=True))
        for row in np.hstack([pose, way]).tolist()])
    ppmcal("compensate", "m.yaml", "t.csv", "--frame", "base", "--out", "c", cwd=tmp_path)
    sent = rows(tmp_path / "c/commands.csv")
    q = [f"q_leg{a}" for a in (1, 2, 3)]
    joints = np.array([[number(r, n) for n in q] for r in sent]) + 0.5 * width * way
    write_csv(tmp_path / "q.csv", [dict(zip(q, map(repr, row), strict=True))
                                   for row in joints.tolist()])
    ppmcal("kinematics", "forward", "bare.yaml", "q.csv", "--out", "k", cwd=tmp_path, expect=0)
    reached = np.array([[number(r, n) for n in ("x", "y", "rz")]
                        for r in rows(tmp_path / "k/kinematics.csv")])
    np.testing.assert_allclose(reached, pose, atol=1e-6)
