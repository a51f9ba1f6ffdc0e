"""Ropes that stretch under tension, where some pull and the others hold against them.

Ropes pulled tight with a given force put a tension into the others that follows from the
equilibrium of the platform: it changes with the pose, and so does the stretch of each rope. The
strain is that of the ropes that pull.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Evaluate,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift


def per_tension(name: str, of_rope: Callable[[Array], Array]) -> Evaluate:
    """Return du = size of_rope(u) t, t the tensions relative to that of the ropes that pull."""
    def evaluate(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
        tension = setting.tensions(on)
        return linear(values, {name: Shift({
            (i, "offset"): of_rope(limb.struts["offset"]) * tension[:, limb.actuator]
            for i, limb in enumerate(setting.limbs) if limb.pulls_only})})
    return evaluate


STATICS = "statics of the platform: A' f = 0 with the pull of the ropes that are pulled tight"

ROPE_STRETCH = register(EffectKind(
    "rope_stretch", "du = strain u f/pull, f the rope's tension where the ropes `on` pull and the "
    "others hold", f"Hooke's law of a rope, f u/(E A); {STATICS}",
    fixed_list(EffectParameter("strain", "1", low=0.0, usual=(0.0, 0.02), size=1e-5,
                               why="polyurethane belts with steel or glass cords stretch by 0.2 to "
                               "0.4 % at their rated force, fibre ropes by up to 2 %")),
    (), per_tension("strain", lambda u: u), title="stretch of ropes",
    remedy="pull with another force",
    worked=Worked({"strain": 2e-3}, {"travel": 2.0, "tension": 1.5}, 6e-3),
    joints="ropes", opposed=True, uses_load=True))
