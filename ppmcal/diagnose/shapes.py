"""Anonymous shapes: what local damage, a bent guide or a lens does, without a name."""

from __future__ import annotations

import numpy as np

from ppmcal.diagnose.forms import Collector, Form
from ppmcal.linalg import Array
from ppmcal.model.effects import Shift

LOCAL, DISTORTION = "local", "distortion"
SHAPES = (*((i / 12.0, w) for i in range(13) for w in (0.05, 0.1)),
          *((i / 24.0, 0.0) for i in range(2, 23)))
"""Anonymous shapes: place and width in parts of the stroke; width 0 is a kink."""


def shapes(to: Collector) -> None:
    """Add anonymous shapes: bumps and kinks along each joint, distortion of positions.

    They are what local damage, a bent guide or a lens does, and more; what they fit has no
    name here.
    """
    everything = np.ones_like(to.turning)
    for a, name in enumerate(to.actuators):
        one = np.arange(everything.size) == a
        travel = np.concatenate([p.setting.travel[:, a] for p in to.system.parts])
        low, length = float(travel.min()), float(np.ptp(travel)) or 1.0
        for at, width in SHAPES:
            shifts = [p.setting.at_joints(_shape(p.setting.travel, low + at * length,
                                                 width * length), one)
                      for p in to.system.parts]
            to.forms.append(Form(
                LOCAL, (name,), True, ("height",), (-np.inf,), (np.inf,),
                (to.shifted(shifts),), anonymous=True,
                searched=2 if width else 1))
    points = [p.response.seen.points[p.response.end] for p in to.system.parts]
    middle = np.concatenate(points).mean(axis=0)
    shifts = []
    for point in points:
        swell = np.sum((point - middle) ** 2, axis=1)
        # a stretch that carries each point along its own way from the middle
        along = np.maximum(np.sum(point**2, axis=1), 1e-12)[:, None, None]
        turn = np.eye(3) - middle[:, None] * point[:, None, :] / along
        shifts.append(Shift(stretch=swell[:, None, None] * turn))
    to.forms.append(Form(DISTORTION, (), True, ("cubic",), (-np.inf,), (np.inf,),
                           (to.shifted(shifts),), anonymous=True))


def _shape(travel: Array, at: float, width: float) -> Array:
    """Return a bump of a width, or a kink where the width is 0."""
    away = travel - at
    return np.asarray(np.exp(-0.5 * (away / width) ** 2) if width else np.maximum(away, 0.0))
