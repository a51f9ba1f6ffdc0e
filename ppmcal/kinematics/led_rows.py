"""What some limbs of a machine lead its rows to, kept row by row while a command works.

Rows whose limbs contradict each other are led from home by one set of limbs after the other, to
look for their poses and then for the least of their minima, and again wherever a fit comes back to
the same parameters: at its start and end, in row checks, in fits of other rows. Leading what cannot
be reached is the dearest of all, since it ends at the smallest step.

In which company a row is led changes its last digit. So a command begins with nothing kept, and its
result does not depend on what was done before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ppmcal.linalg import Array, Bools, Ints

if TYPE_CHECKING:
    from ppmcal.kinematics.closure import Model
    from ppmcal.model.mechanism import Mechanism

Found = tuple[Array, Bools, Array]
"""Poses (N, 8), whether they closed (N,), and how the second step contracted (N,)."""
Key = tuple[tuple[int, ...], bytes]
"""A set of limbs, and the joint values of a row."""
MOST, MODELS = 16384, 16
"""So many rows are kept, and of so many models, the latest."""


@dataclass(eq=False)
class LedRows:
    """Rows of some models that some of their limbs led from home, the latest model last."""

    known: list[tuple[Model, dict[Key, tuple[Array, bool, float]]]] = field(default_factory=list)

    def of(self, model: Model, some: tuple[int, ...], q: Array, lead: Callable[[Ints], Found]
           ) -> Found:
        """Return what rows at joint values ``q`` (N, k) are led to by some limbs of a model.

        Args:
            model: without a shift, one for all rows.
            some: its limbs that lead.
            q: joint values, SI.
            lead: leads rows (n,); asked of those that are not known.
        """
        there = self._of_model(model)
        keys = [(some, row.tobytes()) for row in q]
        new = np.array([i for i, key in enumerate(keys) if key not in there], dtype=np.int64)
        if new.size:
            found = lead(new)
            there.update({keys[i]: (pose, bool(closed), float(contraction)) for i, pose, closed,
                          contraction in zip(new.tolist(), *found, strict=True)})
        out = [there[key] for key in keys]
        self._forget()
        return (np.array([pose for pose, _, _ in out]).reshape(-1, 8),
                np.array([closed for _, closed, _ in out], dtype=bool),
                np.array([contraction for _, _, contraction in out]))

    def _of_model(self, model: Model) -> dict[Key, tuple[Array, bool, float]]:
        """Return what is known of a model, which is the latest now."""
        own = next((i for i, (other, _) in enumerate(self.known) if alike(model, other)), None)
        self.known.append((model, {}) if own is None else self.known.pop(own))
        return self.known[-1][1]

    def _forget(self) -> None:
        while len(self.known) > MODELS or sum(len(own) for _, own in self.known[:-1]) > MOST:
            del self.known[0]


_KEPT: ContextVar[LedRows | None] = ContextVar("led_rows", default=None)


@contextmanager
def keeping_led_rows() -> Iterator[None]:
    """Keep rows that are led, from nothing on; what was kept before is again afterwards."""
    token = _KEPT.set(LedRows())
    try:
        yield
    finally:
        _KEPT.reset(token)


def kept_rows() -> LedRows | None:
    """Return the rows that are kept now, None where none are."""
    return _KEPT.get()


def alike(one: Model, other: Model) -> bool:
    """Whether two models have their limbs, and their home, in the same places."""
    a, b = one.mechanism, other.mechanism
    return _defined_alike(a, b) and np.array_equal(one.parameters, other.parameters)


def _defined_alike(a: Mechanism, b: Mechanism) -> bool:
    """Whether nothing but what is known of the parameters differs between two machines."""
    return a is b or (a.limbs is b.limbs and a.motion is b.motion and a.gaps == b.gaps
                      and np.array_equal(a.home_pose, b.home_pose)
                      and np.array_equal(a.home_q, b.home_q, equal_nan=True)
                      and np.array_equal(a.values, b.values))
