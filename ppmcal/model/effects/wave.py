"""Amplitude and phase of a wave fitted as a cosine and a sine.

    cos cos w + sin sin w = amplitude cos(phase + w - w0),  w0 at mid-stroke

Cosine and sine refer to the joint's zero, which may be many periods away: there an error of the
period changes the phase, and the two say little. They are best known at mid-stroke.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import atan2, hypot, pi, remainder

from ppmcal.model.effects.kind import Derived

Values = Mapping[str, float]


def wave(cos: str, sin: str, turn: Callable[[Values, float], float], number: str = ""
         ) -> tuple[Derived, Derived]:
    """Return amplitude and phase of one wave.

    Args:
        cos: name of the cosine's parameter.
        sin: name of the sine's.
        turn: (parameters, joint coordinate ratio q, m or rad) -> w, rad.
        number: suffix of the figures' names.
    """
    def phase(values: Values, middle: float) -> float:
        return remainder(turn(values, middle) - atan2(values[sin], values[cos]), 2.0 * pi)

    return (Derived(f"amplitude{number}", "joint", lambda v, _: hypot(v[cos], v[sin])),
            Derived(f"phase{number}_mid_stroke", "angle", phase))
