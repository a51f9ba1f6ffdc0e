"""What the data cannot identify: parts of identification.json, and what console and report say.

A sentence about an entry in which a number is missing is empty.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from ppmcal.calibration.fit import Z95, Flat, Unidentifiable
from ppmcal.calibration.knowledge import CALIPER, CollinearParameters, Identifiability, Scale
from ppmcal.io.results.record import Finite, Flag, Part, Text, Whole
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import OfUnit, Units
from ppmcal.wording import MOST, abbreviate_list

SMOOTH = 0.01
"""A flat has a shape where chance would show one as strong this rarely."""
EXACT = 0.9995
"""A correlation that is written as 1."""


def pair_sentence(pair: CollinearParameters) -> str:
    """Return which two kinds of parameter act as one."""
    if not (math.isfinite(pair.correlation) and pair.one and pair.other):
        return ""
    how = "limb by limb" if pair.each else "all limbs alike"
    exactly = "exactly" if abs(pair.correlation) >= EXACT else "almost exactly"
    return (f"{pair.one} and {pair.other}, {how}, are {exactly} correlated (correlation "
            f"{pair.correlation:+.3f}); constrained by the prior.")


def strongest(found: Sequence[CollinearParameters]) -> list[CollinearParameters]:
    """Return pairs by their correlation, those last that a file does not say it of."""
    return sorted(found, key=lambda p: -abs(float(np.nan_to_num(p.correlation))))


class ScaleUncertainty(Part):
    """How well the longest measured distance is known; lengths in ``unit``.

    ``sigma`` with the prior, ``sigma_data`` without, None where it is unobservable; ``open``:
    uncertain by an amount that matters; ``measure_at_least``: the distance that, measured to
    ``measure_to`` (one sigma), halves the uncertainty; ``times``: half of a 95 % interval over
    sigma, bare.
    """

    distance: OfUnit[Finite | None] = None
    sigma: OfUnit[Finite | None] = None
    sigma_data: OfUnit[Finite | None] = None
    open: Flag = False
    prior_dominated: Flag = False
    measure_at_least: OfUnit[Finite | None] = None
    measure_to: OfUnit[Finite | None] = None
    unit: Text = ""
    times: Finite = Z95

    @classmethod
    def of(cls, scale: Scale, units: Units) -> ScaleUncertainty:
        """Return the entry of a scale in file units."""
        return cls.filled(scale, units, distance=scale.length, measure_at_least=scale.needed,
                          measure_to=CALIPER, unit="length")

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
        text = (f"Scale: a distance of {size} is known to "
                f"+- {self.times * self.sigma:.3g} {unit} (95 %)")
        if self.prior_dominated:
            alone = self.sigma_data
            left = (f"+- {self.times * alone:.2g} {unit}"
                    if alone is not None and alone < self.distance else "it open")
            text += f", constrained by the prior; the data alone leave {left}"
        if needed <= self.distance:
            return (f"{text}. One distance of at least {needed:.3g} {unit}, measured to "
                    f"{caliper:.2g} {unit} (one sigma), would halve that.")
        return (f"{text}. That distance measured to {caliper * self.distance / needed:.2g} {unit} "
                "(one sigma) would halve it.")


class UnidentifiableSet(Part):
    """Parameters that the data see only together.

    ``combinations`` of ``parameters`` change nothing that was measured; ``slots``: their paths
    without coordinates; ``limbs`` of the machine's ``of_limbs``, whose they are; ``unseen``: none
    of them has any effect.
    """

    combinations: Whole = 0
    slots: tuple[Text, ...] = ()
    parameters: tuple[Text, ...] = ()
    limbs: tuple[Text, ...] = ()
    of_limbs: Whole = 0
    unseen: Flag = False

    @classmethod
    def of(cls, found: Unidentifiable, mechanism: Mechanism) -> UnidentifiableSet:
        """Return the entry of a set."""
        own = {s.partition(".")[0] for s in found.slots}
        limbs = tuple(limb.name for limb in mechanism.limbs if limb.name in own)
        return cls.filled(found, limbs=limbs, of_limbs=len(mechanism.limbs))

    @property
    def paths(self) -> dict[str, tuple[str, ...]]:
        """Path within the limb -> the limbs that have it; nothing of what is not a limb's."""
        out: dict[str, tuple[str, ...]] = {}
        for slot in self.slots:
            limb, _, path = slot.partition(".")
            if limb in self.limbs:
                out[path] = (*out.get(path, ()), limb)
        return out

    def words(self) -> str:
        """Return the slots, those of all limbs as one."""
        shared: dict[tuple[str, ...], list[str]] = {}
        for path, limbs in self.paths.items():
            shared.setdefault(limbs, []).append(path)
        each = [" and ".join(sorted(paths)) + " of " + (
                    limbs[0] if len(limbs) == 1 else
                    "all limbs" if len(limbs) == self.of_limbs else ", ".join(limbs))
                for limbs, paths in shared.items()]
        other = [s for s in self.slots if s.partition(".")[0] not in self.limbs]
        return ", ".join([*sorted(each), *sorted(other)])


def unidentifiable_words(found: Sequence[UnidentifiableSet]) -> str:
    """Return what cannot be told apart: ``6 of base.point of all limbs; ...``.

    Limbs that have the same are one.
    """
    alike: dict[tuple[object, ...], list[UnidentifiableSet]] = {}
    for one in found:
        key = tuple(sorted(one.paths)) if len(one.limbs) == 1 and len(one.paths) == len(
            one.slots) else one.words()
        alike.setdefault((key, one.combinations, one.unseen), []).append(one)
    out = []
    for (_, combinations, unseen), sets in alike.items():
        first = sets[0]
        limbs = [limb for s in sets for limb in s.limbs]
        words = first.words() if len(sets) == 1 else (
            f"{' and '.join(sorted(first.paths))} of each of "
            f"{'the limbs' if len(limbs) == first.of_limbs else ', '.join(limbs)}")
        total = int(str(combinations)) * len(sets)
        out.append((-total, f"{total} of {words}{' (no effect at all)' if unseen else ''}"))
    return "; ".join(words for _, words in sorted(out))


class IdentifiabilitySummary(Part):
    """What the data cannot identify; ``scale`` is missing where it could not be judged."""

    collinear: tuple[CollinearParameters, ...] = ()
    scale: ScaleUncertainty | None = None

    @classmethod
    def of(cls, found: Identifiability, mechanism: Mechanism) -> IdentifiabilitySummary:
        """Return the entry in file units."""
        scale = {} if found.scale is None else {
            "scale": ScaleUncertainty.of(found.scale, mechanism.units)}
        return cls(collinear=found.collinear, **scale)

    def sentences(self) -> list[str]:
        """Return what a person should know before believing every digit."""
        pairs = [s for p in strongest(self.collinear) if (s := pair_sentence(p))]
        return list(filter(None, [self.scale.sentence() if self.scale else "", *gathered_pairs(
            self.collinear, pairs)]))


def gathered_pairs(found: Sequence[CollinearParameters], each: Sequence[str]) -> list[str]:
    """Return the sentences of pairs, of many one with a count and the strongest."""
    if len(each) <= MOST:
        return list(each)
    names = abbreviate_list([f"{p.one} and {p.other}" for p in strongest(found)],
                            "identification.json, identifiability", joint="; ")
    return [f"{len(each)} pairs of kinds of parameter are correlated exactly or almost exactly: "
            f"{names}; constrained by the prior."]


def flat_sentences(found: Sequence[Flat]) -> Iterator[str]:
    """Yield which parts of the residuals of touches are smooth over the flat, beyond chance."""
    for f in found:
        if f.p_value < SMOOTH and f.dataset and math.isfinite(f.smooth + f.scatter):
            yield (f"{f.dataset}: {f.smooth:.2g} {f.unit} rms of what is left is smooth over the "
                   "flat: its own shape, or what the model misses; touches scatter "
                   f"{f.scatter:.2g} {f.unit} about it (p = {f.p_value:.1g}).")
