"""How well each number that a controller takes is known, by what the measurements leave open.

A number is a function n(g) of the machine's parameters g, computed by the exporter's own
arithmetic. To first order its variance is j C j^T, j = dn/dg by central differences of one standard
deviation, C the covariance of the parameters, all correlations in it: a rod that is longer by what
an endstop is higher leaves an angle as it is. Intervals of parameters are not 1.96 sigma long where
the noise is estimated too, or sessions disagree; C is scaled so that those of single parameters
are theirs.

Numbers that a controller cannot hold exactly are fitted to the machine, with errors e(p, g). Where
these are least follows g by dp = -pinv(de/dp) de (one step of Gauss-Newton), without fitting again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares

from ppmcal.calibration.fit import Z95
from ppmcal.controllers.export import Again, Exported, Number
from ppmcal.io.results.beside_model import calibration_of
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.knowledge import knowledge_of
from ppmcal.io.results.units import column_factor
from ppmcal.linalg import Array, guarded, pinv
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

LEAST_STEP = 1e-9
"""By which a parameter is differed that nothing bounds, m or rad."""
ALIKE = 1e-9
"""Combinations of numbers that move errors by less than this part of what others do stay."""


@stage("how sure the numbers are")
def with_intervals(mechanism: Mechanism, made: Exported) -> tuple[Number, ...]:
    """Return the numbers of an export, each with half of its 95 % interval.

    Without one where no identification of the machine lies beside its file, where the export does
    not say how its numbers follow the parameters, or where a number follows what nothing bounds.

    Raises:
        BadInput: the identification.json beside the model cannot be used.
    """
    own = calibration_of(mechanism)
    if made.again is None or own is None or own[2]:
        return made.numbers
    record, path, _ = own
    known = knowledge_of(record, mechanism, path)
    places = [c for c, name in enumerate(known.names) if name in mechanism.names]
    names = [known.names[c] for c in places]
    covariance = known.covariance[np.ix_(places, places)]
    half = _half_widths(mechanism, record, names, np.sqrt(np.diagonal(covariance)))
    return tuple(_numbered(made.numbers, made.again, mechanism, names, covariance, half))


def _half_widths(mechanism: Mechanism, record: IdentificationRecord, names: list[str],
                 sigma: Array) -> Array:
    """Return half of the 95 % interval of each parameter (F,), SI, nan where nothing bounds it."""
    told = {p.name: p.half for p in record.parameters}
    shown = [told.get(name) for name in names]
    return np.array([Z95 * s if own is None else own * column_factor(mechanism, name)
                     for name, own, s in zip(names, shown, sigma.tolist(), strict=True)])


def _numbered(numbers: tuple[Number, ...], again: Again, mechanism: Mechanism, names: list[str],
              covariance: Array, half: Array) -> list[Number]:
    """Return numbers with half of the interval of each; ``covariance`` (F, F), ``half`` (F,)."""
    slopes = _slopes(numbers, again, mechanism, names, half)
    sigma = np.sqrt(np.diagonal(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        scale = np.where(sigma > 0.0, half / sigma, 0.0)
    out = []
    for number, row in zip(numbers, slopes, strict=True):
        own = np.flatnonzero(row)
        parts = row[own] * scale[own]
        variance = float(parts @ covariance[np.ix_(own, own)] @ parts)
        known = float(np.sqrt(np.maximum(variance, 0.0)))
        out.append(replace(number, half=known if np.isfinite(known) else None))
    return out


def _slopes(numbers: tuple[Number, ...], again: Again, mechanism: Mechanism, names: list[str],
            half: Array) -> Array:
    """Return the derivative of numbers by parameters, (n, F); nan where one is no number."""
    out = np.zeros((len(numbers), len(names)))
    for c, name in enumerate(names):
        place = mechanism.names.index(name)
        tolerance = mechanism.parameters[place].tolerance
        sizes = (float(half[c]) / Z95, tolerance or 0.0)
        step = next((s for s in sizes if LEAST_STEP < s < np.inf), LEAST_STEP)
        if half[c] != 0.0:
            ends = []
            for side in (step, -step):
                g = mechanism.values.copy()
                g[place] += side
                found = again(mechanism.with_values(g))
                ends.append([found.get(n.name, np.nan) for n in numbers])
            out[:, c] = (np.array(ends[0]) - np.array(ends[1])) / (2.0 * step)
    return out


def fitted(errors: Callable[[Array], Array], start: Array, what: str, most: int,
           slopes: Any = "2-point", scale: Array | float = 1.0, tight: float = 1e-12) -> Array:
    """Return the numbers (P,) with the smallest squared errors (n,), from ``start`` on.

    ``what``: they are, for messages; ``most``: how often errors are worked out; ``slopes``: their
    derivative (n, P); ``scale``: of the numbers (P,); ``tight``: relative change that is the last.
    """
    with guarded(what):
        found = least_squares(errors, start, slopes, x_scale=scale, xtol=tight, ftol=tight,
                              gtol=tight, max_nfev=most)
    return np.asarray(found.x)


def following(errors: Callable[[Mechanism], Callable[[Array], Array]], mechanism: Mechanism,
              found: Array, steps: Array, named: Callable[[Array], Mapping[str, float]]) -> Again:
    """Return how numbers that were fitted follow the machine.

    Args:
        errors: of a machine, its errors (n,) by the numbers (P,) that are fitted.
        mechanism: the machine that they were fitted to.
        found: the numbers with the smallest errors (P,).
        steps: by which to differ each (P,).
        named: what is written of such numbers, by name.
    """
    back: list[Array] = []

    def again(machine: Mechanism) -> Mapping[str, float]:
        if not back:
            own = errors(mechanism)
            sides = [(own(found + step) - own(found - step)) / (2.0 * size)
                     for step, size in zip(np.diag(steps), steps.tolist(), strict=True)]
            back.append(steps[:, None] * pinv(np.stack(sides, axis=-1) * steps, ALIKE))
        return named(found - back[0] @ errors(machine)(found))

    return again
