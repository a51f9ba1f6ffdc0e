"""Whether an identification.json is of this model, and which measurements were behind it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ppmcal.calibration.interpretation import count_among
from ppmcal.errors import PpmcalError
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.knowledge import KNOWLEDGE, known_in, read_identification, tables_of
from ppmcal.io.results.units import column_factor
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.same_rows import KnownRows
from ppmcal.wording import number

ALL = "these measurements"
APART = 3.0
"""Standard deviations between two readings of one campaign that are not remarkable."""
TURNED = ("direction", "axis")
"""Slots whose identified errors are in the model file's nominal vectors already."""


def calibration_of(mechanism: Mechanism) -> tuple[IdentificationRecord, Path, str] | None:
    """Return the identification.json beside a machine's file, and its path.

    And what :func:`of_other_values` says of it. None where none lies there, or the machine is in
    memory.

    Raises:
        BadInput: it cannot be read.
    """
    path = Path(mechanism.source).with_name(KNOWLEDGE)
    if mechanism.source not in mechanism.inputs or not path.is_file():
        return None
    record = read_identification(path)
    return record, path, of_other_values(record, mechanism)


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


def seen_before(path: Path, inputs: Mapping[str, str], datasets: Sequence[Dataset],
                mechanism: Mechanism) -> list[tuple[str, str]]:
    """Return to which of ``datasets`` an identification.json was fitted: name, and how far.

    By the file's content (``inputs``: SHA-256 by name), or row by row, within their digits. Empty
    where there is no such file to read.
    """
    try:
        record = read_identification(path)
        tables, known = tables_of(record), known_in(record, mechanism)
    except (PpmcalError, ValueError):
        return []
    whole = [d for d in datasets if inputs.get(d.source) in tables]
    rest = [d for d in datasets if d not in whole]
    return [(d.source, ALL) for d in whole] + rows_seen(rest, mechanism, known)


def rows_seen(datasets: Sequence[Dataset], mechanism: Mechanism, known: Sequence[KnownRows]
              ) -> list[tuple[str, str]]:
    """Return which data sets have known rows, within their digits: name, and how many."""
    out = []
    for data in datasets:
        count, more = count_among(data, mechanism.actuators, known)
        if count:
            least = "at least " if more else ""
            out.append((data.source, ALL if count == len(data) else
                        f"{least}{count} of these {len(data)} rows"))
    return out
