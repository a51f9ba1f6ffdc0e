"""What the data cannot identify: parts of identification.json, and what console and report say.

A sentence about an entry in which a number is missing is empty.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Flat, Unidentifiable
from ppmcal.calibration.knowledge import CollinearParameters, Scale
from ppmcal.model.mechanism import Mechanism
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


def scale_sentence(scale: Scale) -> str:
    """Return how well a distance, file units, is known, and what to measure to know it better."""
    if not (scale.open and scale.length > 0.0):
        return ""
    unit, size = scale.unit, f"{scale.length:.4g} {scale.unit}"
    if not math.isfinite(scale.sigma):
        return (f"Scale is unobservable: nothing constrains the distance of {size} between "
                "the measured positions that lie farthest apart. Measure one distance.")
    needed, caliper = scale.needed, scale.measure_to
    if not (needed > 0.0 and caliper > 0.0):
        return ""
    text = (f"Scale: a distance of {size} is known to "
            f"+- {scale.times * scale.sigma:.3g} {unit} (95 %)")
    if scale.prior_dominated:
        left = (f"+- {scale.times * scale.sigma_data:.2g} {unit}"
                if scale.sigma_data < scale.length else "it open")
        text += f", constrained by the prior; the data alone leave {left}"
    if needed <= scale.length:
        return (f"{text}. One distance of at least {needed:.3g} {unit}, measured to "
                f"{caliper:.2g} {unit} (one sigma), would halve that.")
    return (f"{text}. That distance measured to {caliper * scale.length / needed:.2g} {unit} "
            "(one sigma) would halve it.")


def sets_of(found: Sequence[Unidentifiable], mechanism: Mechanism) -> tuple[Unidentifiable, ...]:
    """Return sets that say whose limbs' they are."""
    names = [limb.name for limb in mechanism.limbs]
    return tuple(replace(s, of_limbs=len(names), limbs=tuple(
        n for n in names if n in {slot.partition(".")[0] for slot in s.slots})) for s in found)


def _paths(found: Unidentifiable) -> dict[str, tuple[str, ...]]:
    """Return path within the limb -> the limbs that have it; nothing of what is not a limb's."""
    out: dict[str, tuple[str, ...]] = {}
    for slot in found.slots:
        limb, _, path = slot.partition(".")
        if limb in found.limbs:
            out[path] = (*out.get(path, ()), limb)
    return out


def _words(found: Unidentifiable) -> str:
    """Return the slots, those of all limbs as one."""
    shared: dict[tuple[str, ...], list[str]] = {}
    for path, limbs in _paths(found).items():
        shared.setdefault(limbs, []).append(path)
    each = [" and ".join(sorted(paths)) + " of " + (
                limbs[0] if len(limbs) == 1 else
                "all limbs" if len(limbs) == found.of_limbs else ", ".join(limbs))
            for limbs, paths in shared.items()]
    other = [s for s in found.slots if s.partition(".")[0] not in found.limbs]
    return ", ".join([*sorted(each), *sorted(other)])


def unidentifiable_words(found: Sequence[Unidentifiable]) -> str:
    """Return what cannot be told apart: ``6 of base.point of all limbs; ...``.

    Limbs that have the same are one.
    """
    alike: dict[tuple[object, ...], list[Unidentifiable]] = {}
    for one in found:
        key = tuple(sorted(_paths(one))) if len(one.limbs) == 1 and len(_paths(one)) == len(
            one.slots) else _words(one)
        alike.setdefault((key, one.combinations, one.unseen), []).append(one)
    out = []
    for (_, combinations, unseen), sets in alike.items():
        first = sets[0]
        limbs = [limb for s in sets for limb in s.limbs]
        words = _words(first) if len(sets) == 1 else (
            f"{' and '.join(sorted(_paths(first)))} of each of "
            f"{'the limbs' if len(limbs) == first.of_limbs else ', '.join(limbs)}")
        total = int(str(combinations)) * len(sets)
        out.append((-total, f"{total} of {words}{' (no effect at all)' if unseen else ''}"))
    return "; ".join(words for _, words in sorted(out))


def open_sentences(collinear: Sequence[CollinearParameters], scale: Scale | None) -> list[str]:
    """Return what a person should know before believing every digit; ``scale``: file units."""
    pairs = [s for p in strongest(collinear) if (s := pair_sentence(p))]
    return list(filter(None, [scale_sentence(scale) if scale else "",
                              *gathered_pairs(collinear, pairs)]))


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
