"""The table of what is too large, from the limits themselves."""

from __future__ import annotations

from collections.abc import Sequence

from generators.markdown import table
from ppmcal.limits import ASKED_LIMITS, FILE_LIMITS, Limit, grouped


def limits_table() -> str:
    """Return the limits of files and of what is asked for, as a table each."""
    return "\n\n".join(
        table(("At most", "of", "in"), [_row(limit) for limit in limits]).strip()
        for limits in (FILE_LIMITS, ASKED_LIMITS))


def _row(limit: Limit) -> Sequence[str]:
    return grouped(limit.most), limit.what, limit.where
