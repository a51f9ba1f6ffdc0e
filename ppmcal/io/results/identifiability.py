"""What the data cannot identify: parts of identification.json, and what console and report say.

A sentence about an entry in which a number is missing is empty.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ppmcal.calibration.flatness import Flat
from ppmcal.calibration.identifiability import (
    CALIPER,
    CollinearParameters,
    Identifiability,
    Scale,
)
from ppmcal.io.results.record import Finite, Flag, Part, Text, Whole
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import Units
from ppmcal.wording import MOST, some

Z95 = 1.96
SMOOTH = 0.01
"""A flat has a shape where chance would show one as strong this rarely."""
EXACT = 0.9995
"""A correlation that is written as 1."""


class CollinearPair(Part):
    """Two kinds of slot that are correlated (bare), limb by limb or all limbs alike."""

    a: Text = ""
    b: Text = ""
    correlation: Finite | None = None
    limb_by_limb: Flag = False

    @classmethod
    def of(cls, pair: CollinearParameters) -> CollinearPair:
        """Return the entry of a pair."""
        return cls(a=pair.one, b=pair.other, correlation=pair.correlation, limb_by_limb=pair.each)

    def sentence(self) -> str:
        """Return which two kinds of parameter act as one."""
        if self.correlation is None or not (self.a and self.b):
            return ""
        how = "limb by limb" if self.limb_by_limb else "all limbs alike"
        exactly = "exactly" if abs(self.correlation) >= EXACT else "almost exactly"
        return (f"{self.a} and {self.b}, {how}, are {exactly} correlated (correlation "
                f"{self.correlation:+.3f}); constrained by the prior.")


class ScaleUncertainty(Part):
    """How well the longest measured distance is known; lengths in ``unit``.

    ``sigma`` with the prior, ``sigma_data`` without, None where it is unobservable; ``open``:
    uncertain by an amount that matters; ``measure_at_least``: the distance that, measured to
    ``measure_to`` (one sigma), halves the uncertainty.
    """

    distance: Finite | None = None
    sigma: Finite | None = None
    sigma_data: Finite | None = None
    open: Flag = False
    prior_dominated: Flag = False
    measure_at_least: Finite | None = None
    measure_to: Finite | None = None
    unit: Text = ""

    @classmethod
    def of(cls, scale: Scale, units: Units) -> ScaleUncertainty:
        """Return the entry of a scale in file units."""
        f = units.factor("length")
        return cls(distance=scale.length / f, sigma=scale.sigma / f,
                   sigma_data=scale.sigma_data / f, open=scale.open,
                   prior_dominated=scale.prior_dominated, measure_at_least=scale.needed / f,
                   measure_to=CALIPER / f, unit=units.length)

    def sentence(self) -> str:
        """Return how well a distance is known, and what to measure to know it better."""
        if not self.open or self.distance is None or self.distance <= 0.0:
            return ""
        unit, size = self.unit, f"{self.distance:.4g} {self.unit}"
        if self.sigma is None:
            return (f"Scale is unobservable: nothing constrains the distance of {size} between "
                    "the measured positions that lie farthest apart. Measure one distance.")
        needed, caliper = self.measure_at_least or 0.0, self.measure_to or 0.0
        if needed <= 0.0 or caliper <= 0.0:
            return ""
        text = f"Scale: a distance of {size} is known to +- {Z95 * self.sigma:.3g} {unit} (95 %)"
        if self.prior_dominated:
            alone = self.sigma_data
            left = (f"+- {Z95 * alone:.2g} {unit}"
                    if alone is not None and alone < self.distance else "it open")
            text += f", constrained by the prior; the data alone leave {left}"
        if needed <= self.distance:
            return (f"{text}. One distance of at least {needed:.3g} {unit}, measured to "
                    f"{caliper:.2g} {unit} (one sigma), would halve that.")
        return (f"{text}. That distance measured to {caliper * self.distance / needed:.2g} {unit} "
                "(one sigma) would halve it.")


class IdentifiabilitySummary(Part):
    """What the data cannot identify; ``scale`` is missing where it could not be judged."""

    collinear: tuple[CollinearPair, ...] = ()
    scale: ScaleUncertainty | None = None

    @classmethod
    def of(cls, found: Identifiability, mechanism: Mechanism) -> IdentifiabilitySummary:
        """Return the entry in file units."""
        pairs = tuple(CollinearPair.of(p) for p in found.collinear)
        if found.scale is None:
            return cls(collinear=pairs)
        return cls(collinear=pairs, scale=ScaleUncertainty.of(found.scale, mechanism.units))

    def sentences(self) -> list[str]:
        """Return what a person should know before believing every digit."""
        pairs = [s for p in sorted(self.collinear, key=lambda p: -abs(p.correlation or 0.0))
                 if (s := p.sentence())]
        return list(filter(None, [self.scale.sentence() if self.scale else "", *gathered_pairs(
            self.collinear, pairs)]))


def gathered_pairs(found: Sequence[CollinearPair], each: Sequence[str]) -> list[str]:
    """Return the sentences of pairs, of many one with a count and the strongest."""
    if len(each) <= MOST:
        return list(each)
    strongest = sorted(found, key=lambda p: -abs(p.correlation or 0.0))
    names = some([f"{p.a} and {p.b}" for p in strongest], "identification.json, identifiability",
                 joint="; ")
    return [f"{len(each)} pairs of kinds of parameter are correlated exactly or almost exactly: "
            f"{names}; constrained by the prior."]


class FlatShape(Part):
    """Rms of the residuals of touches, ``unit``: the part smooth over the flat, and the scatter.

    ``degree`` of the polynomial and ``p_value`` of a shape as strong by chance are bare.
    """

    dataset: Text = ""
    smooth: Finite | None = None
    scatter: Finite | None = None
    degree: Whole = 0
    p_value: Finite | None = None
    unit: Text = ""

    @classmethod
    def of(cls, flat: Flat, units: Units) -> FlatShape:
        """Return the entry of a flat in file units."""
        f = units.factor("length")
        return cls(dataset=flat.dataset, smooth=flat.smooth / f, scatter=flat.scatter / f,
                   degree=flat.degree, p_value=flat.p_value, unit=units.length)

    def sentence(self) -> str:
        """Return which part of the residuals is smooth over the flat, empty where chance is."""
        if self.smooth is None or self.scatter is None or self.p_value is None or (
                self.p_value >= SMOOTH or not self.dataset):
            return ""
        return (f"{self.dataset}: {self.smooth:.2g} {self.unit} rms of what is left is smooth "
                "over the flat: its own shape, or what the model misses; touches scatter "
                f"{self.scatter:.2g} {self.unit} about it (p = {self.p_value:.1g}).")


def flat_sentences(found: Sequence[FlatShape]) -> Iterator[str]:
    """Yield which parts of the residuals of touches are smooth over the flat."""
    return filter(None, (f.sentence() for f in found))
