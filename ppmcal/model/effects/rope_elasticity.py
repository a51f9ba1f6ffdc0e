"""Ropes that are stretched by their tension, and whose chord is shortened by their own weight.

The tension is the measured one, otherwise that from the platform's load: without redundant limbs
it follows from statics. A rope that would have to push is slack. The sag is that of a parabola: a
rope of length u and horizontal span h is longer than its chord by w^2 h^2 u/(24 f^2).
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    KnownRange,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift, total


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Du = elongation u f - weight^2 h^2 u/(24 f^2), h the rope's horizontal span."""
    ropes = [(i, limb) for i, limb in enumerate(setting.limbs)
             if limb.pulls_only and on[limb.actuator]]
    weight = values["weight"]
    # a slack rope does not stretch; with a weight its sag is undetermined
    slack = np.nan if weight else 0.0
    pull = {i: np.where(setting.tension[:, limb.actuator] <= 0.0, slack,
                        setting.tension[:, limb.actuator]) for i, limb in ropes}
    stretch = linear(values, {"elongation": Shift({
        (i, "offset"): limb.struts["offset"] * pull[i] for i, limb in ropes})})
    if weight == 0.0:
        return stretch
    sag = Shift({(i, "offset"): (weight * setting.spans[:, i] / pull[i])**2
                 * limb.struts["offset"] / 24.0 for i, limb in ropes})
    return Terms(total([stretch.shift, sag.times(-1.0)]), stretch.by)


ROPE_ELASTICITY = register(EffectKind(
    "rope_elasticity", "du = elongation u f - weight^2 h^2 u/(24 f^2), f the rope's tension, h "
    "its horizontal span", "Hooke's law of a rope, f u/(E A); Pott: Cable-driven parallel robots "
    "(2018): sag of a parabola",
    fixed_list(EffectParameter("elongation", "1/N", low=0.0, usual=(0.0, 1e-3), size=1e-8,
                               why="1/(E A): fishing lines of 1 mm give 1e-4 per N, steel ropes of "
                               "6 mm 5e-7"),
               EffectParameter("weight", "load/length", low=0.0, constant=True)),
    ("tension",), _terms, title="elasticity and weight of ropes",
    remedy="record the tension of each rope",
    worked=Worked({"elongation": 1e-5, "weight": 0.3},
                  {"travel": 2.0, "pull": 50.0, "span": 1.5}, 1e-3 - 0.3**2 * 1.5**2 * 2.0 / 6e4),
    joints="ropes", uses_load=True, known=(KnownRange(
        "tension", "N", 0.0, np.inf, 0.0, lambda setting: setting.tension),)))
