"""Numbers as text: sensible digits, units, probabilities, counts."""

from __future__ import annotations

import math
import re
from typing import Any

from ppmcal.io.results.tables import finite_number

NBSP = "\u00a0"
_SUPER = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


number = finite_number


def sig(value: Any, digits: int = 3) -> str:
    """Return a number with some significant digits: ``0.0123``, ``1.2·10⁻⁷``, ``–`` for none."""
    x = number(value)
    if x is None:
        return "–"
    if x == 0.0:
        return "0"
    power = math.floor(math.log10(abs(float(f"{x:.{digits - 1}e}"))))
    if -5 <= power < 7:
        return f"{x:.{max(digits - 1 - power, 0)}f}".replace("-", "−")
    mantissa, exponent = f"{x:.{digits - 1}e}".split("e")
    return f"{mantissa.replace('-', '−')}·10{str(int(exponent)).translate(_SUPER)}"


def to_sigma(value: Any, sigma: Any) -> str:
    """Return a number with as many decimals as its sigma has at two digits."""
    x, s = number(value), number(sigma)
    if x is None or s is None or not s > 0.0:
        return sig(x, 5)
    decimals = 1 - math.floor(math.log10(s))
    if decimals > 9:
        return sig(x, 6)
    text = f"{x:.{max(decimals, 0)}f}".replace("-", "−")
    return text.removeprefix("−") if not text.strip("−0.") else text


def exact(value: Any) -> str:
    """Return a given number as it was given, to ten digits."""
    x = number(value)
    return "–" if x is None else f"{x:.10g}".replace("-", "−")


def with_unit(value: Any, unit: str, digits: int = 3) -> str:
    """Return ``0.0123 mm``."""
    text = sig(value, digits)
    return f"{text}{NBSP}{unit}" if unit and text != "–" else text


def with_label(name: str, unit: str) -> str:
    """Return ``x (mm)``."""
    return f"{name} ({unit})" if unit else name


def probability(p: Any) -> str:
    """Return ``p = 0.4`` or ``p < 0.001``."""
    x = number(p)
    if x is None:
        return ""
    if x < 1e-3:
        power = math.floor(math.log10(x)) + 1 if x > 0.0 else -300
        return f"p{NBSP}<{NBSP}0.001" if power >= -3 else (
            f"p{NBSP}<{NBSP}10{str(max(power, -300)).translate(_SUPER)}")
    return f"p{NBSP}={NBSP}{min(x, 1.0):.2g}"


def count(n: int, one: str, many: str = "") -> str:
    """Return ``1 row`` or ``12 rows``."""
    return f"{whole(n)} {one if n == 1 else many or one + 's'}"


def whole(n: int) -> str:
    """Return a whole number with thin spaces between its thousands."""
    return f"{n:,}".replace(",", "\u2009")


def typeset(text: str) -> str:
    """Return a sentence of the console as the page writes it: ±, ×, −, χ², powers of ten."""
    text = re.sub(r"(\d)e([-+]\d+)", lambda m: f"{m[1]}·10{str(int(m[2])).translate(_SUPER)}", text)
    text = re.sub(r"(\d)\*", r"\1 × ", text)
    text = re.sub(r"(^| )-(?= |\d)", r"\1−", text)
    return text.replace("+- ", "± ").replace("chi-squared", "χ²")
