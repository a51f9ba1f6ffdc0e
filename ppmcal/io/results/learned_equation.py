"""The entry ``equation`` of a learned term: a short equation in recorded inputs, in file units."""

from __future__ import annotations

import math
from typing import Any

from ppmcal.diagnosis.equation_forms import Equation, InputForm, Product
from ppmcal.io.results.record import Part, Shown, Text
from ppmcal.model.effects.inputs import DIRECTION
from ppmcal.model.effects.learned import INPUTS
from ppmcal.model.effects.learned_curve import si_factor
from ppmcal.units import Units
from ppmcal.wording import number


class EquationFactor(Part):
    """A form of z = (variable - origin)/scale: ``power``, max(z, 0), max(-z, 0), |z|, its sign.

    ``variable``: as effects know it, ``travel`` or ``pose.x``; ``origin`` and ``scale`` in
    ``unit``, the scale in kelvin where that is C.
    """

    variable: Text = ""
    form: Text = ""
    degree: int = 1
    origin: Shown | None = None
    scale: Shown | None = None
    unit: Text = ""


class EquationTerm(Part):
    """``size`` times its factors."""

    size: Shown | None = None
    sigma: Shown | None = None
    factors: tuple[EquationFactor, ...] = ()


def equation_fields(found: Equation, on: str, units: Units) -> dict[str, Any]:
    """Return an equation as fields of an entry, file units; ``on``: what it is an error of."""
    own = units.factor(found.quantity)
    unit, terms, parts = units.name(found.quantity), [], []
    for n, product in enumerate(found.products):
        factors = [_factor(found, f, units) for f in product]
        per = _si_scale(found, product, factors, units) / own
        size = float(found.values[n]) * per
        sigma = math.sqrt(max(float(found.covariance[n, n]), 0.0)) * per
        terms.append(EquationTerm(size=size, sigma=sigma, factors=tuple(factors)))
        words = " * ".join([f"{number(abs(size), 3)} {unit}", *(_words(f) for f in factors),
                            *([APPROACH] if found.signed else [])])
        sign = "-" if size < 0.0 else ""
        parts.append(f"{sign}{words}" if n == 0 else f" {sign or '+'} {words}")
    return {"equation": f"{on}: {''.join(parts)}", "equation_unit": unit,
            "equation_by": DIRECTION.name if found.signed else "", "terms": tuple(terms),
            "equation_probability": found.probability, "equation_after": found.after}


APPROACH = "approach"
"""What effects call the direction, +1 or -1."""


def _factor(found: Equation, factor: InputForm, units: Units) -> EquationFactor:
    """Return a factor whose scale is the power of ten below its input's reach."""
    quantity, zero = found.quantity_of(factor.input), INPUTS[factor.input].zero
    per = si_factor(units, quantity)
    nodes = found.nodes if factor.input == found.input else found.by_nodes
    reach = max(abs(float(x) - factor.origin) for x in (nodes[0], nodes[-1])) / per
    return EquationFactor(
        variable=INPUTS[factor.input].variable, form=factor.form, degree=factor.degree,
        origin=factor.origin / per + zero,
        scale=1.0 if factor.form == "sign" else _round(reach),
        unit="degC" if quantity == "deg C" else units.name(quantity))


def _round(reach: float) -> float:
    """Return the largest power of ten that is at most ``reach``."""
    return float(10.0 ** math.floor(math.log10(reach) + 1e-9))


def _si_scale(found: Equation, product: Product, factors: list[EquationFactor], units: Units
              ) -> float:
    """Return what the product is, SI, where every factor of the file is 1."""
    out = 1.0
    for f, told in zip(product, factors, strict=True):
        if f.form != "sign":
            per = si_factor(units, found.quantity_of(f.input))
            out *= (float(told.scale or 1.0) * per) ** (f.degree if f.form == "power" else 1)
    return out


def _words(f: EquationFactor) -> str:
    """Return ``(travel/100 mm)^2``, ``(temperature - 20 degC)/10 K``."""
    origin, scale = float(f.origin or 0.0), number(float(f.scale or 1.0), 4)
    celsius = f.unit == "degC"
    away = f.variable if origin == 0.0 and not celsius else (
        f"({f.variable} {'-' if origin >= 0.0 else '+'} {number(abs(origin))} {f.unit})")
    if f.form == "sign":
        return f"sign({away.strip('()')})"
    part = f"{away}/{scale} {'K' if celsius else f.unit}".rstrip()
    if f.form == "power":
        bare = away.startswith("(")
        return f"({part})^{f.degree}" if f.degree > 1 else part if bare else f"({part})"
    return {"above": f"max({part}, 0)", "below": f"max(-{part}, 0)", "abs": f"|{part}|"}[f.form]
