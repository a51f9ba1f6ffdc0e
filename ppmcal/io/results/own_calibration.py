"""Whether an identification.json is of this model, and which measurements were behind it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from ppmcal.errors import PpmcalError
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.knowledge import read_identification, tables_of
from ppmcal.io.results.units import column_factor
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number

APART = 3.0
"""Standard deviations between two readings of one campaign that are not remarkable."""
TURNED = ("direction", "axis")
"""Slots whose identified errors are in the model file's nominal vectors already."""


def of_other_values(record: IdentificationRecord, mechanism: Mechanism) -> str:
    """Return the parameter that the model has elsewhere than an identification.json, in words.

    Empty where all are within 3 standard deviations, or the file does not say.
    """
    worst, words = APART, ""
    for entry in record.parameters:
        if (entry.name not in mechanism.names or entry.value is None or not entry.sigma
                or any(part in TURNED for part in entry.name.split("."))):
            continue
        factor = column_factor(mechanism, entry.name)
        own = float(mechanism.values[mechanism.names.index(entry.name)]) / factor
        apart = abs(own - entry.value) / entry.sigma
        if np.isfinite(apart) and apart > worst:
            unit = f" {entry.unit}" if entry.unit else ""
            worst, words = apart, (f"{entry.name} is {number(entry.value, 9)}{unit} there, "
                                   f"{number(own, 9)}{unit} in the model")
    return words


def seen_before(path: Path, inputs: Mapping[str, str], tables: Iterable[str]) -> list[str]:
    """Return which of ``tables`` an identification.json was fitted to, by their content.

    ``inputs``: SHA-256 of each file by name. Empty where there is no such file to read.
    """
    try:
        known = tables_of(read_identification(path))
    except (PpmcalError, ValueError):
        return []
    return [t for t in tables if inputs.get(t) in known]
