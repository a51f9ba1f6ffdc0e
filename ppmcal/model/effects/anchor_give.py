"""Frame compliance at the anchors: each gives towards the platform with the tension of its rope.

Tensions as in ``rope_stretch``; the size refers to the ropes that pull.
"""

from __future__ import annotations

import numpy as np

from ppmcal.model.effects.kind import EffectKind, EffectParameter, Worked, fixed_list, register
from ppmcal.model.effects.rope_stretch import STATICS, per_tension

ANCHOR_GIVE = register(EffectKind(
    "anchor_give", "du = give f/pull, f the rope's tension where the ropes `on` pull and the "
    "others hold", f"a frame that gives at its anchors towards the platform; {STATICS}",
    fixed_list(EffectParameter("give", "length", low=0.0, usual=(0.0, 0.05), size=1e-5,
                               why="posts and arms a few metres long give a few millimetres")),
    (), per_tension("give", np.ones_like), title="frame that gives under the ropes",
    remedy="pull with another force, or measure an anchor's position while the ropes pull",
    worked=Worked({"give": 4e-3}, {"travel": 2.0, "tension": 1.5}, 6e-3),
    joints="ropes", opposed=True, uses_load=True))
