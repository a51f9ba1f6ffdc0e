"""Numbers of a diagnosis as people like to read them: units, powers of ten, odds."""

from __future__ import annotations

import math

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect
from ppmcal.report.format import count, number, sig, to_sigma, whole, with_unit
from ppmcal.wording import rate

INPUTS = {
    "direction": "direction of approach (+: joint increasing)", "load": "load on the joint",
    "wound load": "load on the joint, its sign that of the approach",
    "temperature": "temperature", "time": "time since the first row", "velocity": "joint velocity",
    "last move": "move from the row before",
    "travel": "joint position", "phase": "joint position within one period",
    "wrench": "load on the platform", "pose": "platform", "point": "measured",
}
"""Names of inputs in diagnosis.json -> words."""
_FINER = {"m": ((1e-4, 1e6, "µm"), (0.1, 1e3, "mm")), "mm": ((0.1, 1e3, "µm"),),
          "deg": ((0.1, 3600.0, "arcsec"),), "rad": ((1e-4, 1e6, "µrad"), (0.1, 1e3, "mrad")),
          "s": ()}
_NAMES = {"deg C": "°C", "um": "µm"}


def left_out(record: DiagnosisRecord) -> str:
    """Return that rows are plotted which the fit has left out, empty where none are."""
    n = record.plot_data.left_out_rows
    return f"With {count(n, 'row')} that the fit took for outliers." if n else ""


def finer(unit: str, largest: float) -> tuple[float, str]:
    """Return factor and name of the unit in which a number of that size is easy to read."""
    for limit, factor, name in _FINER.get(unit, ()):
        if largest < limit:
            return factor, name
    if unit == "s" and largest > 7200.0:
        return 1.0 / 3600.0, "h"
    if unit == "s" and largest > 600.0:
        return 1.0 / 60.0, "min"
    return 1.0, _NAMES.get(unit, unit)


def power(log10: float) -> str:
    """Return a power of ten."""
    return "10" + str(round(log10)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def odds_to(odds: float) -> str:
    """Return the first of odds to one: ``2.8``, ``48 000``, ``> 10⁶``."""
    if odds >= 1e6:
        return "> 10⁶"
    return sig(odds, 2) if odds < 100.0 else whole(int(float(f"{odds:.1e}")))


def amounts(effect: DiagnosedEffect) -> list[tuple[str, str]]:
    """Return (parameter, value with its 95 % interval and unit) of a named effect.

    Behind the parameters come the figures that follow from them, ``phase at mid-stroke`` say.
    """
    out = []
    derived = {n.replace("_mid_stroke", " at mid-stroke"): v for n, v in effect.derived.items()}
    for name, v in {**effect.parameters, **derived}.items():
        value, half = number(v.value), number(v.half)
        if value is None:
            continue
        factor, unit = rate(v.unit, value)
        value, half = value * factor, None if half is None else half * factor
        text = sig(value, 4) if half is None or half <= 0.0 else _interval(value, half)
        out.append((name, f"{text} {_plain_unit(unit)}".rstrip()))
    return out


def _interval(value: float, half: float) -> str:
    """Return ``0.0303 ± 0.0013``, with a common power of ten where numbers are tiny."""
    if 0.0 < max(abs(value), half) < 1e-3:
        exponent = -6 if max(abs(value), half) >= 1e-7 else -9
        scale = 10.0**-exponent
        return (f"({to_sigma(value * scale, half * scale)} ± {sig(half * scale, 2)})"
                f"·{power(exponent)}")
    if max(abs(value), half) >= 1e5:
        return f"{sig(value, 4)} ± {sig(half, 2)}"
    if half >= 100.0:  # no more digits than the interval deserves
        ten = 10.0 ** (math.floor(math.log10(half)) - 1)
        value, half = round(value / ten) * ten, round(half / ten) * ten
    return f"{to_sigma(value, half)} ± {sig(half, 2)}"


def _plain_unit(unit: str) -> str:
    return _NAMES.get(unit, unit) if unit else "(no unit)"


def in_unit(value: float | None, unit: str) -> str:
    """Return a number with its unit in plain letters."""
    return with_unit(value, _NAMES.get(unit, unit))
