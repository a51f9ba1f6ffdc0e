"""What kinds do under a weight that nobody recorded: what looks like it cannot be told from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.diagnosis.grids import lowest, sign, start_values
from ppmcal.diagnosis.hypotheses import Collector, Hypothesis
from ppmcal.diagnosis.linear_system import SystemPart
from ppmcal.kinematics.effect_response import setting
from ppmcal.linalg import finite_rows
from ppmcal.model.effects import EffectKind, Setting, effect_kinds


def unrecorded_load(to: Collector) -> None:
    """Add what kinds do under a constant weight of 1 N, where no load was recorded."""
    if any(finite_rows(p.response.rows.wrench).any() for p in to.system.parts):
        return
    settings = [_weighed(p, to) for p in to.system.parts]
    for kind in effect_kinds().values():
        if kind.under_weight and to.motion in kind.motions:
            _under_weight(to, kind, settings)


def _under_weight(to: Collector, kind: EffectKind, settings: Sequence[Setting]) -> None:
    specs = [s for s in kind.parameters(to.motion) if not (s.constant or s.optional)]
    values = start_values(kind, to.motion)
    own = {}
    for a, name in enumerate(to.actuators):
        one = np.arange(len(to.actuators)) == a
        terms = [kind.evaluate(s, one, values).by for s in settings]
        own[name] = tuple(to.columns.shifted([by[s.name] for by in terms], sign(s)) for s in specs)
    whole = tuple(to.columns.sum_of(cs) for cs in zip(*own.values(), strict=True))
    for on, columns in [((name,), cs) for name, cs in own.items()] + [(to.actuators, whole)]:
        to.unrecorded.append(Hypothesis(
            kind.name, tuple(on), True, tuple(s.name for s in specs),
            tuple(lowest(s) for s in specs), tuple(s.high for s in specs), columns, effect=kind))


def _weighed(part: SystemPart, to: Collector) -> Setting:
    """Return the setting of a part under the weight."""
    response = part.response
    wrench = np.zeros((len(response.pose), 6))
    wrench[:, :3] = to.system.problem.mechanism.gravity
    model = response.closure.model
    return setting(replace(model, shift=None), replace(response.rows, wrench=wrench),
                   response.closure.q, response.pose, model)
