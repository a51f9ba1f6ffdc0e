"""Learned terms as short equations, where these predict held-out poses equally well.

Sparse regression of the residuals, free of geometry, named effects and the other terms, on forms of
the term's own inputs (Brunton et al. 2016, SINDy). The probability of a set of products follows
from its fit with a penalty of half the log of the number of rows per product (Schwarz 1978), and a
prior: one form of all available, a kink in one of ten and at one of its places. An equation is
reported if its forms are practically certain over all sets, if it lies within the band of the
learned function, and if it predicts held-out poses as well.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.equation_forms import (
    Equation,
    Product,
    kinked,
    products_of,
    same_form,
    values_of,
)
from ppmcal.diagnosis.learning import Learned, Term
from ppmcal.diagnosis.linearisation import WEAK_VISIBILITY
from ppmcal.diagnosis.term_candidates import TWIN, Visible, columns_from
from ppmcal.inference.priors import SELDOM, SURE
from ppmcal.linalg import Array, Bools, Ints, without_range
from ppmcal.model.effects import Setting
from ppmcal.model.effects.learned import LearnedCurve

BAND_DRAWS = 500


def equations(seen: Visible, learned: Learned) -> tuple[Equation | None, ...]:
    """Return a short equation for each learned term, None if the rows do not single one out.

    Args:
        seen: rows from which the terms were learned.
        learned: the terms.
    """
    return tuple(_equation(seen, learned, i) for i in range(len(learned.terms)))


def _equation(seen: Visible, learned: Learned, which: int) -> Equation | None:
    term, curve = learned.terms[which], learned.curves[which]
    target = _target(seen, learned, which)
    products, columns = _visible(seen, term, products_of(curve))
    if not products:
        return None
    free = without_range(columns, seen.basis)
    chosen, probability = likeliest(*_inner(free, target), seen.freedom, forms_of(products),
                                    np.array([kinked(p) for p in products]))
    if not chosen or probability < SURE.value:
        return None
    found = _sized(seen, term, curve, target, [products[i] for i in chosen], learned.sigma)
    if not _within(seen, term, curve, found):
        return None
    return replace(found, probability=probability)


def sized_again(seen: Visible, learned: Learned, found: Sequence[Equation | None]
                ) -> tuple[Equation | None, ...]:
    """Return equations with sizes refitted to other rows, None if outside the band."""
    out: list[Equation | None] = []
    for i, (term, curve, old) in enumerate(zip(learned.terms, learned.curves, found, strict=True)):
        new = None
        if old is not None:
            new = _sized(seen, term, curve, _target(seen, learned, i), old.products, learned.sigma)
            new = replace(new, probability=old.probability, after=old.after)
            new = new if _within(seen, term, curve, new) else None
        out.append(new)
    return tuple(out)


def _target(seen: Visible, learned: Learned, which: int) -> Array:
    """Return the residuals (n,) after removing all terms but one."""
    others = [t.free @ c.values for i, (t, c) in enumerate(zip(
        learned.terms, learned.curves, strict=True)) if i != which]
    return np.asarray(seen.left - sum(others, np.zeros_like(seen.left)))


def _columns(seen: Visible, term: Term, products: Sequence[Product]) -> Array:
    """Return the whitened columns (n, F) of products."""
    curve = term.curve

    def weights(setting: Setting) -> Array:
        found = values_of(products, dict(zip(curve.inputs, curve.seen(setting), strict=True)))
        if not curve.signed:
            return found
        found = found if found.ndim == 3 else found[:, None]
        return np.asarray(found * setting.approach[..., None])

    return columns_from(seen, curve.acts, term.on, [weights(p.setting) for p in seen.system.parts])


def _visible(seen: Visible, term: Term, products: Sequence[Product]
             ) -> tuple[list[Product], Array]:
    """Return distinct products that geometry does not absorb, and their columns."""
    columns = _columns(seen, term, products)
    free = without_range(columns, seen.basis)
    length = np.linalg.norm(free, axis=0)
    seen_well = length > WEAK_VISIBILITY * np.linalg.norm(columns, axis=0)
    unit = free / np.where(length > 0.0, length, 1.0)
    kept: list[int] = []
    for i in np.flatnonzero(seen_well).tolist():
        if not kept or np.abs(unit[:, kept].T @ unit[:, i]).max() < TWIN:
            kept.append(i)
    # scaled alike, so that inner products are of one size too
    return [products[i] for i in kept], columns[:, kept] / length[kept]


def _inner(columns: Array, target: Array) -> tuple[Array, Array, float]:
    return columns.T @ columns, columns.T @ target, float(target @ target)


def likeliest(gram: Array, right: Array, square: float, freedom: int, forms: Ints, kinks: Bools
              ) -> tuple[tuple[int, ...], float]:
    """Return which columns to use, the strongest first, and the probability of their forms.

    Tries no column, all single columns, all pairs, and the best pair with every third column. At
    most one has a kink: several would be a spline.

    Args:
        gram: inner products of the columns (F, F).
        right: inner products of the columns with the target (F,).
        square: squared length of the target.
        freedom: degrees of freedom: values minus fitted parameters.
        forms: a number per column (F,), equal where only the place of a kink differs.
        kinks: whether each has a kink (F,).
    """
    # prior: one form of many; kinks are rare, and at one of several places
    price = 0.5 * np.log(freedom) + np.log(np.unique(forms).size * np.bincount(forms)[forms]
                                           / np.where(kinks, SELDOM.value, 1.0))

    def worth(explained: Array, cost: Array) -> Array:
        left = np.maximum(square - explained, 1e-9 * square)
        return np.asarray(0.5 * freedom * np.log(square / left) - cost)

    own = np.maximum(np.diag(gram), 1e-300)
    alone = worth(right**2 / own, price)
    apart = own[:, None] * own[None, :] - gram**2
    both = (right[:, None] ** 2 * own[None, :] + right[None, :] ** 2 * own[:, None]
            - 2.0 * right[:, None] * right[None, :] * gram)
    told = np.triu(apart > 1e-4 * own[:, None] * own[None, :], 1)
    told &= ~(kinks[:, None] & kinks[None, :])
    first, second = np.nonzero(told)
    pair = worth(both[told] / apart[told], price[first] + price[second])
    sets: list[tuple[int, ...]] = [(), *((i,) for i in range(right.size)),
                                   *zip(first.tolist(), second.tolist(), strict=True)]
    values = [0.0, *alone.tolist(), *pair.tolist()]
    best = sets[1 + right.size + int(np.argmax(pair))] if pair.size else ()
    for n in range(right.size) if best else ():
        if n not in best and not (kinks[n] and kinks[list(best)].any()):
            some = [*best, n]
            sizes = linalg.lstsq(gram[np.ix_(some, some)], right[some], rcond=1e-6)[0]
            sets.append((*best, n))
            values.append(float(worth(right[some] @ sizes, price[some].sum())))
    top = sets[int(np.argmax(values))]
    whole = Counter(forms[list(top)].tolist())
    like = [n for n, s in enumerate(sets) if whole <= Counter(forms[list(s)].tolist())]
    probability = float(np.exp(linalg.logsumexp(np.array(values)[like])
                               - linalg.logsumexp(values)))
    return tuple(sorted(top, key=lambda n: -alone[n])), probability


def forms_of(products: Sequence[Product]) -> Ints:
    """Return a number for each product (F,), equal where only places of kinks differ."""
    known: list[Product] = []
    out = []
    for product in products:
        n = next((n for n, other in enumerate(known) if same_form(product, other)), len(known))
        known += [product] if n == len(known) else []
        out.append(n)
    return np.array(out, dtype=np.int64)


def _sized(seen: Visible, term: Term, curve: LearnedCurve, target: Array,
           products: Sequence[Product], sigma: float) -> Equation:
    """Return the equation of products with sizes fitted to the rows."""
    free = without_range(_columns(seen, term, products), seen.basis)
    length = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    gram, right, _ = _inner(free / length, target)
    inverse = linalg.pinv(gram, rcond=1e-9)
    return Equation(curve.input, curve.nodes, inverse @ right / length,
                    sigma**2 * inverse / np.outer(length, length), curve.signed, curve.acts,
                    curve.joint, curve.by, curve.by_nodes, tuple(products))


def _within(seen: Visible, term: Term, curve: LearnedCurve, found: Equation) -> bool:
    """Return whether an equation stays within the learned function's band over all rows at once.

    Parts that geometry absorbs are removed from both. The band is as many sigmas wide as holds
    95 % of the functions drawn from the covariance.
    """
    at = [curve.seen(p.setting) for p in seen.system.parts]
    on = np.array(term.on)
    inputs = [np.concatenate([(x[i] if x[i].ndim == 1 else x[i][:, on].ravel()) for x in at])
              for i in range(len(curve.inputs))]
    basis = curve.basis(*inputs)
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, curve.covariance, basis), 0.0))
    nodes = np.meshgrid(*([curve.nodes, curve.by_nodes][:len(curve.inputs)]), indexing="ij")
    values = term.shapes[term.likeliest].gauged(found.at(*(x.ravel() for x in nodes)))
    # between the nodes the equation itself, minus what was taken out at the nodes
    values = found.at(*inputs) + basis @ (values - found.at(*(x.ravel() for x in nodes)))
    sure = np.maximum(sigma, 1e-12 * float(sigma.max()))
    away = np.abs(values - basis @ curve.values) / sure
    normal = np.random.default_rng(0).standard_normal((curve.modes.shape[1], BAND_DRAWS))
    drawn = np.abs(basis @ (curve.modes @ normal)) / sure[:, None]
    return bool(away.max() <= np.quantile(drawn.max(axis=0), SURE.value))
