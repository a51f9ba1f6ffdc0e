"""Sentences about identification.json, the same on the console and in the report."""

from __future__ import annotations

from ppmcal.calibration.noise import FAILED_NOISE, OVERSTATED
from ppmcal.io.results.identification_parts import Combination, NoiseCheck
from ppmcal.wording import counted

FEW = 0.7
MANY = 1.3
"""Residuals outside of these ratios to the stated noise are told where no probability is."""
TERMS = 6


def noise_verdict(noise: NoiseCheck) -> tuple[str, bool]:
    """Return what the residuals say about the stated noise, and whether that is fine."""
    ratio, p = noise.sigma_ratio, noise.chi2_p
    if ratio is None and p is None:
        return "", True
    tail = ", ".join(([] if ratio is None else [f"ratio {ratio:.3g}"])
                     + ([] if p is None else [f"p = {p:.2g}"]))
    high = ratio is None or ratio > 1.0
    if (p is not None and p < FAILED_NOISE and high) or (p is None and (ratio or 0.0) > MANY):
        return (f"what remains is larger than the stated noise explains ({tail}): something is "
                "missing in the model, or sigma is too small"), False
    if ratio is not None and (ratio < FEW or (p is not None and p > 1.0 - FAILED_NOISE)):
        return (f"what remains is smaller than the stated noise ({tail}): sigma looks too "
                "large"), ratio >= OVERSTATED
    return f"what remains agrees with the stated noise ({tail})", True


def combination(entry: Combination) -> str:
    """Return what acts like one unit of a redundant quantity: ``0.5*leg2.offset - frame.x``."""
    terms = sorted(((k, v) for k, v in entry.depends_on.items() if v), key=lambda t: -abs(t[1]))
    if not terms:
        return "nothing: no effect on these measurements"
    shown = "".join((" - " if v < 0 else " + " if i else "")
                    + ("" if abs(abs(v) - 1) < 5e-4 else f"{abs(v):.3g}*") + k
                    for i, (k, v) in enumerate(terms[:TERMS])).strip()
    return shown + (f" and {counted(len(terms) - TERMS, 'smaller part')}"
                    if len(terms) > TERMS else "")
