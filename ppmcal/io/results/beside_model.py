"""What lies beside a model file: the calibration it is from, and other readings of its data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ppmcal.calibration.compensation import CandidateModel, Readings, probabilities
from ppmcal.calibration.interpretation import count_among
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.io import read_mechanism
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.knowledge import KNOWLEDGE, known_in, read_identification, tables_of
from ppmcal.io.results.record import Finite, Part, Record, Shown, Text
from ppmcal.io.results.units import column_factor
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.same_rows import KnownRows
from ppmcal.wording import number

if TYPE_CHECKING:       # few of those who ask for a model's calibration had it diagnosed
    from ppmcal.diagnosis.result import Diagnosis

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


# ---- the other readings that `diagnose` wrote beside model.yaml


class OtherModel(Part):
    """A model of the same measurements in a file of its own.

    ``effect`` stands in it for ``instead_of``; one of them is empty where it has only less or
    more, both for the model without effects. ``odds`` of the diagnosed model against it.
    """

    file: Text = ""
    effect: Text = ""
    instead_of: Text = ""
    odds: Finite | None = None

    @classmethod
    def of(cls, file: str, reading: CandidateModel) -> OtherModel:
        """Return the entry of a reading that is written to ``file``."""
        return cls.filled(reading, file=file, instead_of=reading.instead)


class TriedSet(Part):
    """A set of effects, its probability over all sets that were tried, and the model's file."""

    effects: tuple[Text, ...] = ()
    probability: Shown | None = None
    file: Text = ""

    @classmethod
    def each(cls, result: Diagnosis) -> tuple[TriedSet, ...]:
        """Return the named set and then the others; nothing where there are none."""
        others = [(file, r) for file, r in other_files(result) if not r.bare]
        if not others:
            return ()
        shares = probabilities([r for _, r in others])
        named = tuple(h.label for h in result.found.last.named)
        sets = [("model.yaml", named), *((f, r.effects) for f, r in others)]
        return tuple(cls(effects=effects, probability=p, file=file)
                     for (file, effects), p in zip(sets, shares, strict=True))


class OtherModels(Record):
    """The part of diagnosis.json that a compensation needs."""

    FILE: ClassVar[str] = "diagnosis.json"
    FORMAT: ClassVar[str] = "ppmcal/diagnosis/2"
    EARLIER: ClassVar[tuple[str, ...]] = ("ppmcal/diagnosis/1",)

    other_models: tuple[OtherModel, ...] = ()


def other_files(result: Diagnosis) -> list[tuple[str, CandidateModel]]:
    """Return the other models with the names of their files."""
    return [("without_effects.yaml" if other.bare else f"rival{n}.yaml", other)
            for n, other in enumerate(result.others, 1)]


def read_other_models(model: Path, mechanism: Mechanism) -> tuple[Readings, list[str]]:
    """Return the other readings of the measurements behind a model, and the files they are in.

    Args:
        model: path of the model file; only a ``model.yaml`` beside a diagnosis.json has any.
        mechanism: the model.

    Raises:
        BadInput: the record or a file that it names cannot be read, or is of another machine.
    """
    path = model.with_name(OtherModels.FILE)
    if model.name != "model.yaml" or not path.exists():
        return Readings((), None), []
    others, without, read = [], None, [str(path)]
    for entry in OtherModels.read(path).other_models:
        file, other = _read(model, entry, mechanism, path)
        read.append(file)
        if entry.effect or entry.instead_of:
            odds = max(entry.odds or 1.0, 1e-3)
            others.append(CandidateModel(entry.effect, entry.instead_of, odds, other))
        else:
            without = other
    return Readings(tuple(others), without), read


def _read(model: Path, entry: OtherModel, mechanism: Mechanism, path: Path
          ) -> tuple[str, Mechanism]:
    name = entry.file
    if not name or Path(name).name != name:
        raise BadInput(f"names '{name}', which is not a file beside it", f"{path}: other_models",
                       "Run diagnose again")
    file = model.with_name(name)
    other = read_mechanism(file)
    if [limb.name for limb in other.limbs] != [limb.name for limb in mechanism.limbs]:
        raise BadInput(f"is of another machine than {model}", str(file), "Run diagnose again")
    return str(file), other
