"""How well a calibrated machine predicts measurements that no fit has seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

import numpy as np

from ppmcal.calibration.fit import secondary
from ppmcal.calibration.sessions import DayNoise, with_day_noise
from ppmcal.calibration.validation import FrozenModel, Validated, validated, with_and_without
from ppmcal.commands.inputs import data_files, load, prepared, same_machine
from ppmcal.commands.result import CalibratedMachine, Result
from ppmcal.commands.spec import Machine, Path_
from ppmcal.commands.validate.options import ValidateArguments
from ppmcal.errors import refuse_unknown
from ppmcal.io.results.beside_model import rows_seen, seen_before
from ppmcal.io.results.identification_parts import rows_behind
from ppmcal.io.results.knowledge import KNOWLEDGE, MODELS
from ppmcal.io.results.validation import ValidatedDataset, ValidationRecord
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import REGISTERED
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import number
from ppmcal.wording.progress import start_stage
from ppmcal.wording.told import ShortTable, Told


@dataclass(frozen=True, eq=False, repr=False)
class ValidationResult(Result):
    """How well frozen machines predict measurements.

    Attributes:
        mechanism: the machine, as it was given.
        validated: by data set, errors of the machine, of it without each effect, and of others, SI.
        noise: by data set, what it is judged by and where that is from.
        record: the content of validation.json.
    """

    COMMAND: ClassVar[str] = "validate"
    TABLE: ClassVar[str] = "validation.csv"

    mechanism: Mechanism
    validated: tuple[Validated, ...]
    noise: tuple[DayNoise, ...]
    record: ValidationRecord
    png: bool = False

    def files(self) -> Mapping[str, str | bytes]:
        """Return validation.csv, validation.json and validation.svg, a PNG where wanted."""
        from ppmcal.report.figure_files import validation_files

        return {**self.record.files(), **validation_files(self.record, self.png)}

    def told(self) -> Iterator[Told]:
        """Yield what was fitted of each data set, and how well each machine predicts it."""
        for data in self.record.datasets:
            yield data.basis()
            yield errors_table(data)
            yield data.prediction()

    def headline(self) -> str:
        """Return how well the first data set is predicted."""
        return self.record.datasets[0].model_sentence()


def run(asked: ValidateArguments) -> ValidationResult:
    """Predict measurements with a machine as it is: only the registration is fitted."""
    model, against, seed = asked.model, asked.against, asked.seed
    mechanism = model.mechanism if isinstance(model, CalibratedMachine) else load(model)
    whole = mechanism
    mechanism, datasets = prepared(mechanism, asked.data, "none")
    words = to_register(asked.register)
    models = with_and_without(mechanism)
    notes = list[Note]()
    start_stage("looking at the noise")
    days, noise = with_day_noise([replace(models[n].mechanism, free=whole.free)
                                  for n in sorted({0, len(models) - 1})], datasets, notes)
    start_stage("predicting with and without each effect")
    others, odd = _others(whole, model, against, notes)
    found = validated([*models, *others], days, words, seed, notes)
    inputs = [*mechanism.inputs, *_beside(model, against),
              *(i for o in others for i in o.mechanism.inputs), *data_files(datasets)]
    source = source_of("validate", list(dict.fromkeys(inputs)), seed)
    rivals = {o.label: o.mechanism for o in others if o.label in {str(p) for p in against}}
    seen = secondary("whether a machine was fitted to these measurements", partial(
        _fitted_to, model, rivals, source["inputs"], datasets, whole), [], notes)
    findings = (*odd, *seen,
                *(f for d in datasets for f in d.findings), *notes)
    record = ValidationRecord.of_validation(found, noise, mechanism.name, mechanism.units,
                                            source, findings)
    return ValidationResult(source, record.findings, mechanism, found, tuple(noise), record,
                            asked.png)


def _fitted_to(model: Machine | CalibratedMachine, others: Mapping[str, Mechanism],
               inputs: Mapping[str, str], datasets: Sequence[Dataset], mechanism: Mechanism
               ) -> list[Note]:
    """Return which of the measurements do not test a machine, for it was fitted to them.

    ``others``: further machines by path.
    """
    seen = list[tuple[str, list[tuple[str, str]]]]()
    paths = list[tuple[str, Path, Mechanism]]()
    if isinstance(model, CalibratedMachine):
        seen.append(("the model", rows_seen(datasets, mechanism,
                                            rows_behind(model.identification))))
    elif isinstance(model, str | Path):
        paths.append(("the model", Path(model), mechanism))
    for name, path, machine in [*paths, *((p, Path(p), m) for p, m in others.items())]:
        if (beside := _calibration(path)) is not None:
            seen.append((name, seen_before(beside, inputs, datasets, machine)))
    return [Note(f"{table}: {name} was fitted to {rows}: they do not test it, and its errors "
                 "look smaller than they are; validate on rows that no fit has seen")
            for name, these in seen for table, rows in these]


def _calibration(path: Path) -> Path | None:
    """Return the identification.json of a calibrated machine's file or folder, None of another."""
    if not (path.is_dir() or path.name in MODELS):
        return None
    return (path if path.is_dir() else path.parent) / KNOWLEDGE


def _beside(model: Machine | CalibratedMachine, against: Sequence[Path_]) -> list[str]:
    """Return the calibrations that say to what the machines were fitted: they are read too."""
    paths = [Path(p) for p in (model, *against) if isinstance(p, str | Path)]
    return [str(b) for p in paths if (b := _calibration(p)) is not None and b.is_file()]


def to_register(register: Sequence[str] | str | None) -> tuple[str, ...] | None:
    """Return what the registration is to fit, None for what files and data say."""
    if register is None or not register:
        return None
    words = (register,) if isinstance(register, str) else tuple(register)
    refuse_unknown("part of a registration", words, [*REGISTERED, "none"], "--register")
    return tuple(w for w in words if w != "none")


def _others(mechanism: Mechanism, model: Machine | CalibratedMachine, against: Sequence[Path_],
            notes: list[Note]) -> tuple[list[FrozenModel], list[Note]]:
    """Return the other machines to judge: without effects and fitted again, nominal, as given."""
    out, odd = list[FrozenModel](), list[Note]()
    beside = None if isinstance(model, CalibratedMachine | Mechanism | Mapping) else Path(
        model) / "without_effects.yaml" if Path(model).is_dir() else Path(model).with_name(
            "without_effects.yaml")
    if mechanism.effects and beside is not None and beside.is_file():
        bare = secondary("the machine fitted without effects", partial(load, beside), None, notes)
        out += [FrozenModel("geometry fitted alone", bare)] if bare is not None else []
    if np.any(mechanism.nominals != mechanism.values):
        out.append(FrozenModel("nominal", mechanism.nominal()))
    for path in against:
        other = load(path)
        odd += same_machine(mechanism, other, Path(path))
        out.append(FrozenModel(str(path), other))
    return out, odd


def errors_table(data: ValidatedDataset) -> ShortTable:
    """Return the errors of each machine."""
    unit, closure = data.errors[0].unit, "closure, " * data.alone
    rows = []
    for e in data.errors:
        size = e.size
        apart = [f"{e.closer:+.2g}", f"{e.low:+.2g} to {e.high:+.2g}"] if e.verdict else ["", ""]
        rows.append([e.model, "" if size is None else number(size.rms), *apart, e.verdict])
    heads = ["machine", f"{closure}{unit} rms", f"better by, {unit}", f"95 %, {unit}", ""]
    return ShortTable(heads, rows, (1, 2, 3))
