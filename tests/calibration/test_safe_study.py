"""Commands of random machines, each driven on the true one: a slice of the study in docs/trust.md.
"""

from __future__ import annotations

import pytest
from safe_commands import study


def assert_safe(machines: int, seed: int, names: tuple[str, ...] = ()) -> None:
    tally = study(machines, seed, names)
    assert tally.sent > 0.9 * tally.rows > 0
    assert (tally.outside, tally.crossed, tally.jumps) == (0, 0, 0)
    assert tally.worse <= 0.002 * tally.sent
    assert tally.missed <= 0.01 * tally.rows
    assert sum(tally.reasons.values()) <= 0.01 * tally.rows


@pytest.mark.long
def test_a_few_machines_are_driven_safely() -> None:
    assert_safe(4, 2, ("3-RPR", "delta-linear", "3-RPS", "6-UPS"))
