"""Local refinement of the chosen poses: no draw of candidates meets the best ones.

In six coordinates some hundred candidates are far apart. Each chosen pose in turn is exchanged
for the best of its neighbours, first in wide, then in narrow steps (the continuous form of
exchange: coordinate exchange, Meyer and Nachtsheim, Technometrics 37, 1995). First for the
determinant; then, since the same determinant can be had with more or less exact tasks, for the
mean square error at the tasks (I-optimality), at the price of little determinant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ppmcal.design.plan.candidate_poses import Candidates, Region, nearby, same_mode
from ppmcal.design.plan.d_optimal import Design
from ppmcal.design.plan.information import CandidateInformation, offer
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.linalg import Array, Ints
from ppmcal.model.mechanism import Mechanism

SCALES = (0.3, 0.15, 0.08, 0.04)
"""Steps, in parts of the region's box."""
PRICE = 0.1
"""Part of the determinant's root (per wanted column) that is given away for the tasks."""
NEIGHBOURS = 30
MOST_ROWS = 600


def refined(nominal: Mechanism, region: Region, instrument: Instrument, whole: CandidateInformation,
            pool: Candidates, columns: Mapping[str, Array], chosen: Sequence[int], aim: Array,
            rng: np.random.Generator) -> tuple[Candidates, CandidateInformation, dict[str, Array],
                                               tuple[int, ...]]:
    """Return candidates, rows, settings and choice, with the refined poses added to them.

    Each row keeps its settings. ``aim`` (C, C): mean of J^T J of the positions at the tasks.
    """
    rows = np.array(chosen, dtype=np.int64)
    best = pool.take(whole.pose[rows])
    own = {n: c[rows] for n, c in columns.items()}
    with_effects = whole.problem.mechanism
    count = max(4, min(NEIGHBOURS, MOST_ROWS // len(rows)))
    left = 0.0
    for scale, wish in [(s, None) for s in SCALES] + [(s, aim) for s in SCALES]:
        if wish is not None and scale == SCALES[0]:
            left = -np.log(1.0 - PRICE) * int((~whole.nuisance).sum())
        found, parent = nearby(nominal, region, best.pose, scale, count, rng)
        among = best.joined(found)
        parent = np.concatenate([np.arange(len(rows)), parent])
        local = offer(with_effects, instrument, among, np.arange(len(among)),
                      {n: c[parent] for n, c in own.items()}, whole)
        picked, left = _one_each(local, parent, len(rows), wish, left)
        best = among.take(picked)
    # a pose that ended in another assembly mode goes back to where it was
    strays = ~same_mode(nominal, best.q, best.pose)
    best = pool.take(whole.pose[rows]).joined(best).take(
        np.where(strays, 0, len(rows)) + np.arange(len(rows)))
    everything = pool.joined(best)
    pose = np.concatenate([whole.pose, len(pool) + np.arange(len(rows))])
    settings = {n: np.concatenate([c, own[n]]) for n, c in columns.items()}
    return (everything, offer(with_effects, instrument, everything, pose, settings, whole),
            settings, tuple(range(len(whole), len(whole) + len(rows))))


def _one_each(local: CandidateInformation, parent: Ints, count: int, aim: Array | None, left: float
              ) -> tuple[Ints, float]:
    """Return the best row of each family (count,), starting from the parents themselves.

    With an ``aim`` the determinant's logarithm may fall by ``left`` in all; the second result is
    what remains of that.
    """
    chosen = list(range(count))
    design = Design.of(local, chosen)
    for family in range(count):
        rest = design.removed(chosen[family])
        gains, now = rest.gains(), chosen[family]
        wish = gains if aim is None else np.where(gains >= gains[now] - left, rest.cuts(aim),
                                                  -np.inf)
        best = int(np.argmax(np.where(parent == family, wish, -np.inf)))
        if wish[best] > wish[now] * (1.0 + 1e-9 * np.sign(wish[now])):
            chosen[family] = best
            left += float(gains[best] - gains[now]) if aim is not None else 0.0
        design = rest.added(chosen[family])
    return np.array(chosen, dtype=np.int64), left
