"""Fits of some rows, and what each effect is worth given all else, against regression."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import f as fisher

from ppmcal.diagnosis import refit
from ppmcal.diagnosis.extended_model import Added
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import Whitening
from ppmcal.diagnosis.refit import _near, own_values

Array = NDArray[np.float64]


@pytest.mark.parametrize(("before", "after", "scratch"), [
    ([[1.0, 1.0], [1.0]], [[1.0, 1.0], [1.0]], False),
    ([[1.0, 1.0], [1.0]], [[1.0, np.nan], [1.0]], True),
    ([[1.0, 1.0], [1.0]], [[1.0, 1.0], [np.nan]], True),
    ([[np.nan, 1.0], [1.0]], [[np.nan, 1.0], [1.0]], False),
    ([[np.nan, 1.0], [1.0]], [[1.0, 1.0], [1.0]], False)])
def test_a_fit_starts_near_by_unless_a_row_is_lost(
        monkeypatch: pytest.MonkeyPatch, before: list[list[float]], after: list[list[float]],
        scratch: bool) -> None:
    """Any row of any file; one that had no pose before is not lost."""
    def state(poses: list[list[float]]) -> Any:
        return SimpleNamespace(poses=tuple(np.array(p)[:, None] for p in poses))

    there = state(after)
    problem: Any = SimpleNamespace(solve=lambda start: there)
    def anew(what: Any, **more: Any) -> Any:
        return what if "iterations" in more else ("anew", more)

    options: Any = SimpleNamespace(most=60)
    monkeypatch.setattr(refit, "replace", anew)
    monkeypatch.setattr(refit, "identify", lambda *known, **more: (known, more))
    found: Any = _near(problem, state(before), options)
    if scratch:
        assert found == ((("anew", {"pivots": None}), options), {})
    else:
        assert found == ((problem, options), {"start": there, "near": True})


def test_an_effect_is_worth_what_it_explains_beside_all_else(monkeypatch: pytest.MonkeyPatch
                                                             ) -> None:
    """The F test of its columns in one regression with geometry and the other effects."""
    rng = np.random.default_rng(1)
    n = 80
    jacobian = rng.normal(size=(n, 1, 6))
    jacobian[:, 0, 4] += jacobian[:, 0, 2]
    size = np.array([0.0, 0.0, 0.5, -0.3, 0.4, 0.0])
    whole = rng.normal(size=n) + jacobian[:, 0] @ size

    def system(columns: Array, residual: Array) -> Any:
        return SimpleNamespace(jacobian=columns, residual=residual[:, None], count=n,
                               observed=np.ones((n, 1), dtype=bool), dataset=np.zeros(n, dtype=int))

    rest = whole - jacobian[:, 0] @ np.linalg.lstsq(jacobian[:, 0], whole)[0]
    best = np.linalg.lstsq(jacobian[:, 0], whole)[0]

    def without(found: Any, own: list[int]) -> Any:
        others = [c for c in range(6) if c not in own]
        return system(jacobian[..., others], rest + jacobian[:, 0, own] @ best[own])

    monkeypatch.setattr(refit, "build", lambda *known: system(jacobian, rest))
    monkeypatch.setattr(refit, "without", without)
    monkeypatch.setattr(refit, "scaling_columns", lambda found, own: {})
    names = ("a", "b", "gain.leg1.gain", "gain.leg2.gain", "lag.tau", "c")

    def added(kind: str, on: tuple[str, ...], parameters: tuple[str, ...]) -> Added:
        made = Hypothesis(kind, on, True, ("c",), (0.0,), (1.0,), (0,))
        fields: dict[str, Any] = {"hypothesis": made, "parameters": parameters}
        more = {f: None for f in Added.__dataclass_fields__ if f not in fields}
        return Added(**(more | fields))

    fit: Any = SimpleNamespace(state=None, problem=SimpleNamespace(
        free=range(6), mechanism=SimpleNamespace(names=names)))
    both = [added("gain", ("leg1", "leg2"), names[2:4]), added("lag", (), names[4:5])]
    found = own_values(fit, both, Whitening(np.eye(1)[None], 0.0), [])
    for key, own in ((("gain", ("leg1", "leg2")), [2, 3]), (("lag", ()), [4])):
        others = jacobian[:, 0][:, [c for c in range(6) if c not in own]]
        more = float(np.sum((whole - others @ np.linalg.lstsq(others, whole)[0]) ** 2))
        ratio = (more - rest @ rest) / len(own) / (rest @ rest / (n - 6))
        assert found[key] == pytest.approx(float(fisher.logsf(ratio, len(own), n - 6)), rel=1e-6)
    assert list(found) == [("gain", ("leg1", "leg2")), ("lag", ())]
