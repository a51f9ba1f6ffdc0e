"""A probe that did not trigger, a caliper value typed wrong, a zero that moved between sessions."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.instruments import data_of, truth
from helpers.printers import joints_at, printer, touches
from helpers.sessions import two_sessions
from numpy.typing import NDArray
from scipy.special import stdtrit

from ppmcal.calibration.fit.coverage import LEAST, Z95
from ppmcal.calibration.fit.fit_result import Fit, FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.homing_shift import HomingShift, homing_shifts
from ppmcal.calibration.fit.outliers import UncheckedRows, find_gross_errors
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.validation.summary import report
from ppmcal.io.results.identification_wording import (
    gross_rows,
    row_sentences,
    shift_sentence,
    unchecked_sentences,
    would_be,
)
from ppmcal.io.results.units import of_joints
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

Array = NDArray[np.float64]


def fitted(mechanism: Mechanism, *data: Dataset, robust: bool = True) -> Fit:
    return identify(Problem(mechanism, data, mechanism.free), FitOptions(robust=robust))


def calipers(mechanism: Mechanism, g: Array, rng: np.random.Generator, n: int) -> Dataset:
    """Return distances between points on the bed, measured to 0.02 mm."""
    ends = np.zeros((2, n, 6))
    angle = np.linspace(0.1, 3.0, n)
    for sign, part in zip((-1, 1), ends, strict=True):
        part[:, 0], part[:, 1] = sign * 0.09 * np.cos(angle), sign * 0.09 * np.sin(angle)
    q, to_q = (joints_at(mechanism, g, part) for part in ends)
    found = data_of(mechanism, "distance", q, to_q, g, rng, 2e-5, False)
    return replace(found, name="calipers", sigma_value=np.full(n, 2e-5))


@pytest.mark.slow
def test_what_left_out_rows_would_change_starts_from_the_values_that_are_told(
        tmp_path: Path) -> None:
    """The touches scatter three times as much as stated, so that the fit is not the first one."""
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(1)
    good = touches(mechanism, truth(mechanism, rng), rng, 40)
    scatter = rng.normal(0.0, 3.0, 40) * good.sigma_value
    bad = replace(good, value=good.value + scatter + np.where(np.arange(40) == 17, -2e-3, 0.0))
    told = report(fitted(mechanism, bad), FitOptions(), 0.0, 0)
    assert told.gross_errors.would and told.noise.inflation > 1.5
    whole = fitted(mechanism, bad.noisier(told.noise.inflation), robust=False)
    for name, (now, then) in told.gross_errors.would.items():
        p = mechanism.names.index(name)
        assert now == told.fit.state.g[p]
        assert then - now == pytest.approx(whole.state.g[p] - now, rel=0.2)


def test_a_probe_that_did_not_trigger_is_named(tmp_path: Path) -> None:
    """The row, what the others say, and what the fit would be with it."""
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(1)
    g = truth(mechanism, rng)
    good = touches(mechanism, g, rng, 40)
    bad = replace(good, value=good.value + np.where(np.arange(40) == 17, -8e-4, 0.0))
    fit = fitted(mechanism, bad)
    found = find_gross_errors(fit)
    (row,) = found.rows
    assert (row.row, row.number) == (good.rows[17], "height")
    assert row.value == pytest.approx(bad.value[17])
    assert row.predicted == pytest.approx(good.value[17], abs=5e-5)
    whole = fitted(mechanism, bad, robust=False)
    assert found.would
    for name, (now, then) in found.would.items():
        p = mechanism.names.index(name)
        change = whole.state.g[p] - fit.state.g[p]
        assert now == fit.state.g[p]
        assert then - now == pytest.approx(change, rel=0.1)
    words = row_sentences(gross_rows(found, mechanism), would_be(found, mechanism), mechanism)
    assert f"row {good.rows[17]}: height" in words[0] and "With them" in words[1]
    assert not find_gross_errors(fitted(mechanism, good)).rows


@pytest.mark.slow
def test_a_caliper_value_typed_wrong_is_named(tmp_path: Path) -> None:
    """With three distances; digits exchanged."""
    mechanism = printer(tmp_path)
    rng = np.random.default_rng(2)
    g = truth(mechanism, rng)
    good = calipers(mechanism, g, rng, 3)
    bad = replace(good, value=good.value + np.array([0.0, 9e-3, 0.0]))
    (row,) = find_gross_errors(fitted(mechanism, touches(mechanism, g, rng, 40), bad)).rows
    assert (row.dataset, row.row) == ("calipers", good.rows[1])
    assert row.predicted == pytest.approx(good.value[1], abs=2e-4)


@pytest.mark.slow
def test_a_distance_that_stands_alone_is_unchecked(tmp_path: Path) -> None:
    mechanism = printer(tmp_path, ratio={"value": -0.0125, "tolerance": 1e-3})
    rng = np.random.default_rng(3)
    g = truth(mechanism, rng, 0.01)
    bed, one = touches(mechanism, g, rng, 40), calipers(mechanism, g, rng, 1)
    fit = fitted(mechanism, bed, one)
    assert find_gross_errors(fit).unchecked == (
        UncheckedRows("calipers", (int(one.rows[0]),)),)
    assert "would go unnoticed" in unchecked_sentences(
        find_gross_errors(fit).unchecked)[-1]
    several = calipers(mechanism, g, rng, 5)
    assert not find_gross_errors(fitted(mechanism, bed, several)).unchecked


def found_shifts(seed: int, shift: float, second: int = 20) -> tuple[HomingShift, ...]:
    mechanism, data = two_sessions(seed, shift, second)
    return find_gross_errors(fitted(mechanism, data)).homing_shifts


@pytest.mark.slow
@pytest.mark.parametrize("second", [20, 6])
def test_a_zero_that_moved_is_named(second: int) -> None:
    """Also where all rows of its session were left out; of two sessions it is the smaller."""
    hits = 0
    for seed in range(3):
        (found,) = found_shifts(seed, 3e-4, second)
        assert (found.session, found.actuator) == ("B", "leg2")
        hits += abs(found.value - 3e-4) < 1.96 * found.sigma
    assert hits >= 2


def test_a_zero_that_moved_has_the_interval_of_an_estimated_noise() -> None:
    """Noise stated twice too small: its size is what few redundant values show, Student's t."""
    mechanism, data = two_sessions(2, 3e-3, 6)
    fit = fitted(mechanism, data.take(np.arange(60) >= 48).noisier(0.5), robust=False)
    values = fit.information.count - len(fit.problem.columns) - len(mechanism.actuators)
    least = stdtrit(LEAST + values + len(fit.problem.free), 0.975)
    found = list(homing_shifts(fit))
    assert "leg2" in [s.actuator for s in found]
    for shift in found:
        assert shift.half > least * shift.sigma > 1.03 * Z95 * shift.sigma
        (said,) = of_joints([replace(shift, half=2.0 * shift.half)], mechanism)
        half = re.search(r"\+- (\S+)", shift_sentence(said))[1]
        assert float(half) == pytest.approx(said.half, rel=0.06)    # two digits


@pytest.mark.slow
def test_zeros_that_stayed_are_not_accused() -> None:
    assert sum(bool(found_shifts(seed, 0.0)) for seed in range(10)) == 0


def test_of_many_sessions_only_the_odd_ones_are_named() -> None:
    mechanism, data = two_sessions(5, 0.0)
    labels = np.array(list("ABCDEF"))[np.arange(60) // 10]
    q = data.q.copy()
    q[labels == "A", 0] -= 2e-4
    q[labels == "E", 1:] += 4e-4
    data = replace(data, q=q, sessions=tuple(labels.tolist()))
    shifts = find_gross_errors(fitted(mechanism, data)).homing_shifts
    found = {(s.session, s.actuator): s.value for s in shifts}
    assert set(found) == {("A", "leg1"), ("E", "leg2"), ("E", "leg3")}
    assert found["A", "leg1"] == pytest.approx(2e-4, abs=3e-5)
    assert found["E", "leg3"] == pytest.approx(-4e-4, abs=3e-5)


@pytest.mark.slow
def test_files_are_sessions_and_per_file_homing_is_not_accused() -> None:
    mechanism, data = two_sessions(3, 3e-4)
    a, b = (replace(data.take(np.arange(60) // 40 == i), name=n, sessions=None)
            for i, n in enumerate("AB"))
    b = replace(b, frame=replace(b.frame, same_as="A"))
    found = find_gross_errors(fitted(mechanism, a, b)).homing_shifts
    assert {s.session for s in found} == {"B"}
    free = [replace(d, homing="per-file") for d in (a, b)]
    assert not find_gross_errors(fitted(mechanism, *free)).homing_shifts
    assert "the homing offset of leg2 shifted in B: by +0." in shift_sentence(
        of_joints(found, mechanism)[-1])


@pytest.mark.slow
def test_identify_tells_of_a_moved_zero(tmp_path: Path) -> None:
    """In the words of the command and in its record."""
    ppmcal("init", "3-RPR", cwd=tmp_path, expect=0)
    scenario = yaml.safe_load((tmp_path / "3-RPR.scenario.yaml").read_text())
    scenario["errors"] = {"leg1.offset": 0.3}
    for label, own in (("a", 0.0), ("b", 0.5)):
        scenario["errors"]["leg3.offset"] = own
        scenario["seed"] = ord(label)
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
        ppmcal("simulate", "3-RPR.yaml", "s.yaml", "--out", label, "--quiet", cwd=tmp_path,
               expect=0)
        side = yaml.safe_load((tmp_path / label / "measurements.yaml").read_text())
        side["name"] = f"session {label}"
        (tmp_path / label / "measurements.yaml").write_text(yaml.safe_dump(side))
    run = ppmcal("identify", "3-RPR.yaml", "a/measurements.csv", "b/measurements.csv",
                 cwd=tmp_path, expect=1)
    assert "the homing offset of leg3 shifted in session b" in " ".join(run.out.split())
    assert max(len(line) for line in run.out.splitlines()) <= 80
    written = json.loads((tmp_path / "identified" / "identification.json").read_text())
    moved = {(z["session"], z["actuator"]): z["value"] for z in
             written["gross_errors"]["homing_shifts"]}
    assert moved["session b", "leg3"] == pytest.approx(0.5, abs=0.1)
