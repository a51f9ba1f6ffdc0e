"""What a printer was before its calibration: the error of the machine that an import writes."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.validation import DEFINITION, before
from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.column_names import LABELS
from ppmcal.io.dataset_reader import dataset_of
from ppmcal.io.frames import as_table
from ppmcal.io.results.identification_parts import summaries
from ppmcal.io.sidecar import sidecar_of
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import number


def printer_before(texts: Mapping[str, str]) -> dict[str, object]:
    """Return the errors of machine.yaml on the touches beside it, as `identify` says ``before``.

    Args:
        texts: the files that an import writes, by name.

    Returns:
        ``definition``, and by data set ``rms``, ``p95`` ... and ``unit``; empty without touches, or
        where the machine reaches none of them.
    """
    try:
        mechanism = read_mechanism(yaml.safe_load(texts["machine.yaml"]))
        sets = tuple(_datasets(texts, mechanism))
        if not sets:
            return {}
        errors = before(Problem(mechanism, sets, ()),
                        [np.ones(len(d), dtype=bool) for d in sets]).residuals
    except PpmcalError:
        return {}    # what is wrong with them identify says, with the place in its file
    out: dict[str, object] = {}
    for i, data in enumerate(sets):
        rows = [np.full(len(d), i == j) for j, d in enumerate(sets)]
        found = summaries(errors.figures(rows), mechanism.units).get("position")
        if found is not None:
            out[data.name] = found.entries(whole=True)
    return {"definition": DEFINITION, **out} if out else {}


def before_sentence(found: Mapping[str, object]) -> str:
    """Return what the errors were before, empty where they are not known."""
    parts = [f"{number(size['rms'])} {size['unit']} rms on {name}" for name, size in found.items()
             if isinstance(size, dict)]
    return f"Before: {', '.join(parts)}. \"Before\" is {found['definition']}." if parts else ""


def _datasets(texts: Mapping[str, str], mechanism: Mechanism) -> Iterator[Dataset]:
    for name, text in texts.items():
        if not name.endswith(".csv"):
            continue
        stem = name.removesuffix(".csv")
        header, *rows = csv.reader(text.splitlines())
        yield touches(mechanism, stem, header, np.array(rows, dtype=float),
                      yaml.safe_load(texts[f"{stem}.yaml"]))


def touches(mechanism: Mechanism, name: str, header: Sequence[str], rows: Array,
            sidecar: Mapping[str, Any]) -> Dataset:
    """Return the data set of rows (N, columns) with a header and a sidecar's content."""
    columns = dict(zip(header, rows.T, strict=True))
    return dataset_of(as_table(columns, (), name, LABELS.__contains__),
                      sidecar_of(sidecar, mechanism), name, mechanism)
