"""Effects searched in heights and distances, also between two platform positions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from helpers.instruments import data_of, truth
from helpers.printers import joints_at, printer, touches
from helpers.rounds import stage_at
from numpy.typing import NDArray

from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.diagnose import diagnose
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.diagnosis.unknown_causes import OFF_BY, UnknownCauses
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import Given, Mechanism, with_effect

Array = NDArray[np.float64]


def distances(mechanism: Mechanism, g: Array, rng: np.random.Generator, n: int) -> Dataset:
    """Return distances between pairs of positions above the bed, to 0.01 mm."""
    ends = np.zeros((2, n, 6))
    for part in ends:
        angle, radius = rng.uniform(0, 2 * np.pi, n), 0.1 * np.sqrt(rng.uniform(0.1, 1.0, n))
        part[:, 0], part[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
        part[:, 2] = rng.uniform(0.0, 0.08, n)
    q, to_q = (joints_at(mechanism, g, part) for part in ends)
    return replace(data_of(mechanism, "distance", q, to_q, g, rng, 1e-5, False), name="pairs")


def bent(data: Dataset, tower: int, height: float) -> Dataset:
    """Return the data as if one tower's drive had a parabola of a height (m) over 1e4 steps."""
    middle = float(np.median(data.q[:, tower]))

    def believed(q: Array) -> Array:
        out = q.copy()
        out[:, tower] += height / 1.25e-5 * ((q[:, tower] - middle) / 1e4) ** 2
        return out

    return replace(data, q=believed(data.q),
                   to_q=None if data.to_q is None else believed(data.to_q))


def campaign(tmp_path: Path, seed: int, height: float) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return touches and pairs of one printer whose tower a is bent."""
    mechanism = printer(tmp_path, ratio=-0.0125)
    rng = np.random.default_rng([31, seed])
    g = truth(mechanism, rng, 0.5)
    data = touches(mechanism, g, rng, 60), distances(mechanism, g, rng, 60)
    return mechanism, tuple(bent(d, 0, height) for d in data)


def search(tmp_path: Path, seed: int, height: float) -> Diagnosis:
    mechanism, data = campaign(tmp_path, seed, height)
    return diagnose(Problem(mechanism, data, mechanism.free))


@pytest.mark.slow
def test_columns_of_pairs_are_differences(tmp_path: Path) -> None:
    """Every kind's column of a distance between two positions, against differences."""
    mechanism, data = campaign(tmp_path, 1, 0.0)
    problem = Problem(mechanism, data[1:], mechanism.free)
    fit = identify(problem)
    stage = stage_at(fit, ("curvature", "periodic"))
    kind = effect_kinds()["curvature"]
    for form in stage.library.hypotheses:
        if form.kind != "curvature" or form.on != ("b",):
            continue
        low, high = (form.constants[n] for n in ("low", "high"))
        for n, name in enumerate(("p2", "p3", "p4")):
            sides = []
            for sign in (1.0, -1.0):
                values = {m: Given(sign * 1e-6 if m == name else 0.0) for m in ("p2", "p3", "p4")}
                values |= {"low": Given(low), "high": Given(high)}
                one = with_effect(mechanism, kind, (False, True, False), values)
                g = np.concatenate([fit.state.g, one.values[len(fit.state.g):]])
                now = replace(problem, mechanism=one.with_values(g))
                state = now.solve(replace(fit.state, g=g))
                sides.append(np.concatenate([r.residual for r in now.rows(state, False,
                                                                          fit.keep)]))
            slope = -(sides[0] - sides[1]) / 2e-6
            found = stage.library.columns[..., form.columns[n]]
            assert np.max(np.abs(found - slope)) < 1e-4 * np.max(np.abs(slope))
        break
    else:
        pytest.fail("no curvature on tower b was tried")


@pytest.mark.long
def test_a_bent_tower_is_found_in_heights_and_pairs(tmp_path: Path) -> None:
    """What is there acts on tower a, and what is learned of it predicts what is held out."""
    found = search(tmp_path, 2, 2e-4)
    assert found.verdict == "unnamed"
    assert [u.looks_like for u in found.unknown] == ["a function of travel acting on a"]
    assert found.learned is not None and found.learned.gap.after < found.learned.gap.before


@pytest.mark.long
def test_nothing_is_found_where_nothing_is(tmp_path: Path) -> None:
    assert search(tmp_path, 3, 0.0).verdict == "none"


@pytest.mark.slow
def test_pairs_alone_can_be_searched(tmp_path: Path) -> None:
    mechanism, data = campaign(tmp_path, 10, 0.0)
    found = diagnose(Problem(mechanism, data[1:], mechanism.free))
    assert found.verdict in ("none", "weak")


def test_a_constant_of_all_distances_is_asked_for(tmp_path: Path) -> None:
    """It does in each distance what the noise is in units of, and nothing in heights."""
    mechanism, data = campaign(tmp_path, 1, 0.0)
    data = tuple(d.take(np.arange(60) < 20) for d in data)
    problem = Problem(mechanism, data, mechanism.free)
    system = build(problem, problem.start(), [np.ones(len(d), dtype=bool) for d in data])
    asked = UnknownCauses(system, [p.setting for p in system.firsts])
    first = 0
    for cause in asked.causes:
        if cause.label == OFF_BY:
            column = asked.columns.some([first]).reshape(system.observed.shape)
            assert not column[system.dataset == 0].any()
            np.testing.assert_allclose(column[system.dataset == 1, 0], 1.0 / 1e-5)
            assert "`distance`" in cause.remedy
            break
        first += cause.width
    else:
        pytest.fail("no constant was asked for")


@pytest.mark.slow
def test_a_constant_of_all_distances_is_told(tmp_path: Path) -> None:
    """A ball's radius that was left in is no gain, and no zero that moved between two files."""
    mechanism, (heights, pairs) = campaign(tmp_path, 3, 0.0)
    data = heights, replace(pairs, value=pairs.value + 5e-3)
    found = diagnose(Problem(mechanism, data, mechanism.free))
    assert found.verdict == "unnamed"
    assert [u.looks_like for u in found.unknown] == [OFF_BY]
