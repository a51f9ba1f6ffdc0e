"""Play that is taken up by degrees: no kind of the library does that."""

from __future__ import annotations

import pytest
from helpers.rounds import last_round
from hidden import Options, hide


@pytest.mark.slow
def test_play_that_ways_take_up_in_part_has_no_name() -> None:
    """Not a backlash, and beside it something that follows the way.

    What its smooth course leaves may be a scatter of the same joint: of that nothing is named.
    """
    made = hide("3-PRR-1", 60378069, ["play_memory"], 1.0, Options(poses=90), "one")
    place, *left = last_round(made.mechanism, made.dataset).places
    assert place.label == (
        "a function of the move from the previous row by direction acting on leg2")
    assert all("unknown" in m.family for m in place.members)
    assert all(p.label.endswith("acting on leg2") and not p.named for p in left)
