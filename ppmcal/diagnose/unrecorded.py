"""What a load that nobody wrote down would do: it cannot be tested, but it can look alike.

A weight that never changes still loads the legs differently from pose to pose. What a
compliance makes of it is known but for its size, so it can be compared with what was named.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.diagnose.forms import Collector, Form
from ppmcal.diagnose.search import Search, columns_of
from ppmcal.diagnose.system import Part
from ppmcal.kinematics.effect_response import setting
from ppmcal.linalg import known
from ppmcal.model.effects import Setting, effect_kinds

KIND, PARAMETER = "compliance", "stiffness"
ALIKE = 0.5
"""It looks like an effect if it explains this part of what the effect does."""


def unrecorded_load(to: Collector) -> None:
    """Add what compliance does under a constant weight of 1 N, where no load was recorded."""
    if any(known(p.response.rows.wrench).any() for p in to.system.parts):
        return
    kind = effect_kinds()[KIND]
    spec = next(s for s in kind.parameters(to.motion) if s.name == PARAMETER)
    settings = [_weighed(p, to) for p in to.system.parts]
    own = {}
    for a, name in enumerate(to.actuators):
        one = np.arange(len(to.actuators)) == a
        terms = [kind.evaluate(s, one, {PARAMETER: 1.0}).by[PARAMETER] for s in settings]
        own[name] = to.add(-to.system.column(terms))  # d/d(1/k) at k = 1
    whole = to.add(np.sum([to.columns[c] for c in own.values()], axis=0))
    for on, column in [((name,), c) for name, c in own.items()] + [(to.actuators, whole)]:
        to.unrecorded.append(Form(KIND, tuple(on), True, (PARAMETER,), (0.0,), (spec.high,),
                                  (column,)))


def _weighed(part: Part, to: Collector) -> Setting:
    """Return the setting of a part under the weight."""
    response = part.response
    wrench = np.zeros((len(response.pose), 6))
    wrench[:, :3] = to.system.problem.mechanism.gravity
    model = response.closure.model
    return setting(replace(model, shift=None), replace(response.rows, wrench=wrench),
                   response.closure.q, response.pose, model)


def look_alikes(search: Search, forms: Sequence[Form], chosen: Sequence[int], effect: int
                ) -> list[Form]:
    """Return the best of ``forms`` that explains most of what a chosen effect does, if any."""
    form = search.forms[effect]
    if form.slot or not form.on:
        return []
    rest = search.gram.given(columns_of(search, [i for i in chosen if i != effect]))
    goal = float(rest.explained(np.array([form.columns]))[0][0])
    best: tuple[float, Form] | None = None
    for other in forms:
        if not set(other.on) & set(form.on) or rest.right[other.columns[0]] <= 0.0:
            continue
        share = float(rest.explained(np.array([other.columns]))[0][0]) / goal
        if share >= ALIKE and (best is None or share > best[0]):
            best = share, other
    return [best[1]] if best else []
