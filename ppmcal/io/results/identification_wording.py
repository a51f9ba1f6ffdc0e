"""Sentences about identification.json, the same on the console and in the report."""

from __future__ import annotations

import math

from ppmcal.calibration.fit import LARGER, SMALLER, Noise
from ppmcal.calibration.validation import Dependence
from ppmcal.wording import chance, pluralize

TERMS = 6


def noise_verdict(noise: Noise) -> tuple[str, bool]:
    """Return what the residuals say about the noise, and whether that is fine."""
    words, state = noise_words(noise), noise.state
    if words and state == LARGER:
        return f"{words}: something is missing in the model, or sigma is too small", False
    if words and state == SMALLER:
        return f"{words}: sigma looks too large", False
    return words, True


def noise_words(noise: Noise) -> str:
    """Return the same without what it means, empty where the noise was not checked."""
    ratio, p = noise.sigma_ratio, noise.chi2_p
    tail = ", ".join([f"ratio {ratio:.3g}"] * math.isfinite(ratio)
                     + [chance(p)] * math.isfinite(p))
    are = {LARGER: "exceed", SMALLER: "are below"}.get(noise.state, "are consistent with")
    return f"residuals {are} the {noise.source} noise ({tail})" if tail else ""


SHORT = {
    "gcv": "95 % intervals take the prior scale that cross-validation chose as known: in simulated "
           "campaigns they held the truth 83 to 91 % of the time",
    "damped": "95 % intervals do not count what damping leaves near nominal: in simulated "
              "campaigns they held the truth 88 % of the time"}
"""What the intervals of a method leave out, and how often they hold."""


def short_intervals(method: str) -> list[str]:
    """Return that the 95 % intervals of a method are too short, if they are."""
    return [SHORT[method]] if method in SHORT else []


def combination(entry: Dependence) -> str:
    """Return what acts like one unit of a redundant quantity: ``0.5*leg2.offset - frame.x``."""
    terms = sorted(((k, v) for k, v in entry.depends_on.items() if abs(v) > 0.0),
                   key=lambda t: -abs(t[1]))
    if not terms:
        return "nothing: no effect on these measurements"
    shown = "".join((" - " if v < 0 else " + " if i else "")
                    + ("" if abs(abs(v) - 1) < 5e-4 else f"{abs(v):.3g}*") + k
                    for i, (k, v) in enumerate(terms[:TERMS])).strip()
    return shown + (f" and {pluralize(len(terms) - TERMS, 'smaller part')}"
                    if len(terms) > TERMS else "")
