"""A zero that is off for a while is told from slow noise, and slow noise from such a zero."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ppmcal.diagnosis.event_pairs import best_pair
from ppmcal.diagnosis.linear_system import Whitening

ROWS, VALUES, JOINTS = 90, 3, 3
ONSETS = range(3, ROWS - 2)


def scene(seed: int, rho: float, step: float) -> tuple[Any, Any]:
    """A linear system and its library; joint 0 is off by ``step`` noises in rows 25 to 54."""
    rng = np.random.default_rng(seed)
    noise = rng.normal(size=(ROWS, VALUES))
    for row in range(1, ROWS):
        noise[row] = rho * noise[row - 1] + np.sqrt(1.0 - rho**2) * noise[row]
    give = rng.normal(size=(ROWS, VALUES, JOINTS))
    order = np.arange(ROWS)
    steps = (order[:, None] >= np.array(ONSETS)).astype(float)[:, None, :]
    columns = np.concatenate([give[..., [j]] * steps for j in range(JOINTS)], axis=-1)
    off = ((order >= 25) & (order < 55))[:, None]
    geometry = np.concatenate([give, rng.normal(size=(ROWS, VALUES, 9))], axis=-1)
    system = SimpleNamespace(
        residual=noise + step * off * give[..., 0], jacobian=geometry,
        observed=np.ones((ROWS, VALUES), dtype=bool), dataset=np.zeros(ROWS, dtype=np.int64),
        apart=np.ones(ROWS - 1, dtype=np.int64), count=ROWS * VALUES,
        problem=SimpleNamespace(datasets=(None,)))
    each = [SimpleNamespace(effect=SimpleNamespace(onset="from_row"), size=1, columns=(c,),
                            family="zero_shift", on=(f"leg{c // len(ONSETS)}",))
            for c in range(columns.shape[-1])]
    return system, SimpleNamespace(some=lambda which: columns[..., list(which)], hypotheses=each)


def pair(seed: int, rho: float, step: float) -> list[tuple[int, int]]:
    """Joint and row of each event that is found."""
    system, library = scene(seed, rho, step)
    found = best_pair(system, library, [], _white())
    return [(c // len(ONSETS), ONSETS[c % len(ONSETS)]) for c in found]


def _white() -> Whitening:
    inner: NDArray[np.float64] = np.eye(VALUES)[None]
    return Whitening(inner, 0.4)


def test_a_zero_that_is_off_for_a_while() -> None:
    for seed in range(5):
        (first, begin), (second, end) = pair(seed, 0.0, 3.0)
        assert first == second == 0
        assert abs(begin - 25) <= 2 and abs(end - 55) <= 2


def test_in_slow_noise_too() -> None:
    """The pair is judged beside whatever correlation there is."""
    (first, _), (second, _) = pair(1, 0.5, 3.0)
    assert first == second == 0


def test_slow_noise_is_no_pair_of_events() -> None:
    found = [pair(seed, rho, 0.0) for rho in (0.0, 0.6) for seed in range(15)]
    assert not any(found)
