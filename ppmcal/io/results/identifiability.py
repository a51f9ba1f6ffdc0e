"""What the data do not tell, in words and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ppmcal.calibration.flatness import Flat
from ppmcal.calibration.identifiability import CALIPER, Identifiability
from ppmcal.io.results import identifiability_wording as told
from ppmcal.model.mechanism import Mechanism


def sentences(found: Identifiability, mechanism: Mechanism) -> list[str]:
    """Return what a person should know before believing every digit, a sentence or two each."""
    all_ = entry(found, mechanism)
    out = [told.scale(all_["scale"])] if found.scale is not None and found.scale.open else []
    return out + [told.twins(t) for t in all_["twins"]]


def flat_sentences(found: Sequence[Flat], mechanism: Mechanism) -> list[str]:
    """Return which part of the residuals of touches is smooth over the flat."""
    return [told.flat(e) for e in flat_entries(found, mechanism) if e["p_value"] < told.SMOOTH]


def flat_entries(found: Sequence[Flat], mechanism: Mechanism) -> list[dict[str, Any]]:
    """Return the same for identification.json, file units."""
    f = mechanism.units.factor("length")
    return [{"dataset": flat.dataset, "smooth": flat.smooth / f, "scatter": flat.scatter / f,
             "degree": flat.degree, "p_value": flat.p_value, "unit": mechanism.units.length}
            for flat in found]


def entry(found: Identifiability, mechanism: Mechanism) -> dict[str, Any]:
    """Return the same for identification.json, file units."""
    f, scale = mechanism.units.factor("length"), found.scale
    out: dict[str, Any] = {"twins": [
        {"a": t.one, "b": t.other, "correlation": t.correlation, "limb_by_limb": t.each}
        for t in found.twins]}
    if scale is not None:
        out["scale"] = {"distance": scale.length / f, "sigma": _finite(scale.sigma, f),
                        "sigma_data": _finite(scale.alone, f), "open": scale.open,
                        "held": scale.held,
                        "measure_at_least": _finite(scale.needed, f),
                        "measure_to": CALIPER / f, "unit": mechanism.units.length}
    return out


def _finite(value: float, factor: float) -> float | None:
    return value / factor if np.isfinite(value) else None
