"""The entries ``learned`` of diagnosis.json: shapes without a cause, and equations of them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from ppmcal.diagnosis.equation_forms import Equation, InputForm, Product
from ppmcal.diagnosis.learned_shapes import LearnedShape, shapes
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.io.results.diagnosis_parts import HeldOutGap
from ppmcal.io.results.record import Part, PlainCell, Shown, Text
from ppmcal.model.effects.inputs import DIRECTION
from ppmcal.model.effects.learned import INPUTS, JOINT
from ppmcal.model.effects.learned_curve import si_factor
from ppmcal.units import Key, OfUnit, Quantity, Units
from ppmcal.wording import actuator_list, number


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
    """Return a factor whose scale is the largest power of ten within its input's reach."""
    quantity, zero = found.quantity_of(factor.input), INPUTS[factor.input].zero
    per = si_factor(units, quantity)
    nodes = found.nodes if factor.input == found.input else found.by_nodes
    reach = max(abs(float(x) - factor.origin) for x in (nodes[0], nodes[-1])) / per
    return EquationFactor(
        variable=INPUTS[factor.input].variable, form=factor.form, degree=factor.degree,
        origin=factor.origin / per + zero,
        scale=1.0 if factor.form == "sign" else float(
            10.0 ** math.floor(math.log10(reach) + 1e-9)),
        unit="degC" if quantity == "deg C" else units.name(quantity))


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


LOOKS = {"even": "alike on both sides of its middle (an even function)",
         "odd": "opposite on both sides of its middle (an odd function)"}
"""What functions are called, in plain words."""
DRAWN, DIGITS = 600, 6
Curve = Annotated[tuple[Shown | None, ...], Quantity(of="unit", digits=DIGITS)]
Inputs = Annotated[tuple[Shown | None, ...], Quantity(digits=DIGITS)]


class LearnedEntry(Part):
    """A function of ``input`` that data showed, and no name.

    ``on``: joints, one function for all of them; empty where it moves the platform. ``acts``:
    ``joint`` or a pose coordinate; ``by``: ``direction`` where its sign is that of the approach.
    ``rms`` over the rows, in ``unit``; ``low`` to ``high``: where it is known, in ``input_unit``.
    ``gap``: on held-out poses, without and with all that was learned. ``looks``: even, odd,
    kinked, repeating (``period``), hysteretic. ``x``, ``value``, ``sigma``: the curve; ``at``,
    ``partial``: what single rows say of it. Of two inputs ``by`` is the second one, known from
    ``by_low`` to ``by_high``, and the curves are those at its ``by_ends``: ``other`` at the first,
    ``value`` at the last. ``equation``: short, where one does as well: the sum of its
    ``terms``, times the direction where ``equation_by`` says so, of a probability among all that
    were tried; ``equation_after``: rms over the noise in poses left out of the fits, with it.
    ``near``: kinds of effect that do nearly the same: the cosine of what geometry leaves of both.
    """

    input: Text = ""
    input_unit: Text = ""
    on: tuple[Text, ...] = ()
    acts: Text = ""
    by: Text = ""
    by_unit: Text = ""
    by_low: Shown | None = None
    by_high: Shown | None = None
    by_ends: tuple[Shown, ...] = ()
    rms: OfUnit[Shown | None] = None
    unit: Text = ""
    low: Shown | None = None
    high: Shown | None = None
    gap: HeldOutGap = HeldOutGap()
    looks: tuple[Text, ...] = ()
    period: Shown | None = None
    near: tuple[Mapping[Text, PlainCell], ...] = ()
    x: Inputs = ()
    value: Curve = ()
    sigma: Curve = ()
    at: Inputs = ()
    partial: Curve = ()
    other: Curve = ()
    equation: Annotated[Text | None, Key("equation.text", whole=True)] = None
    equation_unit: Annotated[Text, Key("equation.unit")] = ""
    equation_by: Annotated[Text, Key("equation.by")] = ""
    terms: Annotated[tuple[EquationTerm, ...], Key("equation.terms")] = ()
    equation_probability: Annotated[Shown | None, Key("equation.probability")] = None
    equation_after: Annotated[Shown | None, Key("equation.after")] = None

    def name(self, total: int) -> str:
        """Return ``error of leg3 by its travel``, ``platform's z by x``; of so many actuators."""
        what = (f"error of {actuator_list(self.on, total)} by " if self.on
                else f"platform's {self.acts} by ")
        own = "" if not self.on else "its " if len(self.on) == 1 else "their own "
        source = "temperature" if self.input == "temperature" else own + self.input
        if self.by and self.by != "direction":
            return f"{what}{source} and {self.by}"
        return f"{what}{source}" + (", with the sign of the approach" if self.by else "")

    def sentence(self, total: int) -> str:
        """Return what was learned, and the short equation that does as well if there is one."""
        text = (f"Learned, with no cause claimed: {self.name(total)}, {number(self.rms, 3)} "
                f"{self.unit} rms over {number(self.low)} to {number(self.high)} "
                f"{self.input_unit}{self._look()}.")
        if self.equation is None:
            return text
        sizes = ", ".join(f"{number(t.size, 3)} +- {number(t.sigma, 2)} {self.equation_unit}"
                          for t in self.terms)
        return f"{text} As an equation that does as well: {self.equation} (sizes {sizes})."

    def _look(self) -> str:
        words = [f"{w} (every {number(self.period, 3)} {self.input_unit})"
                 if w == "repeating" and self.period else LOOKS.get(w, w) for w in self.looks]
        like = [f"; nearest in the library: {n.get('effect', '')} (cosine "
                f"{number(n.get('cosine'), 2)})" for n in self.near[:1]]
        return f"; it looks {', '.join(words)}" * bool(words) + "".join(like)

    @classmethod
    def all_of(cls, result: Diagnosis) -> tuple[LearnedEntry, ...]:
        """Return the entries of a diagnosis."""
        if result.learned is None:
            return ()
        units = result.identification.mechanism.units
        gap = HeldOutGap.of(result.learned.gap, ("learned terms",))
        return tuple(cls.of(s, gap, units) for s in shapes(result.learned, result.found.first))

    @classmethod
    def of(cls, s: LearnedShape, gap: HeldOutGap, units: Units) -> LearnedEntry:
        """Return one term in file units."""
        curve = s.curve
        per, zero = si_factor(units, curve.input_quantity), INPUTS[curve.input].zero
        where = ", ".join(s.on) if curve.acts == JOINT else f"platform {curve.acts}"
        some = np.linspace(0, s.at.size - 1, min(s.at.size, DRAWN)).astype(np.int64)
        return cls.filled(
            s, units, input=curve.input, acts=curve.acts,
            by=curve.by or ("direction" if curve.signed else ""), **_second(s, units),
            input_unit=_unit(units, curve.input_quantity),
            unit=curve.quantity,
            low=curve.nodes[0] / per + zero, high=curve.nodes[-1] / per + zero, gap=gap,
            period=None if s.period is None else s.period / per,
            near=tuple({"effect": label, "cosine": c} for label, c in s.near),
            x=s.x / per + zero, at=s.at[some] / per + zero, partial=s.partial[some],
            **(equation_fields(s.equation, where, units) if s.equation else {"equation": None}))


def _second(s: LearnedShape, units: Units) -> dict[str, Any]:
    """Return what an entry says of a second input, nothing without one."""
    curve = s.curve
    if not curve.by:
        return {}
    quantity = curve.quantity_of(curve.by)
    per, zero = si_factor(units, quantity), INPUTS[curve.by].zero
    return {"by_unit": _unit(units, quantity), "by_low": curve.by_nodes[0] / per + zero,
            "by_high": curve.by_nodes[-1] / per + zero,
            "by_ends": tuple(e / per + zero for e in s.ends)}


def _unit(units: Units, quantity: str) -> str:
    return quantity if quantity == "deg C" else units.name(quantity)
