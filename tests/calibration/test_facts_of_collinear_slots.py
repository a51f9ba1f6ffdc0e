"""Kinds of slot of which the data see only what they make together, on columns by hand."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from ppmcal.calibration.fit.linearisation import SquareRootInformation
from ppmcal.calibration.knowledge import identifiability_report as identifiability
from ppmcal.calibration.knowledge.identifiability_report import (
    CALIPER,
    LOOSE,
    LOST,
    MATTERS,
    ONE,
    OPEN,
    SHARE,
    Scale,
    _collinear,
)

Array = NDArray[np.float64]
LIMBS = ("leg1", "leg2", "leg3")


def found(monkeypatch: pytest.MonkeyPatch, rows: Array, columns: dict[str, dict[str, int]],
          prior: float = 1.0, after: Array | None = None) -> list[tuple[str, str, float, bool]]:
    """Return what is told of slots by limb, of a fit whose white rows and tolerances are given."""
    count = rows.shape[1]
    weights = np.full(count, prior)
    fit: Any = SimpleNamespace(
        problem=SimpleNamespace(free=tuple(range(count)), mechanism=None), prior=weights,
        stated=np.zeros(count),
        scale=np.ones(count),
        information=SquareRootInformation(np.linalg.qr(rows)[1], np.zeros(count), 0.0, 99))
    known = np.linalg.inv(rows.T @ rows + np.diag(weights**2)) if after is None else after
    monkeypatch.setattr(identifiability, "posterior", lambda fit: known)
    monkeypatch.setattr(identifiability, "kinds_of", lambda mechanism, free: columns)
    return [(c.one, c.other, c.correlation, c.each) for c in _collinear(fit)]


def pairs(limbs: int, sign: Array, own: float = 0.0, n: int = 60) -> tuple[Array, Any]:
    """Return rows in which a length and an offset of each limb are seen together."""
    rng = np.random.default_rng(1)
    seen = rng.normal(size=(n, limbs))
    more = own * rng.normal(size=(n, limbs))
    columns = {"length": {k: i for i, k in enumerate(LIMBS[:limbs])},
               "offset": {k: limbs + i for i, k in enumerate(LIMBS[:limbs])}}
    return np.concatenate([seen, sign * seen + more], axis=1), columns


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("limbs", [1, 2, 3])
def test_two_slots_that_are_seen_together_are_told(monkeypatch: pytest.MonkeyPatch, limbs: int,
                                                   sign: float) -> None:
    """Their sums and each limb's own; one limb alone is not limb by limb."""
    rows, columns = pairs(limbs, np.full(limbs, sign))
    (one, other, r, alike), = found(monkeypatch, rows, columns)
    assert (one, other, alike) == ("length", "offset", limbs > 1)
    assert r * sign < -ONE


@pytest.mark.parametrize("limbs", [2, 3])
def test_limbs_of_either_sign_are_told_limb_by_limb(monkeypatch: pytest.MonkeyPatch, limbs: int
                                                    ) -> None:
    """The sums of both slots have nothing in common then; the first limb's own is said."""
    sign = np.array([1.0, -1.0, 1.0])[:limbs]
    rows, columns = pairs(limbs, sign)
    (_, _, r, alike), = found(monkeypatch, rows, columns)
    assert alike
    assert r < -ONE


def test_what_is_known_well_or_apart_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    """By data of their own, by a tolerance that leaves nothing open, or in no one's sight."""
    rows, columns = pairs(3, np.ones(3))
    assert found(monkeypatch, pairs(3, np.ones(3), own=0.7)[0], columns) == []
    assert len(found(monkeypatch, rows, columns)) == 1
    part = 0.9 * OPEN**2 * np.eye(6)
    assert found(monkeypatch, rows, columns, after=part) == []
    assert len(found(monkeypatch, rows, columns, after=part / 0.8)) == 1
    assert found(monkeypatch, rows, columns, after=np.full((6, 6), np.inf)) == []
    partly = np.eye(6)
    partly[0, 0] = np.inf
    assert found(monkeypatch, rows, columns, after=partly) == []


def test_a_flat_prior_counts_as_a_tolerance_of_one(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, columns = pairs(2, np.ones(2), own=0.05)
    assert len(found(monkeypatch, rows, columns, prior=0.0, after=0.2 * np.eye(4))) == 1
    assert found(monkeypatch, rows, columns, prior=0.0, after=0.08 * np.eye(4)) == []


def test_a_slot_shared_by_both_kinds_is_no_pair_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    rows, columns = pairs(2, np.ones(2))
    columns["offset"]["leg2"] = columns["length"]["leg2"]
    told = found(monkeypatch, rows, columns)
    assert [alike for *_, alike in told] in ([], [False])


@pytest.mark.parametrize("length", [0.01, 1.0, 50.0])
def test_a_scale_is_judged_by_parts_of_the_distance(length: float) -> None:
    """Held by tolerances where these leave less than seven tenths of what the data do."""
    for part, data, held, lost, open_ in (
            (1.1 * LOST, 1.0, False, True, True), (0.9 * LOST, 1.0, False, False, True),
            (1.1 * LOOSE, 1.0, False, False, True), (0.9 * LOOSE, 1.0, False, False, False),
            (1.1 * LOST, 2.0, True, False, True), (1.1 * MATTERS, 2.0, True, False, True),
            (0.9 * MATTERS, 2.0, True, False, False)):
        scale = Scale(length, part * length, data * part * length)
        assert (scale.prior_dominated, scale.unobservable, scale.open) == (held, lost, open_)
        assert (SHARE * data > 0.99) == held
        # by a caliper of that accuracy half of it would be left
        own = CALIPER * length / scale.needed
        assert 1.0 / np.sqrt(1.0 / scale.sigma**2 + 1.0 / own**2) == (
            pytest.approx(scale.sigma / 2.0))
    assert Scale(length, 0.0, 1.0).needed == 0.0
