"""The entries ``learned`` of diagnosis.json: shapes without a cause, in file units."""

from __future__ import annotations

import numpy as np

from ppmcal.diagnosis.learned_shapes import LearnedShape, shapes
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.io.results.diagnosis_parts import HeldOutGap
from ppmcal.io.results.record import Part, Shown, Text
from ppmcal.linalg import Array
from ppmcal.model.effects.learned import INPUTS
from ppmcal.units import Units

DRAWN = 600


class NearKind(Part):
    """A kind of effect that does nearly the same: the cosine of what geometry leaves of both."""

    effect: Text = ""
    cosine: Shown | None = None


class LearnedEntry(Part):
    """A function of ``input`` that data showed, and no name.

    ``on``: joints, one function for all of them; empty where it moves the platform. ``acts``:
    ``joint`` or a pose coordinate; ``by``: ``direction`` where its sign is that of the approach.
    ``rms`` over the rows, in ``unit``; ``low`` to ``high``: where it is known, in ``input_unit``.
    ``gap``: on held-out poses, without and with all that was learned. ``looks``: even, odd,
    kinked, repeating (``period``), hysteretic. ``x``, ``value``, ``sigma``: the curve; ``at``,
    ``partial``: what single rows say of it.
    """

    input: Text = ""
    input_unit: Text = ""
    on: tuple[Text, ...] = ()
    acts: Text = ""
    by: Text = ""
    rms: Shown | None = None
    unit: Text = ""
    low: Shown | None = None
    high: Shown | None = None
    gap: HeldOutGap = HeldOutGap()
    looks: tuple[Text, ...] = ()
    period: Shown | None = None
    near: tuple[NearKind, ...] = ()
    x: tuple[Shown | None, ...] = ()
    value: tuple[Shown | None, ...] = ()
    sigma: tuple[Shown | None, ...] = ()
    at: tuple[Shown | None, ...] = ()
    partial: tuple[Shown | None, ...] = ()

    @classmethod
    def all_of(cls, result: Diagnosis) -> tuple[LearnedEntry, ...]:
        """Return the entries of a diagnosis."""
        if result.learned is None:
            return ()
        units = result.identification.mechanism.units
        gap = HeldOutGap.of(result.learned.gap, result.learned.blocks)
        return tuple(cls.of(s, gap, units) for s in shapes(result.learned, result.found.first))

    @classmethod
    def of(cls, s: LearnedShape, gap: HeldOutGap, units: Units) -> LearnedEntry:
        """Return one term in file units."""
        curve, own = s.curve, units.factor(s.curve.quantity)
        celsius = curve.input_quantity == "deg C"
        per = 1.0 if celsius else units.factor(curve.input_quantity)
        zero = INPUTS[curve.input].zero
        some = np.linspace(0, s.at.size - 1, min(s.at.size, DRAWN)).astype(np.int64)
        return cls(
            input=curve.input, on=s.on, acts=curve.acts, by="direction" if curve.signed else "",
            input_unit=curve.input_quantity if celsius else units.name(curve.input_quantity),
            rms=s.rms / own, unit=units.name(curve.quantity),
            low=curve.nodes[0] / per + zero, high=curve.nodes[-1] / per + zero, gap=gap,
            looks=s.looks, period=None if s.period is None else s.period / per,
            near=tuple(NearKind(effect=label, cosine=c) for label, c in s.near),
            x=_rounded(s.x / per + zero), value=_rounded(s.value / own),
            sigma=_rounded(s.sigma / own), at=_rounded(s.at[some] / per + zero),
            partial=_rounded(s.partial[some] / own))


def _rounded(values: Array) -> tuple[float, ...]:
    return tuple(float(f"{v:.6g}") for v in values.tolist())
