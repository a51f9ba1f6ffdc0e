"""Fading traces of earlier rows: of moves, temperature and payload.

Such as a screw heated by its own moves, or a stand that lags hours behind the hall's temperature.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.term_candidates import Visible
from ppmcal.diagnosis.unknown_courses import COURSE
from ppmcal.diagnosis.unknown_functions import EACH, Acted, Made, coordinates, joints
from ppmcal.diagnosis.unknown_ways import at_rows
from ppmcal.linalg import Array

FADES = (2.0, 5.0, 12.0, 30.0)
"""Numbers of rows within which a trace fades to a third."""


def of_memories(seen: Visible) -> Iterator[Made]:
    """Yield fading traces acting on joints, all equally or individually, and on coordinates.

    Of the moves of each joint and of all, of the temperature and of the payload, if they vary.
    """
    sets, rows = seen.system.problem.datasets, seen.system.problem.environments
    ways = [np.abs(np.diff(d.q, axis=0, prepend=d.q[:1])) for d in sets]
    stroke = np.maximum(np.ptp(np.concatenate([d.q for d in sets]), axis=0), np.finfo(float).tiny)
    yield from _traces(seen, "its own moves", ways, joints(seen))
    for name, before in (("all moves", [np.sum(w / stroke, axis=1) for w in ways]),
                         ("the temperature", [e.temperature for e in rows]),
                         ("the payload", [np.linalg.norm(e.weight, axis=1) for e in rows])):
        yield from _traces(seen, name, before, [*joints(seen), *coordinates(seen)])


def _traces(seen: Visible, name: str, before: Sequence[Array], acted: Sequence[Acted]
            ) -> Iterator[Made]:
    """Yield traces of values (N,), or by joint (N, k), by data set; all fade at one rate."""
    every = np.concatenate(before)
    if not (np.isfinite(every).all() and np.all(np.ptp(every, axis=0) > 0.0)):
        return
    weights = at_rows(seen, [_faded(b) for b in before])
    one_fades = [np.diag(one) for one in np.eye(len(FADES))]
    what = f"a fading trace of {name}"
    each = [a.made(seen, what, weights, one_fades, remedy=COURSE) for a in acted]
    single = [m.columns for m, a in zip(each, acted, strict=True) if a.on and not a.together]
    yield from each[:len(single)]
    if len(single) > 1:
        yield Made(f"{what} acting on each joint individually", np.concatenate(single, axis=1), [
            linalg.block_diagonal([k] * len(single)) for k in one_fades], True, subject=EACH,
            remedy=COURSE)
    yield from each[len(single):]


def _faded(before: Array) -> Array:
    """Return traces (..., F) of values in each row (N,) or (N, k), scaled to one sigma each."""
    own = before.reshape(len(before), -1)
    out = np.stack([linalg.fading_sum(own - own.mean(axis=0), float(np.exp(-1.0 / rows)))
                    for rows in FADES], axis=-1)
    out /= np.maximum(out.std(axis=0), np.finfo(float).tiny)
    return out.reshape(*before.shape, len(FADES))
