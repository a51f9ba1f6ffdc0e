"""Play that is taken up by degrees: no kind of the library does that."""

from __future__ import annotations

import pytest
from helpers.rounds import last_round
from hidden import Options, hide


@pytest.mark.slow
def test_play_that_ways_take_up_in_part_is_one_thing_without_a_name() -> None:
    """Not a backlash, and beside it something that follows the way."""
    made = hide("3-PRR-1", 60378069, ["play_memory"], 1.0, Options(poses=90), "one")
    place, = last_round(made.mechanism, made.dataset).places
    assert place.label == (
        "a function of the way from the row before by direction acting on leg2")
    assert all("unknown" in m.family for m in place.members)
