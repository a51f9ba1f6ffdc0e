"""Rounds of questions: what goes from one to the next, and when they end."""

from __future__ import annotations

from ppmcal.diagnosis.explanation import _key
from ppmcal.diagnosis.hypotheses import Hypothesis


def periodic(period: float, low: float) -> Hypothesis:
    """Return an error with a period of its own, over a stroke from ``low`` on."""
    return Hypothesis("periodic", ("leg1",), True, ("size",), (0.0,), (1.0,), (0,),
                      constants={"period": period, "low": low}, strokes=("low",))


def test_a_cause_is_the_same_whatever_the_stroke_that_was_measured() -> None:
    assert _key(periodic(0.1, 0.2)) == _key(periodic(0.1, 0.2001))
    assert _key(periodic(0.1, 0.2)) != _key(periodic(0.2, 0.2))
