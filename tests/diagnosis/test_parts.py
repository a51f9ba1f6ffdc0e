"""The pieces of a diagnosis, each against an answer that is known another way."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import hidden
import numpy as np
import pytest
from helpers.rounds import last_round

from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.grids import usual_range
from ppmcal.diagnosis.hypotheses import Library
from ppmcal.diagnosis.lack_of_fit import pure_error
from ppmcal.diagnosis.linear_system import System, Whitening, build
from ppmcal.diagnosis.linearisation import linearisation_of
from ppmcal.model.effects import EffectParameter, effect_kinds
from ppmcal.model.motions import PLANAR

SMALL = hidden.Options(poses=30)


@cache
def fitted(machine: str, seed: int, kinds: tuple[str, ...], eta: float, options: hidden.Options
           ) -> tuple[Problem, Any]:
    made = hidden.hide(machine, seed, list(kinds), eta, options)
    problem = Problem(made.mechanism, (made.dataset,), made.mechanism.free)
    return problem, identify(problem)


def system_of(machine: str, seed: int, kinds: tuple[str, ...] = (), eta: float = 1.0,
              options: hidden.Options = hidden.USUAL) -> tuple[System, Library]:
    problem, fit = fitted(machine, seed, kinds, eta, options)
    system = build(problem, fit.state, fit.keep)
    return system, library(system)


@pytest.mark.slow
def test_pure_error_does_not_pool_directions() -> None:
    """Repeats with a large backlash: the scatter is still the noise; directions are apart."""
    options = hidden.Options(poses=20, repeats=3, columns=("dir",))
    system, _ = system_of("3-RPR", 6, ("backlash",), 5.0, options)
    pure = pure_error(system)
    rows = len(system.residual)
    assert pure is not None
    assert pure.freedom <= 20 * 2 * 2 * 3
    assert pure.freedom > 0.8 * 20 * 2 * 2 * 3 * rows / 120
    assert abs(pure.ratio**2 - 1.0) < 4.0 * np.sqrt(2.0 / pure.freedom)
    assert float(np.sum(system.residual**2)) / system.count > 4.0


def test_pure_error_of_rows_without_repeats() -> None:
    options = hidden.Options(poses=20, repeats=1, columns=("dir",))
    assert pure_error(system_of("3-RPR", 6, (), 1.0, options)[0]) is None


def test_repeats_at_nearly_the_same_temperature_are_repeats() -> None:
    """A thermometer read to 0.01 K wanders; the machine does not notice."""
    options = hidden.Options(poses=20, repeats=3, columns=("dir",))
    made = hidden.hide("3-RPR", 6, [], 1.0, options)
    wander = 1e-3 * np.random.default_rng(0).normal(size=len(made.dataset))
    data = replace(made.dataset, columns={**made.dataset.columns, "temperature": 293.15 + wander})
    problem = Problem(made.mechanism, (data,), made.mechanism.free)
    fit = identify(problem)
    pure = pure_error(build(problem, fit.state, fit.keep))
    assert pure is not None
    assert pure.freedom > 150


# --- what is in the data --------------------------------------------------------------------------


@cache
def asked(machine: str, seed: int, kinds: tuple[str, ...] = (), eta: float = 1.0,
          options: hidden.Options = SMALL) -> Round:
    made = hidden.hide(machine, seed, list(kinds), eta, options)
    return last_round(made.mechanism, made.dataset)


@pytest.mark.long_cases("0.6-kinds1")
@pytest.mark.slow
@pytest.mark.parametrize(("ar", "kinds"), [(0.0, ()), (0.6, ("drift",))])
def test_correlation_is_that_of_the_noise(ar: float, kinds: tuple[str, ...]) -> None:
    """What is slow is not taken for noise."""
    found = asked("3-RPR", 41, kinds, 3.0, hidden.Options(poses=40, ar=ar)).whitening
    assert abs(found.rho - ar) < 0.2
    assert found.rho_error < 0.2


@pytest.mark.long
def test_a_strong_slow_effect_is_not_whitened_away() -> None:
    """Drift in correlated noise is named."""
    found = asked("3-RPR", 41, ("drift",), 3.0, hidden.Options(poses=40, ar=0.6))
    assert [p.hypothesis.kind for p in found.places if p.hypothesis] == ["drift"]
    assert found.verdict in ("named", "named-set")


@pytest.mark.long
def test_sensor_scale_and_gain_of_all_encoders_are_not_told_apart() -> None:
    """A larger machine and a longer ruler are the same to every measured pose."""
    system, found = system_of("6-UPS", 9, ("sensor_scale",), 1.0, SMALL)
    stage = linearisation_of(system, found, (), Whitening())
    scale, gain = (next(h for h in found.hypotheses if h.kind == kind and h.shared
                        and len(h.on) != 1) for kind in ("sensor_scale", "gain"))
    a, b = (stage.past(h.columns)[0][:, 0] for h in (scale, gain))
    assert abs(a @ b) / (np.linalg.norm(a) * np.linalg.norm(b)) > 0.995
    place, = asked("6-UPS", 9, ("sensor_scale",)).places
    assert {"sensor_scale", "gain"} <= {m.family for m in place.members}


# --- the library ----------------------------------------------------------------------------------


def surrounded(part: Any, **changes: Any) -> Any:
    """Return a part whose rows' effects depend on something else."""
    rows = replace(part.response.rows, **changes)
    return replace(part, response=replace(part.response, surroundings=lambda: rows))


@pytest.mark.slow
def test_what_is_optional_is_tried_alone_after_the_plain_kind() -> None:
    """And not where its columns are missing."""
    system, found = system_of("3-RPR", 1)
    optional = {s.name for s in effect_kinds()["compliance"].parameters(PLANAR) if s.optional}
    for kind in ("compliance", "leg_thermal"):
        own = [f for f in found.hypotheses if f.family == kind and len(f.on) == 1]
        have = [set(f.constants) & (optional | {"tau"}) for f in own]
        assert not have[0] and all(len(h) <= 1 for h in have)
        assert not any(f.constants[n] == 0.0 for f, h in zip(own, have, strict=True) for n in h)
        assert set().union(*have) == ({"tau"} if kind == "leg_thermal" else optional)
    forgetful = [surrounded(p, history=None) for p in system.parts]
    less = library(replace(system, parts=tuple(forgetful)), ["leg_thermal"])
    assert {f.family for f in less.hypotheses} == {"leg_thermal"}
    assert not any("tau" in f.constants for f in less.hypotheses)


@pytest.mark.slow
def test_one_of_two_kinds_of_a_name_may_be_untestable() -> None:
    """Heat of the drives is tested without a thermometer; heat of the hall stays listed."""
    system, _ = system_of("3-RPR", 1)
    cold = [surrounded(p, temperature=np.full_like(p.response.rows.temperature, np.nan))
            for p in system.parts]
    less = library(replace(system, parts=tuple(cold)))
    assert "leg_thermal" in {h.kind for h in less.hypotheses}
    assert "leg_thermal" in {u.kind for u in less.untestable}
    assert "leg_thermal" not in {u.kind for u in library(system).untestable}


@pytest.mark.parametrize(("traits", "expected"), [
    ({}, (-np.inf, np.inf)), ({"usual": (0.0, 0.05), "of_stroke": True}, (0.0, 0.02)),
    ({"reciprocal": True}, (0.0, np.inf)),
    ({"reciprocal": True, "usual": (10.0, 1e4)}, (1e-4, 0.1))])
def test_the_range_of_a_coefficient(traits: dict[str, Any], expected: tuple[float, float]) -> None:
    """A kind that says no range has any; a reciprocal one is judged by its inverse."""
    found = usual_range(EffectParameter("k", "joint", **traits), 0.4)
    assert found == pytest.approx(expected)
