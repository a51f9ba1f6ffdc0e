"""The other readings of the measurements that `diagnose` wrote beside model.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

from ppmcal.calibration.compensation import CandidateModel, Readings, probabilities
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.results.record import Finite, Part, Record, Shown, Text
from ppmcal.model.mechanism import Mechanism


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
