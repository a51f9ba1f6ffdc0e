"""Confirmation: what was named on the training rows has to stand in all rows.

A false alarm grows no stronger with rows that it was not chosen on; an effect does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.arrays import thinned
from ppmcal.diagnose.forms import Form
from ppmcal.diagnose.gram import log_p
from ppmcal.diagnose.model import Added, with_named
from ppmcal.diagnose.refit import with_mechanism
from ppmcal.diagnose.result import Found
from ppmcal.diagnose.stage import named_only, without
from ppmcal.diagnose.system import (
    INVISIBLE,
    MOST_ROWS,
    Whitening,
    build,
    range_basis,
    unit_columns,
)
from ppmcal.fit import Fit
from ppmcal.fit import Options as FitOptions

Bools = NDArray[np.bool_]


def confirm(found: Found, whole: Fit, options: FitOptions) -> tuple[Found, Fit | None]:
    """Drop effects that do not stand in all rows; return what is left and its fit to them.

    Args:
        found: on the training rows.
        whole: fit of all rows without effects.
        options: of the fits.
    """
    while found.added:
        fit = with_mechanism(whole, found.after.problem.mechanism, options)
        values = own_values(fit, found.added, found.last.noise, thinned(fit.keep, MOST_ROWS))
        weakest = max(values, key=lambda key: values[key])
        if values[weakest] <= found.first.search.name:
            return found, fit
        rest = tuple(i for i in found.last.chosen if _key(found.last.forms[i]) != weakest)
        last = replace(found.last, chosen=rest)
        if not named_only(last):
            break
        mechanism, added = with_named(whole.problem.mechanism, last.search, named_only(last))
        after = with_mechanism(found.before, mechanism, options)
        found = Found(found.before, after, found.first, last, added)
    return nothing_named(found), None


def nothing_named(found: Found) -> Found:
    """Return the same without any effect."""
    return Found(found.before, found.before, found.first, replace(found.first, chosen=()), ())


Key = tuple[str, tuple[str, ...]]


def _key(form: Form) -> Key:
    return form.family, form.on


def own_values(fit: Fit, added: Sequence[Added], noise: Whitening, keep: Sequence[Bools]
               ) -> dict[Key, float]:
    """Return the log p of each added form given geometry and the others, at a fit."""
    names = fit.problem.mechanism.names
    where: dict[Key, list[int]] = {}
    for a in added:
        own = where.setdefault(_key(a.form), [])
        own += [c for c, p in enumerate(fit.problem.free) if names[p] in a.parameters]
    system = build(fit.problem, fit.state, keep)
    out = {}
    for key, own in where.items():
        alone = without(system, own)
        basis = range_basis(noise.apply(alone.jacobian, alone), INVISIBLE)
        columns = noise.apply(system.jacobian[..., own], system)
        left = noise.apply(alone.residual[..., None], alone)[:, 0]
        left = left - basis @ (basis.T @ left)
        columns = columns - basis @ (basis.T @ columns)
        plane = range_basis(unit_columns(columns)[0])
        gain = float(np.sum((plane.T @ left) ** 2))
        freedom = system.count - basis.shape[1]
        out[key] = float(log_p(np.array([gain]), float(left @ left), plane.shape[1], freedom)[0])
    return out
