"""What a sidecar keeps closed and the data ask to be open."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import yaml

import ppmcal
from ppmcal import algebra as cga
from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.registration_freedoms import (
    hint_sentences,
    odds_of_opening,
    registration_hints,
    significant_improvement,
    surely,
)
from ppmcal.commands.inputs import load, shipped
from ppmcal.inference.priors import MOVED
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset

MACHINE = "3-RPR"


def day(seed: int, name: str, **other: Any) -> Dataset:
    base: dict[str, Any] = yaml.safe_load(shipped(MACHINE, True).read_text(encoding="utf-8"))
    text = {**copy.deepcopy(base), "seed": seed, "errors": {"leg1.offset": 0.3}, **other}
    data: Dataset = ppmcal.simulate(load(shipped(MACHINE)), text).data[0]
    return replace(data, name=name, source=f"{name}.csv")


def fitted(*days: Dataset) -> Fit:
    machine = load(shipped(MACHINE))
    return identify(Problem(machine, days, machine.free))


def turned(data: Dataset) -> Dataset:
    """The body's axes were defined 5 mrad anew."""
    turn = cga.motor_from_rotation_vector(np.array([0.0, 0.0, 5e-3]), np.zeros(3))
    own = cga.motor_from_rotation_vector(np.nan_to_num(data.rotation), np.zeros(3))
    new = cga.rotation_vector(cga.compose(own, turn))
    return replace(data, rotation=np.where(np.isnan(data.rotation), np.nan, new))


def moved(data: Dataset) -> Dataset:
    frame = replace(data.frame, same_as="day1")
    return replace(data, position=data.position + np.array([1e-3, 0.0, 0.0]), frame=frame)


CASES = {"rotation": ("target_rotation: unknown", lambda: turned(day(2, "day2"))),
         "frame": ("frame: unknown", lambda: moved(day(2, "day2"))),
         "homing": ("homing: per-file", lambda: day(2, "day2", errors={
             "leg1.offset": 0.3, "leg2.offset": 0.4, "leg3.offset": -0.5}))}


@pytest.mark.slow
@pytest.mark.parametrize("what", list(CASES))
def test_what_was_changed_between_days_is_told(what: str) -> None:
    mend, second = CASES[what]
    fit = fitted(day(1, "day1"), second())
    hints = registration_hints(fit)
    assert [h.remedy for h in hints] == [mend]
    assert hints[0].after < 1.3 < hints[0].before
    (said,) = hint_sentences(fit, hints)
    assert f"`{mend} in day2.yaml`" in said
    assert "mm rms" in said


@pytest.mark.slow
def test_joint_values_alone_have_no_position_that_would_be_off() -> None:
    """It said that the error went from 0 to 0 mm."""
    machine = load(shipped("maslow"))
    text = yaml.safe_load(shipped("maslow", True).read_text(encoding="utf-8"))
    del text["frame"]
    text["instrument"] = {"kind": "none", "sigma": {"actuator": 0.3}}
    first, second = (replace(ppmcal.simulate(machine, {**text, "seed": n}).data[0], name=f"day{n}",
                             source=f"day{n}.csv") for n in (1, 2))
    second = replace(second, q=second.q + np.array([0.0, 0.02, 0.0, 0.0]))
    fit = identify(Problem(machine, (first, second), machine.free))
    (hint,) = registration_hints(fit)
    (said,) = hint_sentences(fit, [hint])
    assert said.startswith("day2: `homing: per-file in day2.yaml` reduces its residuals from")
    assert "0 to 0" not in said and f"to {hint.after:.3g} times the noise" in said


@pytest.mark.slow
def test_sessions_within_a_file_may_have_frames_of_their_own() -> None:
    data = day(1, "day1")
    late = np.arange(len(data)) >= len(data) // 2
    data = replace(data, position=data.position + 1e-3 * late[:, None] * np.array([1.0, 0, 0]),
                   sessions=tuple("ab"[int(x)] for x in late))
    assert [h.what for h in registration_hints(fitted(data))] == ["sessions"]


@pytest.mark.slow
def test_two_days_that_agree_say_nothing() -> None:
    assert registration_hints(fitted(day(1, "day1"), day(2, "day2"))) == ()


def test_chance_and_what_is_worth_nothing_do_not_count() -> None:
    assert significant_improvement(100.0, 98.0) == 0.0      # worth nothing
    assert significant_improvement(4000.0, 1000.0) == pytest.approx(0.5)
    fit = fitted(day(1, "day1"), day(2, "day2"))
    possible = [(1, what) for what in ("rotation", "homing")]
    odds = odds_of_opening(fit.problem, fit.state, fit.keep, fit.prior, possible)
    assert (odds < np.log(MOVED.value)).all()      # may be chance


@pytest.mark.slow
def test_what_has_to_be_open_is_as_likely_with_its_rows_in_any_order() -> None:
    fit = fitted(day(1, "day1"), moved(day(2, "day2")))
    possible = [(1, what) for what in ("frame", "target", "rotation", "homing")]

    def odds(of: Fit) -> Array:
        return odds_of_opening(of.problem, of.state, of.keep, of.prior, possible)

    other = np.random.default_rng(1).permutation(len(fit.keep[1]))
    problem, state = fit.problem, fit.state
    turned_round = replace(fit, keep=(fit.keep[0], fit.keep[1][other]), state=replace(
        state, poses=(state.poses[0], state.poses[1][other])), problem=replace(
        problem, datasets=(problem.datasets[0], problem.datasets[1].take(other))))
    assert odds(turned_round) == pytest.approx(odds(fit), rel=1e-6, abs=1e-6)
    assert surely(odds(fit)) and np.argmax(odds(fit)) == 0


@pytest.mark.long
@pytest.mark.parametrize("what", list(CASES))
def test_no_effect_alone_is_named_for_it(what: str) -> None:
    mend, second = CASES[what]
    result = ppmcal.diagnose(load(shipped(MACHINE)), [day(1, "day1"), second()])
    assert result.verdict != "named"
    assert any(mend in f for f in result.findings)
