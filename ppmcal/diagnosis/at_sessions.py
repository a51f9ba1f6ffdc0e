"""Events between two sessions: joints homed anew, belts tensioned anew, a base set up anew.

When that was is known, and it is no rare event.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise

import numpy as np

from ppmcal.calibration.fit import Problem
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.inference.priors import ALL_ALIKE, MOVED
from ppmcal.model.mechanism import limbs_with_free
from ppmcal.model.sessions import session_masks

ZEROS = ("offset",)
"""Slots that, where they are free, are the zeros of the first session."""


def session_starts(problem: Problem) -> dict[str, float]:
    """Return the number of each session's first row, the sessions in order.

    None where there are fewer than two, or where they overlap.
    """
    rows = {label: np.concatenate([d.numbers()[m] for d, m in zip(
        problem.datasets, masks, strict=True)]) for label, masks in session_masks(problem.datasets)}
    order = sorted((label for label in rows if rows[label].size), key=lambda s: rows[s].min())
    apart = all(rows[one].max() < rows[two].min()
                for one, two in pairwise(order))
    return {s: float(rows[s].min()) for s in order} if apart and len(order) > 1 else {}


def zeros_are_known(problem: Problem) -> bool:
    """Whether no joint's zero is free, so that those of the first session may be off too."""
    return not limbs_with_free(problem.mechanism, ZEROS, problem.free)


Form = tuple[tuple[str, ...], bool]
"""Actuators on which something acts, and whether with one value for all of them."""


def priors(some: Sequence[Hypothesis], shares: Callable[[Sequence[Form]], Mapping[Form, float]]
           ) -> Iterator[tuple[Hypothesis, float]]:
    """Yield what begins with a session, and the logarithm of its prior.

    ``shares``: forms -> the prior of each of them.
    """
    events: dict[tuple[str, str], list[Hypothesis]] = defaultdict(list)
    for h in some:
        events[h.family, h.begins].append(h)
    for own in events.values():
        share = shares([(h.on, h.shared) for h in own])
        for h in own:
            # zeros of the first session are off where all are found anew each time
            prior = ALL_ALIKE.value if h.beside else MOVED.value * share[h.on, h.shared]
            yield h, float(np.log(prior))


def with_sessions(sources: Sequence[object]) -> list[frozenset[int]]:
    """Return what all joints have anew with every session, as numbers of sources, by kind.

    Each of these sets, with the first session and without.
    """
    own: dict[str, tuple[list[int], list[int]]] = defaultdict(lambda: ([], []))
    for n, h in enumerate(sources):
        if isinstance(h, Hypothesis) and h.begins and not h.shared:
            every, later = own[h.family]
            every.append(n)
            later += [] if h.beside else [n]
    out = list[frozenset[int]]()
    for every, later in own.values():
        out += [frozenset(s) for s in ([later, every] if later != every else [later])]
    return out
