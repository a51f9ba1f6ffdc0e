"""On which actuators an effect acts, and with how many values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.special import gammaln

from ppmcal.diagnose.forms import Form, united
from ppmcal.diagnose.search import (
    BETTER,
    Choice,
    Search,
    bic,
    own_log_p,
    pruned,
    stand,
)

FEW = 3
"""Choices of nearly the same BIC whose actuators are looked at."""


def settled(search: Search, choices: Sequence[Choice]) -> tuple[Search, tuple[int, ...]]:
    """Return the best of a few choices, once it is settled where each of its effects acts."""
    best: tuple[int, ...] = ()
    for choice in choices[:FEW]:
        search, chosen = merged(search, choice.chosen)
        if not best or bic(search, chosen) < bic(search, best):
            best = chosen
    return search, best


def merged(search: Search, chosen: Sequence[int]) -> tuple[Search, tuple[int, ...]]:
    """Settle, kind by kind, on which actuators an effect acts and with how many values.

    Tried are one value for a set of actuators and one for each of them, besides what was
    chosen: those that were named, and the strongest one, two, ... BIC decides.
    """
    kinds = list(dict.fromkeys(
        search.forms[i].kind for i in chosen if search.forms[i].on and not search.forms[i].slot
        and not search.forms[i].anonymous))
    best = tuple(chosen)
    for kind in kinds:
        mine = [i for i in best if search.forms[i].kind == kind]
        if not mine:
            continue
        others = [i for i in best if i not in mine]
        search, options = _options(search, kind, mine, others)
        sets = [tuple(pruned(search, [*others, *o], search.name)) for o in options]
        values = [(bic(search, s), n, s) for n, s in enumerate(sets) if stand(search, s)]
        if values:
            best = min(values)[2]
    return search, best


def _options(search: Search, kind: str, mine: Sequence[int], others: Sequence[int]
             ) -> tuple[Search, list[tuple[int, ...]]]:
    """Return sets of forms of one kind that might replace ``mine``."""
    forms = search.forms
    options: list[tuple[int, ...]] = [tuple(mine)]
    constants = forms[mine[0]].constants
    single = {f.on[0]: i for i, f in enumerate(forms)
              if f.kind == kind and len(f.on) == 1 and f.constants == constants}
    named = [a for a in single if any(a in forms[i].on for i in mine)]
    for subset in _subsets(search, others, single, named):
        alone = [single[a] for a in subset]
        options.append(tuple(alone))
        if len(subset) > 1:
            search, together = _together(search, [forms[single[a]] for a in subset])
            options.append((together,))
    return search, options


def _subsets(search: Search, others: Sequence[int], single: Mapping[str, int],
             named: Sequence[str]) -> list[list[str]]:
    """Return sets of actuators worth trying: those named, and the strongest one, two, ...

    Strong is what stands out when every actuator has a value of its own.
    """
    out = [list(named)]
    for among in (list(named), list(single)):
        alone = [single[a] for a in among]
        own = {a: own_log_p(search, [*others, *alone], single[a]) for a in among}
        order = sorted(among, key=lambda a: own[a])
        out += [[a for a in among if a in order[:k]] for k in range(1, len(order) + 1)]
    return [s for n, s in enumerate(out) if s and s not in out[:n]]


def _together(search: Search, parts: Sequence[Form]) -> tuple[Search, int]:
    """Return the form in which several actuators share one value, added where it is new."""
    wanted = {a for part in parts for a in part.on}
    for i, form in enumerate(search.forms):
        if form.kind == parts[0].kind and form.shared and set(form.on) == wanted \
                and form.alike(parts[0]):
            return search, i
    total = search.gram.right.size
    size = parts[0].size
    weights = np.zeros((total, size))
    for part in parts:
        for j, c in enumerate(part.columns):
            weights[c, j] = 1.0
    on = tuple(a for part in parts for a in part.on)
    form = replace(parts[0], on=on, columns=tuple(range(total, total + size)),
                   choices=_choices(search, len(on)))
    return replace(search, gram=search.gram.extended(weights),
                   forms=(*search.forms, form)), len(search.forms)


def _choices(search: Search, some: int) -> float:
    """Return the logarithm of the number of sets of so many actuators."""
    total = max(len(f.on) for f in search.forms)
    return float(gammaln(total + 1) - gammaln(some + 1) - gammaln(max(total - some, 0) + 1))


def held(search: Search, chosen: tuple[int, ...], forms: Sequence[Form]
         ) -> tuple[Search, tuple[int, ...]]:
    """Return ``forms``, chosen at an earlier fit, if they are as good as ``chosen``.

    Without this two effects that look alike would take turns for ever.
    """
    old: list[int] = []
    for form in forms:
        search, index = find(search, form)
        if index is None:
            return search, chosen
        old.append(index)
    if not old or not stand(search, old):
        return search, chosen
    good = not chosen or bic(search, old) <= bic(search, chosen) + BETTER
    return search, tuple(old) if good else chosen


def find(search: Search, form: Form) -> tuple[Search, int | None]:
    """Return where a form of another search is in this one, made where it can be."""
    match = [i for i, f in enumerate(search.forms)
             if (f.family, f.on, f.shared) == (form.family, form.on, form.shared)]
    if match:
        return search, min(match, key=lambda i: form.apart(search.forms[i]))
    parts = [f for f in search.forms if f.family == form.family and len(f.on) == 1
             and f.on[0] in form.on and f.alike(form)]
    if len(parts) != len(form.on):
        return search, None
    if form.shared:
        return _together(search, parts)
    return replace(search, forms=(*search.forms, united(parts))), len(search.forms)
