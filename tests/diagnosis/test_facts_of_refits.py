"""Fits that start where a fit of the same measurements ended."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from ppmcal.diagnosis import refit
from ppmcal.diagnosis.refit import _near


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
