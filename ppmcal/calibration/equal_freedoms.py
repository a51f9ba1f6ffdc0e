"""Two calibrations that had different parameters free, compared with the same ones free.

What the richer one fitted and the poorer one could not is no change of the machine. So the richer
one is taken as it would have been with those parameters where the poorer one held them: its data
then miss by more, which is misfit of the model, and counts as noise of the difference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.posterior import ROUND_OFF, Posterior, SessionKnowledge
from ppmcal.linalg import Array, Bools, svd
from ppmcal.model.mechanism import Mechanism


def with_equal_freedoms(mechanism: Mechanism, old: Posterior, new: Posterior
                        ) -> tuple[Posterior, Posterior]:
    """Return two calibrations without the parameters that only one of them had free.

    ``mechanism``: the newer. A parameter without a nominal value (a stiffness that the older
    machine had not) stays.
    """
    nominal = np.array([p.nominal for p in mechanism.parameters])
    return (_held(mechanism, old, new.places, mechanism.values),
            _held(mechanism, new, old.places, nominal))


def _held(mechanism: Mechanism, found: Posterior, both: Sequence[int], at: Array) -> Posterior:
    """Return a calibration with what is not free in ``both`` held at values (P,), SI."""
    goes = np.array([p not in both and bool(np.isfinite(at[p]))
                     and not mechanism.parameters[p].reciprocal for p in found.places], dtype=bool)
    if not goes.any():
        return found
    away = at[list(found.places)][goes] - found.value[goes]
    step = _step(found, goes, away)
    right = found.right - found.matrix[:, goes] @ away - found.matrix[:, ~goes] @ step
    return replace(
        found, places=tuple(p for p, gone in zip(found.places, goes, strict=True) if not gone),
        value=found.value[~goes] + step, matrix=found.matrix[:, ~goes], right=right,
        tolerance=found.tolerance[~goes], scale=found.scale[~goes],
        session=None if found.session is None else _session(found, found.session, goes, away, step))


def _step(found: Posterior, goes: Bools, away: Array) -> Array:
    """Return by how much the other parameters move (F',) as those that go are moved ``away``."""
    scale = found.scale[~goes]
    data = found.matrix[:, ~goes] * scale / found.inflation
    weight = scale / found.tolerance[~goes]
    # what the tolerances pull at the estimate is what the data pull against
    pulled = data.T @ found.right / found.inflation
    missed = (found.right - found.matrix[:, goes] @ away) / found.inflation
    inverse = linalg.pinv(data.T @ data + np.diag(weight**2), rcond=1e-14, hermitian=True)
    return np.asarray(scale * (inverse @ (data.T @ missed - pulled)))


def _session(found: Posterior, known: SessionKnowledge, goes: Bools, away: Array, step: Array
             ) -> SessionKnowledge:
    """Return what the data say beyond parameters, those that go held; the rest of it is noise."""
    count = goes.size
    own = known.matrix[:, :count]
    right = known.right - own[:, goes] @ away - own[:, ~goes] @ step
    matrix = np.concatenate([own[:, ~goes], known.matrix[:, count:]], axis=1)
    scale = np.concatenate([found.scale, known.scale])
    before = _explained(known.matrix * scale, known.right)
    scale = np.concatenate([found.scale[~goes], known.scale])
    after = _explained(matrix * scale, right)
    degrees = known.degrees + before[1] - after[1]
    square = known.degrees * known.noise**2 + max(after[0] - before[0], 0.0)
    noise = float(np.sqrt(square / degrees)) if degrees > 0 else known.noise
    more = noise / max(known.noise, 1e-300) if known.degrees > 0 else 1.0
    return replace(known, matrix=matrix, right=right, noise=noise, spread=known.spread * more,
                   degrees=degrees)


def _explained(matrix: Array, right: Array) -> tuple[float, int]:
    """Return what no combination of columns explains, squared, and the rank of these."""
    u, s, _ = svd(matrix)
    seen = s > ROUND_OFF * s.max(initial=1e-300)
    return float(right @ right - np.sum((u[:, seen].T @ right) ** 2)), int(seen.sum())
