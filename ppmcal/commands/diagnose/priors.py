"""The numbers that decide what is in the data, for the console."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from ppmcal.inference.priors import CORRELATIONS, table

WIDTH = 74


def lines() -> Iterator[str]:
    """Yield each number with its reason below it."""
    several = ", ".join(f"{c:g}" for c in CORRELATIONS)
    for name, value, reason in (
            *((name, f"{p.value:.4g}", p.reason) for name, p in table().items()),
            ("correlations", several, "noise from row to row may have, each as often")):
        yield f"{name.lower().replace('_', ' ')}: {value}"
        yield textwrap.indent(textwrap.fill(reason, WIDTH), "    ")
