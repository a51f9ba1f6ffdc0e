"""Learned terms as short equations, where these do as well in poses left out of the fits.

Sparse regression of what is left, free of geometry, named effects and the other terms, on forms of
the term's own inputs (Brunton et al. 2016, SINDy), with a threshold for every one that is added.
What is chosen has to be chosen again when poses are drawn anew (stability selection, Meinshausen &
Buehlmann 2010; by bootstrap, Fasel et al. 2022), has to lie within the band of what was learned,
and has to predict the held-out poses as well.
"""

from __future__ import annotations

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
from ppmcal.diagnosis.stage import WEAK_SURVIVAL
from ppmcal.diagnosis.term_candidates import Visible, columns_from
from ppmcal.linalg import Array, Bools, Ints, without_range
from ppmcal.model.effects import Setting
from ppmcal.model.effects.learned import LearnedCurve

LEVEL = 0.01
"""Chance gives a product over all that were tried less often than this."""
DRAWS = 100
"""Bootstraps over poses."""
STABLE = 0.75
"""Each product is chosen again in at least this part of them."""
MOST = 3
"""A short equation has at most so many products."""
KINK = 3.0
"""What the place of a kink must be worth besides (log): it is one more number that was tried."""
TWIN = 0.9999
"""Of two products that rows see so much alike (cosine), the simpler is tried."""
BAND = 0.95
"""Of the whole band, row by row, within which an equation has to stay."""

BAND_DRAWS = 500


def equations(seen: Visible, learned: Learned, seed: int) -> tuple[Equation | None, ...]:
    """Return a short equation for each learned term, None where rows do not single one out.

    Args:
        seen: rows from which the terms were learned.
        learned: the terms.
        seed: of the bootstrap.
    """
    return tuple(_equation(seen, learned, i, seed) for i in range(len(learned.terms)))


def _equation(seen: Visible, learned: Learned, which: int, seed: int) -> Equation | None:
    term, curve = learned.terms[which], learned.curves[which]
    target = _target(seen, learned, which)
    products, columns = _visible(seen, term, products_of(curve))
    if not products:
        return None
    kinks = np.array([kinked(p) for p in products])
    price = np.log(len(products) / LEVEL) + KINK * kinks
    free = without_range(columns, seen.basis)
    chosen = chosen_products(*_inner(free, target), seen.freedom, price, kinks)
    if not chosen:
        return None
    stability = _stability(seen, columns, target, products, chosen, price, kinks, seed)
    if stability.min() < STABLE:
        return None
    found = _sized(seen, term, curve, target, [products[i] for i in chosen], learned.sigma)
    if not _within(seen, term, curve, found):
        return None
    return replace(found, stability=stability)


def sized_again(seen: Visible, learned: Learned, found: Sequence[Equation | None]
                ) -> tuple[Equation | None, ...]:
    """Return equations with the sizes that other rows give them, None where beyond the band."""
    out: list[Equation | None] = []
    for i, (term, curve, old) in enumerate(zip(learned.terms, learned.curves, found, strict=True)):
        new = None
        if old is not None:
            new = _sized(seen, term, curve, _target(seen, learned, i), old.products, learned.sigma)
            new = replace(new, stability=old.stability, after=old.after)
            new = new if _within(seen, term, curve, new) else None
        out.append(new)
    return tuple(out)


def _target(seen: Visible, learned: Learned, which: int) -> Array:
    """Return what is left (n,) without all terms but one."""
    others = [t.candidate.free @ c.values for i, (t, c) in enumerate(zip(
        learned.terms, learned.curves, strict=True)) if i != which]
    return np.asarray(seen.left - sum(others, np.zeros_like(seen.left)))


def _columns(seen: Visible, term: Term, products: Sequence[Product]) -> Array:
    """Return the whitened columns (n, F) of products."""
    curve = term.candidate.curve

    def weights(setting: Setting) -> Array:
        found = values_of(products, dict(zip(curve.inputs, curve.seen(setting), strict=True)))
        if not curve.signed:
            return found
        found = found if found.ndim == 3 else found[:, None]
        return np.asarray(found * setting.approach[..., None])

    return columns_from(seen, curve, term.candidate.on, weights)


def _visible(seen: Visible, term: Term, products: Sequence[Product]
             ) -> tuple[list[Product], Array]:
    """Return the products that geometry does not do as well, no two alike, and their columns."""
    columns = _columns(seen, term, products)
    free = without_range(columns, seen.basis)
    length = np.linalg.norm(free, axis=0)
    seen_well = length > WEAK_SURVIVAL * np.linalg.norm(columns, axis=0)
    unit = free / np.where(length > 0.0, length, 1.0)
    kept: list[int] = []
    for i in np.flatnonzero(seen_well).tolist():
        if not kept or np.abs(unit[:, kept].T @ unit[:, i]).max() < TWIN:
            kept.append(i)
    # of one size, so that inner products are of one size too
    return [products[i] for i in kept], columns[:, kept] / length[kept]


def _inner(columns: Array, target: Array) -> tuple[Array, Array, float]:
    return columns.T @ columns, columns.T @ target, float(target @ target)


def chosen_products(gram: Array, right: Array, square: float, freedom: int, price: Array,
                    kinks: Bools) -> tuple[int, ...]:
    """Return which columns to use, the strongest first: the likeliest set of at most three.

    All single columns and all pairs are tried, and all thirds to the best pair; each column has
    to be worth its price in log likelihood. At most one has a kink: several would be a spline.

    Args:
        gram: inner products of the columns (F, F).
        right: with the target (F,).
        square: of the target.
        freedom: values less what was fitted.
        price: of each column (F,).
        kinks: whether each has a kink (F,).
    """
    def worth(explained: Array, cost: Array) -> Array:
        left = np.maximum(square - explained, 1e-9 * square)
        return np.asarray(0.5 * freedom * np.log(square / left) - cost)

    own = np.maximum(np.diag(gram), 1e-300)
    alone = worth(right**2 / own, price)
    best = int(np.argmax(alone))
    sets: list[tuple[int, ...]] = [(best,)]
    values = [float(alone[best])]
    apart = own[:, None] * own[None, :] - gram**2
    both = (right[:, None] ** 2 * own[None, :] + right[None, :] ** 2 * own[:, None]
            - 2.0 * right[:, None] * right[None, :] * gram)
    told = apart > 1e-4 * own[:, None] * own[None, :]
    told &= ~(kinks[:, None] & kinks[None, :])
    pair = worth(np.where(told, both / np.where(told, apart, 1.0), 0.0),
                 price[:, None] + price[None, :])
    i, j = (int(n) for n in np.unravel_index(int(np.argmax(pair)), pair.shape))
    sets.append((i, j) if alone[i] >= alone[j] else (j, i))
    values.append(float(pair[i, j]))
    while len(sets[-1]) < min(MOST, right.size):
        more = [(*sets[-1], n) for n in range(right.size) if n not in sets[-1]
                and not (kinks[n] and kinks[list(sets[-1])].any())]
        if not more:
            break
        gains = [float(worth(right[list(s)] @ linalg.lstsq(
            gram[np.ix_(s, s)], right[list(s)], rcond=1e-6)[0], price[list(s)].sum()))
            for s in more]
        sets.append(more[int(np.argmax(gains))])
        values.append(max(gains))
    top = int(np.argmax(values))
    return sets[top] if values[top] > 0.0 else ()


def _stability(seen: Visible, columns: Array, target: Array, products: Sequence[Product],
               chosen: Sequence[int], price: Array,
               kinks: Bools, seed: int) -> Array:
    """Return in what part of the bootstraps over poses each product is chosen again (len,).

    Geometry and named effects are fitted in each of them. Places of kinks may differ.
    """
    rng = np.random.default_rng(seed)
    pose = _poses(seen)
    whole = np.column_stack([seen.basis, columns, target])
    r, count = seen.basis.shape[1], int(pose.max()) + 1
    again = np.zeros(len(chosen))
    for _ in range(DRAWS):
        weight = np.bincount(rng.integers(count, size=count), minlength=count)[pose]
        inner = (whole * weight[:, None]).T @ whole
        w, v = linalg.eigh(inner[:r, :r])
        use = w > 1e-9 * w.max(initial=1e-300)
        tie = (v[:, use] / np.sqrt(w[use])).T @ inner[:r, r:]
        rest = inner[r:, r:] - tie.T @ tie
        found = chosen_products(rest[:-1, :-1], rest[:-1, -1], float(rest[-1, -1]), seen.freedom,
                                price, kinks)
        again += [any(same_form(products[i], products[j]) for j in found) for i in chosen]
    return again / DRAWS


def _poses(seen: Visible) -> Ints:
    """Return the commanded pose of each value (n,), numbered through all data sets."""
    return np.repeat(seen.system.group, seen.system.residual.shape[1])


def _sized(seen: Visible, term: Term, curve: LearnedCurve, target: Array,
           products: Sequence[Product], sigma: float) -> Equation:
    """Return the equation of products with the sizes that the rows give them."""
    free = without_range(_columns(seen, term, products), seen.basis)
    length = np.maximum(np.linalg.norm(free, axis=0), 1e-300)
    gram, right, _ = _inner(free / length, target)
    inverse = linalg.pinv(gram, rcond=1e-9)
    return Equation(curve.input, curve.nodes, inverse @ right / length,
                    sigma**2 * inverse / np.outer(length, length), curve.signed, curve.acts,
                    curve.joint, curve.by, curve.by_nodes, tuple(products))


def _within(seen: Visible, term: Term, curve: LearnedCurve, found: Equation) -> bool:
    """Return whether an equation stays within the learned function's band of all rows at once.

    What geometry does as well is taken out of both. So many sigmas wide that 95 % of the functions
    that its covariance draws stay within.
    """
    at = [curve.seen(p.setting) for p in seen.system.parts]
    on = np.array(term.candidate.on)
    inputs = [np.concatenate([(x[i] if x[i].ndim == 1 else x[i][:, on].ravel()) for x in at])
              for i in range(len(curve.inputs))]
    basis = curve.basis(*inputs)
    sigma = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", basis, curve.covariance, basis), 0.0))
    nodes = np.meshgrid(*([curve.nodes, curve.by_nodes][:len(curve.inputs)]), indexing="ij")
    values = term.shape.gauged(found.at(*(x.ravel() for x in nodes)))
    # between the nodes as the equation is, less what was taken out there
    values = found.at(*inputs) + basis @ (values - found.at(*(x.ravel() for x in nodes)))
    sure = np.maximum(sigma, 1e-12 * float(sigma.max()))
    away = np.abs(values - basis @ curve.values) / sure
    normal = np.random.default_rng(0).standard_normal((curve.modes.shape[1], BAND_DRAWS))
    drawn = np.abs(basis @ (curve.modes @ normal)) / sure[:, None]
    return bool(away.max() <= np.quantile(drawn.max(axis=0), BAND))
