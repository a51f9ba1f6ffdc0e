"""A size that no machine within its tolerances has costs what its prior says."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hidden import Options, hide
from numpy.typing import NDArray

from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.added_variable_test import build_test
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.hypotheses import Hypothesis, united
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.search import Search
from ppmcal.diagnosis.selection import bic, choose, size_costs

Array = NDArray[np.float64]
ROWS = 80


def made(names: int, **traits: Any) -> Hypothesis:
    """Return a hypothesis of one column, any coefficient."""
    return replace(Hypothesis(f"kind{names}", (), True, ("c",), (-np.inf,), (np.inf,), (names,)),
                   **traits)


def searched(columns: Array, residual: Array, *hypotheses: Hypothesis) -> Search:
    """Return a search without geometry, noise of 1."""
    test = build_test(np.zeros((ROWS, 0)), columns, residual, ROWS)
    return Search(test, hypotheses, np.log(1e-3), np.log(1e-4), np.zeros(1))


def data(size: float, seed: int = 0) -> tuple[Array, Array]:
    """Return two columns that are nearly one, and a residual that is the first times a size."""
    rng = np.random.default_rng(seed)
    first = rng.normal(size=ROWS)
    columns = np.stack([first, first + 0.1 * rng.normal(size=ROWS)], axis=1)
    return columns, size * first + rng.normal(size=ROWS)


def test_a_slot_costs_the_chi_squared_of_its_tolerance() -> None:
    """What it costs is what the best fit gets worse by once its tolerance is among the rows."""
    columns, residual = data(3.0)
    tolerance = 0.5
    search = searched(columns, residual, made(0, scale=(tolerance,), slot="a.base.point.x"))
    b = columns[:, 0]
    left = float(residual @ residual - (b @ residual) ** 2 / (b @ b))
    noise = left / (ROWS - 1)
    held = (b @ residual) / (b @ b + noise / tolerance**2)
    with_prior = float(np.sum((residual - held * b) ** 2)) / noise + (held / tolerance) ** 2
    assert size_costs(search, [0])[0] == pytest.approx(with_prior - left / noise, rel=1e-9)


@pytest.mark.parametrize("slot", ["", "a.base.point.x"])
def test_a_size_of_machines_costs_next_to_nothing(slot: str) -> None:
    """Within its scale an effect keeps its BIC; without a scale it is the same to the digit."""
    columns, residual = data(3.0)
    free, wide = (searched(columns, residual, made(0, scale=(s,), slot=slot))
                  for s in (np.inf, 300.0))
    assert bic(free, [0]) == bic(searched(columns, residual, made(0)), [0])
    assert 0.0 < bic(wide, [0]) - bic(free, [0]) < 1e-3


def test_a_size_that_no_machine_has_loses_to_its_rival() -> None:
    """The data prefer the first by little: a scale far below what they ask for decides."""
    columns, residual = data(3.0, 4)
    plain = searched(columns, residual, made(0), made(1))
    assert choose(plain)[0].chosen == (0,)
    near, far = (searched(columns, residual, made(0, scale=(s,)), made(1)) for s in (3.0, 1e-9))
    assert choose(near)[0].chosen == (0,)
    assert choose(far)[0].chosen == (1,)


def test_one_cause_on_several_joints_has_one_size() -> None:
    """Twice as many values that are as far off cost more than one, less than two causes."""
    rng = np.random.default_rng(2)
    columns = rng.normal(size=(ROWS, 2))
    residual = columns @ [5.0, 5.0] + rng.normal(size=ROWS)
    each = [made(c, on=(name,), scale=(0.1,)) for c, name in enumerate("ab")]
    apart = searched(columns, residual, *each)
    both = searched(columns, residual, united(each))
    assert max(size_costs(apart, [0, 1])) < size_costs(both, [0])[0] < sum(
        size_costs(apart, [0, 1]))


def test_what_the_data_leave_open_of_a_size_costs_nothing() -> None:
    """A size that is mostly noise, however large the best fit has it, says nothing of machines."""
    rng = np.random.default_rng(5)
    columns, residual = 1e-3 * rng.normal(size=(ROWS, 1)), rng.normal(size=ROWS)
    search = searched(columns, residual, made(0, scale=(1.0,)))
    assert abs(search.test.fit([0])[0][0]) > 10.0
    assert size_costs(search, [0])[0] < np.log(ROWS)


def test_drives_have_the_scale_of_the_joints_and_slots_their_tolerance() -> None:
    """Half the tolerances, half of what an error of a drive and one of a slot may be."""
    found = hide("3-RPR", 7, [], 1.0, Options(poses=12))

    done = identify(Problem(found.mechanism, (found.dataset,), found.mechanism.free[:6]))

    def scales(part: float) -> dict[str, tuple[float, ...]]:
        mechanism = replace(done.problem.mechanism, parameters=tuple(
            p if p.tolerance is None else replace(p, tolerance=part * p.tolerance)
            for p in done.problem.mechanism.parameters))
        system = build(replace(done.problem, mechanism=mechanism), done.state, done.keep)
        every = library(system, kinds=["curvature", "gain", "geometry"])
        return {f.label + f" {f.shared}": f.scale for f in every.hypotheses}

    whole, half = scales(1.0), scales(0.5)
    assert whole.keys() == half.keys()
    for name, scale in whole.items():
        assert half[name] == pytest.approx(0.5 * np.array(scale), rel=1e-6)
        if not name.startswith("geometry"):
            assert np.isfinite(scale).all() == name.startswith("curvature")
    slots = {f"geometry {p.name} True": p.prior_sigma for p in found.mechanism.parameters}
    frozen = [n for n in whole if slots.get(n)]
    assert frozen and all(whole[n] == (slots[n],) for n in frozen)
