"""Events between two sessions: joints rehomed, belts retensioned, a base set up again.

Their time is known, and they are common.
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
"""Slots that, if free, hold the joint zeros of the first session."""


def session_starts(problem: Problem) -> dict[str, float]:
    """Return the number of each session's first row, the sessions in order.

    Empty if there are fewer than two, or if they overlap.
    """
    rows = {label: np.concatenate([d.numbers()[m] for d, m in zip(
        problem.datasets, masks, strict=True)]) for label, masks in session_masks(problem.datasets)}
    order = sorted((label for label in rows if rows[label].size), key=lambda s: rows[s].min())
    apart = all(rows[one].max() < rows[two].min()
                for one, two in pairwise(order))
    return {s: float(rows[s].min()) for s in order} if apart and len(order) > 1 else {}


def zeros_are_known(problem: Problem) -> bool:
    """Whether no joint zero is free, so that those of the first session may be off too."""
    return not limbs_with_free(problem.mechanism, ZEROS, problem.free)


Form = tuple[tuple[str, ...], bool]
"""Actuators that an effect acts on, and whether all of them share one value."""


def priors(some: Sequence[Hypothesis], shares: Callable[[Sequence[Form]], Mapping[Form, float]]
           ) -> Iterator[tuple[Hypothesis, float]]:
    """Yield the hypotheses that begin with a session, each with its log prior.

    ``shares``: forms -> the prior of each of them.
    """
    events: dict[tuple[str, str], list[Hypothesis]] = defaultdict(list)
    for h in some:
        events[h.family, h.begins].append(h)
    for own in events.values():
        share = shares([(h.on, h.shared) for h in own])
        for h in own:
            # zeros of the first session are off if homing finds all of them anew each time
            prior = ALL_ALIKE.value if h.beside else MOVED.value * share[h.on, h.shared]
            yield h, float(np.log(prior))


def with_sessions(sources: Sequence[object]) -> list[frozenset[int]]:
    """Return sets of sources, by kind, in which all joints change with every session.

    One set with the first session and one without.
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
