"""Files that were read wrongly, as check, identify and diagnose write them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.calibration.interpretation import Interpretation
from ppmcal.io.results.parts import ErrorChange
from ppmcal.io.results.record import Part, Text, Whole
from ppmcal.units import Units

FORMAT = "ppmcal/misread/1"


class MisreadingEntry(Part):
    """One mistake in one file.

    ``read``: the sidecar's block that corrects all mistakes of that file; null where only the user
    can; ``sigma``: entries of its ``instrument.sigma`` that belong to that, in its units;
    ``headers``: of the file -> those to write in their place, where the unit stands in them.
    ``rows``: where not all; ``residual``: half of the rows miss by more, of the
    nominal machine at its best registration.
    """

    file: Text = ""
    kind: Text = ""
    columns: tuple[Text, ...] = ()
    rows: tuple[Whole, ...] | None = None
    read: Mapping[str, Any] | None = None
    residual: ErrorChange | None = None
    text: Text = ""
    sigma: Mapping[str, float] | None = None
    headers: Mapping[str, str] | None = None


def misreading_entries(found: Sequence[Interpretation], units: Units) -> tuple[MisreadingEntry,
                                                                               ...]:
    """Return one entry for each mistake, file units."""
    out = []
    for one in found:
        miss = ErrorChange.filled(None, units, before=one.before, after=one.after,
                                  unit=one.quantity)
        known = np.isfinite(one.after)
        out += [MisreadingEntry.filled(
            m, file=one.source, rows=m.rows or None, read=one.block,
            residual=miss if known else None, text=m.text + one.otherwise * (m is one.mistakes[-1]),
            sigma=dict(one.sigma) or None, headers=dict(one.headers) or None)
            for m in one.mistakes]
    return tuple(out)
