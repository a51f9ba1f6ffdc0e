"""A diagnosis in plain words: what, where, how much, in units that are easy to read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from ppmcal.model.effects import GEOMETRY
from ppmcal.report.format import count, listed, number, sig, to_sigma, whole, with_unit
from ppmcal.wording import shorter, where

VERDICTS = {
    "none": "Nothing is missing that these data could show.",
    "weak": "Something may be missing, but it is too weak to be named.",
    "named": "The missing effect is named.",
    "named-set": "Something is missing; these data cannot tell a few effects apart.",
    "partial": "Part of what is missing is named; something else is left.",
    "unnamed": "Something is missing that ppmcal does not know.",
}
INPUTS = {
    "direction": "direction of approach (+: joint increasing)", "load": "load on the joint",
    "wound load": "load on the joint, its sign that of the approach",
    "temperature": "temperature", "time": "time since the first row", "velocity": "joint velocity",
    "travel": "joint position", "phase": "joint position within one period",
    "wrench": "load on the platform", "pose": "platform", "point": "measured",
}
"""Names of inputs in diagnosis.json -> words."""
_FINER = {"m": ((1e-4, 1e6, "µm"), (0.1, 1e3, "mm")), "mm": ((0.1, 1e3, "µm"),),
          "deg": ((0.1, 3600.0, "arcsec"),), "rad": ((1e-4, 1e6, "µrad"), (0.1, 1e3, "mrad")),
          "s": ()}
_NAMES = {"deg C": "°C", "um": "µm"}


def verdict_of(record: Mapping[str, Any]) -> str:
    """Return the verdict as a sentence."""
    verdict = str(record.get("verdict") or "")
    return VERDICTS.get(verdict, f"Verdict: {verdict}." if verdict else "")


def headline(record: Mapping[str, Any]) -> str:
    """Return the verdict and what was named."""
    effects = together(record)
    names = "; ".join(effect_name(record, e) for e in effects)
    text = verdict_of(record)
    if not names:
        return text
    if text == VERDICTS["named"]:
        several = len(effects) > 1
        return f"The missing {'effects are' if several else 'effect is'} named: {names}."
    if text == VERDICTS["named-set"]:
        return f"{text.removesuffix('.')}: {'; '.join(_with_rivals(record))}."
    return f"{text} Named: {names}."


def _with_rivals(record: Mapping[str, Any]) -> list[str]:
    """Return each effect with its alternatives: ``tilt or gain on all 3 actuators``."""
    return [" or ".join([effect_name(record, e), *rivals(record, e)])
            for e in together(record)]


def together(record: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the named effects, those of one kind and with the same alternatives as one."""
    out: dict[tuple[Any, ...], dict[str, Any]] = {}
    for e in record.get("effects") or []:
        own = list(e.get("parameters") or {}) if e.get("kind") == GEOMETRY else []
        key = (e.get("kind"), *own, "|", *map(str, e.get("alternatives_on") or []))
        if key in out:
            on = [*(out[key].get("on") or []), *(e.get("on") or [])]
            out[key] |= {"on": list(dict.fromkeys(on))}
        else:
            out[key] = dict(e)
    return list(out.values())


def rivals(record: Mapping[str, Any], effect: Mapping[str, Any]) -> list[str]:
    """Return the names of an effect's alternatives."""
    names = effect.get("alternatives_on") or effect.get("alternatives") or []
    return [shorter(str(n), actuators(record)) for n in names]


def story(record: Mapping[str, Any], part: str) -> list[Mapping[str, Any]]:
    """Return one list of the story, [] where there is none."""
    found = record.get("story")
    return [e for e in (found or {}).get(part) or [] if isinstance(e, Mapping)]


def left_out(record: Mapping[str, Any]) -> str:
    """Return that rows are drawn which the fit has left out, empty where none are."""
    n = number((record.get("story") or {}).get("left_out_rows"))
    return f"With {count(int(n), 'row')} that the fit took for outliers." if n else ""


def actuators(record: Mapping[str, Any]) -> int:
    """Return the number of actuators, 0 where the record does not say."""
    story = record.get("story")
    return len((story or {}).get("actuators") or [])


def effect_name(record: Mapping[str, Any], entry: Mapping[str, Any]) -> str:
    """Return ``backlash on leg2, leg5``."""
    place = where(entry.get("on") or [], actuators(record))
    kind = str(entry.get("kind") or "?")
    own = list(entry.get("parameters") or {}) if kind == GEOMETRY else []
    kind = " ".join([kind, *own])
    return f"{kind} on {place}" if place else kind


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


def chance(log10_p: Any) -> str:
    """Return ``p = 0.03`` or ``p = 10⁻¹³¹``."""
    x = number(log10_p)
    if x is None:
        return "p unknown"
    return f"p = {sig(10.0**x, 2)}" if x > -3.0 else f"p = {power(x)}"


def scientific(p: float) -> str:
    """Return ``0.012`` or ``8.5·10⁻⁵``."""
    if p >= 1e-3:
        return sig(p, 2)
    head, _, exponent = f"{p:.1e}".partition("e")
    return f"{head}·{power(float(exponent))}"


def power(log10: float) -> str:
    """Return a power of ten."""
    return "10" + str(round(log10)).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def odds_to(odds: float) -> str:
    """Return the first of odds to one: ``2.8``, ``48 000``, ``> 10⁶``."""
    if odds >= 1e6:
        return "> 10⁶"
    return sig(odds, 2) if odds < 100.0 else whole(int(float(f"{odds:.1e}")))


def amounts(entry: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return (parameter, value with its 95 % interval and unit) of a named effect.

    Behind the parameters come the figures that follow from them, ``phase at mid-stroke`` say.
    """
    out = []
    derived = {str(n).replace("_mid_stroke", " at mid-stroke"): v
               for n, v in (entry.get("derived") or {}).items()}
    for name, v in ((entry.get("parameters") or {}) | derived).items():
        if not isinstance(v, Mapping) or number(v.get("value")) is None:
            continue
        sigma, unit = number(v.get("sigma")), _plain_unit(str(v.get("unit") or ""))
        text = sig(v.get("value"), 4) if sigma is None or sigma <= 0.0 else (
            _interval(float(v["value"]), 1.96 * sigma))
        out.append((str(name), f"{text} {unit}".rstrip()))
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


def gap_closed(record: Mapping[str, Any]) -> str:
    """Return how much of the gap is closed on held-out poses, empty if unknown."""
    gap = record.get("gap") or {}
    before, after = number(gap.get("before")), number(gap.get("after"))
    if before is None or after is None:
        return ""
    poses = number(gap.get("poses"))
    which = f"On {poses:.0f} poses that no fit has seen" if poses else "On held-out poses"
    closed, ends = number(gap.get("closed")), [number(v) for v in gap.get("interval") or []]
    if not record.get("effects") and abs(before - after) < 1e-9:
        return f"{which} the residuals are {sig(before)} times the noise."
    text = f"{which} the residuals go from {sig(before)} to {sig(after)} times the noise"
    if closed is None:
        return f"{text}; nothing exceeded the noise before."
    text += f": {closed:.0%} of what exceeds the noise is gone"
    if len(ends) == 2 and ends[0] is not None and ends[1] is not None:
        text += f" (95 % interval: {ends[0]:.0%} to {ends[1]:.0%})"
    return (text + "." + _worst_block(gap)).replace("%", " %").replace("  %", " %")


def _worst_block(gap: Mapping[str, Any]) -> str:
    """Return how much is closed on the stretch or condition left out that closes least."""
    blocks = [(closed, b) for b in gap.get("blocks") or []
              if (closed := number(b.get("closed"))) is not None]
    if not blocks:
        return ""
    closed, worst = min(blocks, key=lambda pair: pair[0])
    by = listed([str(b.get("by")) for _, b in blocks])
    ends = [number(v) for v in worst.get("interval") or []]
    interval = (f" (95 % interval: {ends[0]:.0%} to {ends[1]:.0%})"
                if len(ends) == 2 and ends[0] is not None and ends[1] is not None else "")
    return (f" With a third of the rows left out at a time, by {by}, at the least {closed:.0%} is "
            f"gone, by {worst.get('by')}{interval}.")


def in_unit(value: Any, unit: str) -> str:
    """Return a number with its unit in plain letters."""
    return with_unit(value, _NAMES.get(unit, unit))
