"""Functions of what is recorded that no learned term has: of places, payload, wrench, other joints.

As blocks of columns with the covariance of their coefficients, for :mod:`unknown_causes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

from ppmcal.diagnosis.kernels import LENGTHS, bends, matern
from ppmcal.diagnosis.term_candidates import (
    COARSE,
    PER_NODE,
    Visible,
    columns_from,
    is_residual,
)
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH
from ppmcal.model.effects import Setting, Shift
from ppmcal.model.effects.learned import INPUTS, JOINT, LearnedCurve
from ppmcal.model.effects.learned_curve import spline_basis
from ppmcal.model.effects.setting import PLACE

Made = tuple[str, Array, list[Array], bool, LearnedCurve | None, tuple[bool, ...]]
"""Label, columns, kernels, whether it acts on several joints at once, and as in a cause."""


def over_volume(seen: Visible) -> Iterator[Made]:
    """Yield errors of each coordinate that bend smoothly over the volume, as a lens' do.

    Second and third powers of the coordinates; what is linear in them is scale, turn and skew.
    """
    here = [p.setting for p in seen.system.parts]
    own = [c for c in seen.system.problem.mechanism.coordinates if PLACE[c] < 3]
    over = [INPUTS[c] for c in own if not is_residual(seen, INPUTS[c], here)]
    each = [np.stack([x.value(s) for x in over], axis=1) for s in here] if over else []
    powers = bends(np.concatenate(each)) if over else np.zeros((0, 0))
    if not powers.size:
        return
    by_part = np.split(powers, np.cumsum([len(x) for x in each])[:-1])
    for c in own:
        columns = [seen.system.column([Shift(pose=bend[:, [k]] * np.eye(6)[PLACE[c]])
                                       for bend in by_part]) * seen.system.observed
                   for k in range(powers.shape[1])]
        yield (f"an error of {c} that bends over the volume",
               np.stack([column.reshape(-1) for column in columns], axis=1),
               [np.eye(len(columns))], False, None, ())


def of_others(seen: Visible) -> Iterator[Made]:
    """Yield functions of what the library knows by the joints' loads, and of other joints.

    What is carried may move anything, and a drive what its neighbour does.
    """
    mechanism = seen.system.problem.mechanism
    names = mechanism.actuators
    each = {name: (JOINT, tuple(a == name for a in names)) for name in names}
    every = dict(each)
    if len(names) > 1 and len(set(mechanism.actuator_quantity)) == 1:
        every[" ".join(names)] = (JOINT, (True,) * len(names))
    every |= {c: (c, (True,) * len(names)) for c in mechanism.coordinates}
    yield from _of(seen, "the payload", carried, every)
    for n, name in enumerate(WRENCH):
        yield from _of(seen, name, partial(applied, n), every)
    for n, name in enumerate(names):
        yield from _of(seen, f"the travel of {name}", partial(travelled, n),
                       {other: on for other, on in each.items() if other != name})


def _of(seen: Visible, name: str, x: Callable[[Setting], Array],
        acted: Mapping[str, tuple[str, tuple[bool, ...]]]) -> Iterator[Made]:
    """Yield functions of what is known of each row (N,), acting on each of some things."""
    values = np.concatenate([x(p.setting) for p in seen.system.parts])
    width, there = float(np.ptp(values)), float(np.abs(values).max())
    if not width > 1e-9 * there:
        return
    different = np.unique(np.round((values - values.min()) / width, 6)).size
    count = min(COARSE, different, values.size // PER_NODE)
    if count < 2:
        return
    nodes = np.linspace(values.min(), values.max(), count)
    kernels = [matern(nodes, length) for length in LENGTHS]
    for where, (acts, on) in acted.items():
        columns = columns_from(seen, acts, on, lambda s: spline_basis(nodes, x(s)))
        yield (f"a function of {name} acting on {where}", columns, kernels,
               acts == JOINT and sum(on) > 1, None, ())


def carried(rows: Setting) -> Array:
    """Return the weight on the platform (N,), N."""
    return np.asarray(np.linalg.norm(rows.weight, axis=1))


def applied(component: int, rows: Setting) -> Array:
    """Return a component of the wrench on the platform (N,) beside the weight of its payload."""
    own = rows.wrench[:, component]
    return own - rows.weight[:, component] if component < 3 else own


def travelled(joint: int, rows: Setting) -> Array:
    """Return the travel of one joint (N,)."""
    return rows.travel[:, joint]
