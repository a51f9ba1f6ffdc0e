"""What the data do not tell, in words and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ppmcal.flatness import Flat
from ppmcal.mechanism import Mechanism
from ppmcal.units import Units
from ppmcal.untold import CALIPER, Scale, Untold

Z95 = 1.96
SMOOTH = 0.01
"""A flat has a shape where chance would show one as strong this rarely."""


def sentences(found: Untold, mechanism: Mechanism) -> list[str]:
    """Return what a person should know before believing every digit, a sentence or two each."""
    out = []
    if found.scale is not None and found.scale.open:
        out.append(_scale(found.scale, mechanism.units))
    for t in found.twins:
        how = "limb by limb" if t.each else "all limbs alike"
        out.append(f"{t.one} and {t.other}, {how}, are one direction to these data (correlation "
                   f"{t.correlation:+.3f}): the drawing decides between them.")
    return out


def _scale(scale: Scale, units: Units) -> str:
    f, unit = units.factor("length"), units.length
    size = f"{scale.length / f:.4g} {unit}"
    if not np.isfinite(scale.sigma):
        return (f"Scale is not told at all: nothing holds the distance of {size} between the "
                "measured positions that lie farthest apart. Measure one distance.")
    text = f"Scale: a distance of {size} is known to +- {Z95 * scale.sigma / f:.3g} {unit} (95 %)"
    if scale.held:
        alone = (f"+- {Z95 * scale.alone / f:.2g} {unit}" if scale.alone < scale.length
                 else "it open")
        text += f" from the tolerances; the data alone leave {alone}"
    if scale.needed <= scale.length:
        return (f"{text}. One distance of at least {scale.needed / f:.3g} {unit}, measured to "
                f"{CALIPER / f:.2g} {unit} (one sigma), would halve that.")
    sigma = CALIPER * scale.length / scale.needed
    return f"{text}. That distance measured to {sigma / f:.2g} {unit} (one sigma) would halve it."


def flat_sentences(found: Sequence[Flat], mechanism: Mechanism) -> list[str]:
    """Return which part of the residuals of touches is smooth over the flat."""
    f, unit = mechanism.units.factor("length"), mechanism.units.length
    return [f"{flat.dataset}: {flat.smooth / f:.2g} {unit} rms of what is left is smooth over the "
            "flat: its own shape, or what the model misses; "
            f"touches scatter {flat.scatter / f:.2g} {unit} about it (p = {flat.p_value:.1g})."
            for flat in found if flat.p_value < SMOOTH]


def flat_entries(found: Sequence[Flat], mechanism: Mechanism) -> list[dict[str, Any]]:
    """Return the same for identification.json, file units."""
    f = mechanism.units.factor("length")
    return [{"dataset": flat.dataset, "smooth": flat.smooth / f, "scatter": flat.scatter / f,
             "degree": flat.degree, "p_value": flat.p_value, "unit": mechanism.units.length}
            for flat in found]


def entry(found: Untold, mechanism: Mechanism) -> dict[str, Any]:
    """Return the same for identification.json, file units."""
    f, scale = mechanism.units.factor("length"), found.scale
    out: dict[str, Any] = {"twins": [
        {"a": t.one, "b": t.other, "correlation": t.correlation, "limb_by_limb": t.each}
        for t in found.twins]}
    if scale is not None:
        out["scale"] = {"distance": scale.length / f, "sigma": _finite(scale.sigma, f),
                        "sigma_data": _finite(scale.alone, f), "open": scale.open,
                        "measure_at_least": _finite(scale.needed, f),
                        "measure_to": CALIPER / f, "unit": mechanism.units.length}
    return out


def _finite(value: float, factor: float) -> float | None:
    return value / factor if np.isfinite(value) else None
