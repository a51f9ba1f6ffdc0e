"""Words and numbers as a page's figures hold them."""

from __future__ import annotations

from html import escape
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from ppmcal.plotting.style import plain

Spec: TypeAlias = dict[str, Any]
DIGITS = 6
TOOLS = 20
"""Room for plotly's buttons above a plot, pixels."""


def safe(text: object) -> str:
    """Return words that plotly shows as they are: neither tags nor placeholders."""
    return escape(plain(text), quote=False).replace("{", "&#123;")


def lines(text: str) -> str:
    """Return words in lines, the first one bold."""
    first, *more = (safe(t) for t in text.split("\n"))
    return "<br>".join([f"<b>{first}</b>", *more])


def number(value: float) -> float | None:
    """Return a number with as many digits as can be seen, None for none."""
    return float(f"{value:.{DIGITS}g}") if np.isfinite(value) else None


def numbers(values: ArrayLike) -> list[float | None]:
    """Return numbers with as many digits as can be seen."""
    return [number(v) for v in np.ravel(np.asarray(values, dtype=float)).tolist()]
