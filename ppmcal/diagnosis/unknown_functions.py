"""Functions of what is recorded that no learned term has: of places, payload, wrench, other joints.

As blocks of columns with the covariance of their coefficients, for :mod:`unknown_causes`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import compress

import numpy as np

from ppmcal.diagnosis.kernels import LENGTHS, bends, matern, roots
from ppmcal.diagnosis.term_candidates import (
    COARSE,
    Visible,
    columns_from,
    is_residual,
    joint_groups,
    nodes_over,
)
from ppmcal.inference.priors import GOES_WITH
from ppmcal.linalg import Array
from ppmcal.model.dataset import WRENCH
from ppmcal.model.effects import Setting, Shift
from ppmcal.model.effects.learned import INPUTS, JOINT, LearnedCurve
from ppmcal.model.effects.learned_curve import spline_basis
from ppmcal.model.effects.setting import PLACE


@dataclass(frozen=True, eq=False)
class Made:
    """Columns (n, K) that may be one cause.

    ``kernels`` (K, K): of what its coefficients are, by length; none: each by itself, all of one
    size. ``together``: whether it acts on several joints at once; ``curve``, ``on``, ``remedy``: as
    of a cause.
    """

    label: str
    columns: Array
    kernels: Sequence[Array] = ()
    together: bool = False
    curve: LearnedCurve | None = None
    on: tuple[bool, ...] = ()
    remedy: str = ""

    @property
    def usual(self) -> float:
        """How usual it is beside one that goes with no direction and no second input."""
        goes_with = self.curve is not None and (self.curve.by or self.curve.signed)
        return float(GOES_WITH) if goes_with else 1.0

    def roots(self, gram: Array, count: int) -> tuple[Array, ...]:
        """Return the roots of its kernels: see :func:`ppmcal.diagnosis.kernels.roots`."""
        return roots(self.kernels or [np.eye(self.columns.shape[1])], gram, count)


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
        yield Made(f"an error of {c} that bends over the volume",
                   np.stack([column.reshape(-1) for column in columns], axis=1))


def of_others(seen: Visible) -> Iterator[Made]:
    """Yield functions of what the library knows by the joints' loads, and of other joints.

    What is carried may move anything, and a drive what its neighbour does.
    """
    mechanism = seen.system.problem.mechanism
    names, groups = mechanism.actuators, joint_groups(mechanism)
    each = {name: (JOINT, on) for name, on in zip(names, groups, strict=False)}
    every = {" ".join(compress(names, on)): (JOINT, on) for on in groups}
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
    nodes = nodes_over(values, values, COARSE, fewest=2, margin=0.0)
    if nodes is None:
        return
    kernels = [matern(nodes, length) for length in LENGTHS]
    for where, (acts, on) in acted.items():
        columns = columns_from(seen, acts, on, lambda s: spline_basis(nodes, x(s)))
        yield Made(f"a function of {name} acting on {where}", columns, kernels,
                   acts == JOINT and sum(on) > 1)


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
