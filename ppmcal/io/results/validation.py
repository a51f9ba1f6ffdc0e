"""How frozen machines predict other measurements: validation.csv, validation.json, the words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import field
from typing import Annotated, Any, ClassVar

from ppmcal.calibration.sessions import REPEATS, STATED, DayNoise, UnlikeRow
from ppmcal.calibration.validation import ModelError, Validated
from ppmcal.codec import unsaid
from ppmcal.io import csv_text
from ppmcal.io.results.parts import ErrorSize
from ppmcal.io.results.record import Finite, Part, Record, Text, Whole
from ppmcal.model.measured import MISSED
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Length, OfUnit, Units
from ppmcal.wording import abbreviate_list, number

OPENED = {"frame": "the frame", "target": "the target", "rotation": "the body's rotation",
          "homing": "the joints' zeros", "offset": "the encoder's offset"}


ONE_ROW, FEW = 0.8, 5
"""A miss that is for so large a part of its mean square that of one row, of so many at least,
tells of that row and not of the machine."""
WITHOUT = "without "
"""The name of a model that lacks an effect begins so; the effect's name follows."""
SHOWN = 3
"""Rows that a finding names; the others are counted."""
SIZES = ("rms", "rms_low", "rms_high", "p95", "p95_low", "p95_high", "max")
"""Figures of an error, and the ends of their 95 % intervals."""


def _size(found: Mapping[str, float], units: Units, quantity: str) -> ErrorSize | None:
    """Return a size in file units, None where nothing of the kind was measured."""
    return ErrorSize.filled(None, units, **{k: found[k] for k in SIZES},
                            unit=quantity) if found else None


class PredictedError(Part):
    """What one machine misses; ``closer``: by how much less than the model, with 95 % interval.

    ``closure``: of joint values alone, how far limbs are from closing, rms over the limbs of a row;
    ``limbs``: rms of each. ``noise``: rms over the data set's noise, bare. ``verdict``: better,
    worse or same.
    """

    model: Text = ""
    position: ErrorSize | None = None
    rotation: ErrorSize | None = None
    noise: Finite | None = None
    closer: OfUnit[Finite | None] = None
    low: OfUnit[Finite | None] = None
    high: OfUnit[Finite | None] = None
    unit: Text = ""
    verdict: Text = ""
    closure: ErrorSize | None = None
    limbs: Length[Mapping[Text, Finite]] = field(default_factory=dict)

    @property
    def size(self) -> ErrorSize | None:
        """The figures by which machines are compared."""
        return self.position or self.rotation or self.closure

    @classmethod
    def of(cls, found: ModelError, units: Units, first: bool) -> PredictedError:
        """Return an error in file units; ``first``: others are held against this one."""
        low, high = found.interval
        verdict = "" if first else {1: "better", 0: "same", -1: "worse"}[found.sure]
        closure = _size(found.closure, units, "length")
        alone: dict[str, Any] = {} if closure is None else {"closure": closure,
                                                            "limbs": found.limbs}
        known = {f: getattr(found, f) for f in ("noise", "closer")}
        return cls.filled(
            None, units, **known, model=found.label, verdict=verdict, low=low, high=high,
            position=_size(found.position, units, "length"),
            rotation=_size(found.rotation, units, "angle"),
            unit="length" if found.position or found.closure else "angle", **alone)


class ValidatedDataset(Part):
    """One data set; ``fitted``: what of the registration, ``demanded`` by the data alone.

    ``elsewhere``: so many rows were measured in another assembly mode than home's; ``unlike``:
    rows that a fit of these alone leaves out, which count here; ``left_out``: rows typed wrong,
    which count nowhere. ``noise``: of one typical value, that it is ``judged_by``: stated,
    residuals or repeats; ``stated``: by its file; ``factor``: over that, bare.
    """

    name: Text = ""
    source: Text = ""
    rows: Whole = 0
    of_rows: Whole = 0
    fitted: tuple[Text, ...] = ()
    demanded: tuple[Text, ...] = ()
    noise: Annotated[Finite | None, Key("noise.value")] = None
    stated: Annotated[Finite | None, Key("noise.stated")] = None
    unit: Annotated[Text, Key("noise.unit")] = ""
    factor: Annotated[Finite | None, Key("noise.factor", whole=True)] = None
    judged_by: Annotated[Text, Key("noise.source")] = ""
    errors: tuple[PredictedError, ...] = ()
    elsewhere: Whole = 0
    unlike: tuple[UnlikeRow, ...] = ()
    left_out: tuple[Whole, ...] = ()

    @property
    def alone(self) -> bool:
        """Whether these are joint values alone."""
        return any(e.closure for e in self.errors)

    @classmethod
    def of(cls, found: Validated, units: Units, noise: DayNoise | None = None
           ) -> ValidatedDataset:
        """Return a data set in file units."""
        used: dict[str, Any] = {"elsewhere": found.elsewhere} if found.elsewhere else {}
        if noise is None:
            used |= {"factor": None}
        else:
            size = noise.sigma / units.factor(noise.quantity)
            used |= {"noise": size, "stated": size / noise.factor, "factor": noise.factor,
                     "unit": units.name(noise.quantity), "judged_by": noise.source}
        return cls(name=found.name, source=found.source, rows=found.rows[0], of_rows=found.rows[1],
                   fitted=found.fitted, demanded=found.demanded, **used,
                   errors=tuple(PredictedError.of(e, units, n == 0)
                                for n, e in enumerate(found.errors)),
                   unlike=tuple(r for r in (noise.unlike if noise else ())
                                if r.row not in found.left_out),
                   left_out=found.left_out)

    def basis(self) -> str:
        """Return which rows these are, what was fitted of them, and their noise."""
        return f"{self.registered_sentence()} {self._noise_words()}".strip()

    def prediction(self) -> str:
        """Return how well the model predicts a data set, and what its effects are worth there."""
        return f"{self.model_sentence()} {self.effects_sentence()}".strip()

    def model_sentence(self) -> str:
        """Return how well the model predicts a data set.

        Rows of another assembly mode are not residuals, nor is their error the model's.
        """
        first = self.errors[0] if self.errors else PredictedError()
        sizes = [_with_interval(s) for s in (first.position, first.rotation)
                 if s and s.rms is not None]
        if self.elsewhere:
            return (f"{self.name}: {self.elsewhere} of {self.rows} rows were measured in another "
                    "assembly mode than home's, the other way the limbs close at the same joint "
                    f"values: {' and '.join(sizes)} is how far apart these are, no error of the "
                    "model.")
        times = "" if first.noise is None or self.factor is None else (
            f", {number(first.noise, 2)} times the noise")
        if first.closure:
            limbs = ", ".join(f"{name} {number(size)}" for name, size in first.limbs.items()
                              if size is not None)
            return (f"{self.name}: limbs are {_with_interval(first.closure)} from closing{times}; "
                    f"{limbs} {first.closure.unit} by limb.")
        return f"{self.name}: the model misses by {' and '.join(sizes)}{times}."

    def effects_sentence(self) -> str:
        """Return what the effects are worth there, empty where there is none."""
        parts: dict[str, list[str]] = {"worse": [], "better": [], "same": []}
        for e in self.errors:
            if (lacks := effect_left_out(e.model)) and e.closer is not None:
                size = "" if e.verdict == "same" else f" ({number(abs(e.closer), 2)} {e.unit})"
                parts[e.verdict].append(lacks + size)
        told = [f"{words} {_listed(names)}" for words, names in (
            ("made smaller by", parts["worse"]), ("made LARGER by", parts["better"]),
            ("no sure difference by", parts["same"])) if names]
        return f"It is {'; '.join(told)}." if told else ""

    def misled(self) -> list[str]:
        """Return what to look at: a miss, effects that make it worse, better machines."""
        out = [*self._missed(), *self._unlike()]
        for e in self.errors:
            if e.verdict == "better" and e.closer is not None:
                ends = "" if e.low is None or e.high is None else (
                    f" (95 %: {number(e.low, 2)} to {number(e.high, 2)})")
                size = f"by {number(abs(e.closer), 2)} {e.unit} rms{ends}"
                what = effect_left_out(e.model)
                verb = "make" if what == "all effects" else "makes"
                out.append(f"{self.name}: {what} {verb} the prediction worse {size}: "
                           "leave it out of the model, or diagnose this day too"
                           if what else
                           f"{self.name}: {e.model} predicts better than the model {size}: "
                           "use it, or calibrate again")
        return out

    def registered_sentence(self) -> str:
        """Return what the registration fitted, and what it makes least: no error in mm alone."""
        if self.alone:
            return (f"{self.name}: {self.rows} of {self.of_rows} rows of joint values alone: "
                    "errors are how far limbs are from closing.")
        names = [OPENED.get(w, w) for w in self.fitted]
        fitted = "nothing" if not names else _listed(names)
        more = [OPENED.get(w, w) for w in self.demanded]
        tail = f" ({_listed(more)} since the data demand it)" if more else ""
        both = names and self.errors and self.errors[0].position and self.errors[0].rotation
        how = ", to the least square of positions and rotations over their noise" if both else ""
        return f"{self.name}: {self.rows} of {self.of_rows} rows; fitted: {fitted}{tail}{how}."

    def _noise_words(self) -> str:
        """Return the noise that it is judged by with its source, empty where none is given."""
        if self.factor is None:
            return ""
        size = f"{number(self.noise, 3)} {self.unit}" if self.noise is not None else (
            f"{number(self.factor, 3)} times what its sidecar states")
        stated = "" if self.stated is None else f" (its sidecar: {number(self.stated)} {self.unit})"
        if self.judged_by == STATED:
            return f"Noise {size}, as its sidecar states." if self.noise is not None else ""
        how = "as repeats scatter" if self.judged_by == REPEATS else (
            "estimated from what a fit of that day alone leaves")
        return f"Noise {size}, {how}{stated}."

    def _of_one_row(self) -> str:
        """Return that one row makes nearly all of the mean square, empty where none does."""
        size = self.errors[0].size
        if size is None or not size.rms or size.max is None or self.rows < FEW:
            return ""
        share = size.max**2 / (self.rows * size.rms**2)
        return (f"{share:.0%} of its mean square is one row, off by {number(size.max)} {size.unit}"
                if share > ONE_ROW else "")

    def _missed(self) -> list[str]:
        """Return what a model misses a data set by, if it does: what that is most likely."""
        if self.elsewhere:
            return [f"{self.name}: {self.elsewhere} of {self.rows} rows were measured in another "
                    "assembly mode than home's: set `home` in the machine file to a pose of "
                    "theirs, or leave them out; nothing else here is to be read as an error of "
                    "the model"]
        times = self.errors[0].noise if self.errors else None
        if times is None or times <= MISSED:
            return []
        one = self._of_one_row()
        return [f"{self.name} does not fit the model ({number(times, 2)} times the noise): " + (
            f"{one}, a value typed wrong perhaps: `identify` names the row" if one else
            "another machine, or something has changed: calibrate with these rows, and "
            "`ppmcal compare` tells what changed")]

    def _unlike(self) -> list[str]:
        """Return which rows do not fit with the others, empty where all do."""
        out = [f"{self.name}: row{'s' * (len(self.left_out) > 1)} "
               f"{abbreviate_list([str(n) for n in self.left_out])} left out: no machine comes "
               "near the values there; look for a value typed wrong"] if self.left_out else []
        if not self.unlike or self.elsewhere:
            return out
        each = ", ".join(f"row {r.row} ({number(r.times, 2)} times the noise)"
                         for r in self.unlike[:SHOWN])
        more = f", and {len(self.unlike) - SHOWN} more rows" * (len(self.unlike) > SHOWN)
        verb = "do" if len(self.unlike) > 1 else "does"
        return [*out, f"{self.name}: {each}{more} {verb} not fit with the others, whatever the "
                "geometry: look at the values; here they count"]


class ValidationRecord(Record):
    """validation.json, in ``units``; ``column_units``: of validation.csv, empty for bare ones."""

    FILE: ClassVar[str] = "validation.json"
    FORMAT: ClassVar[str] = "ppmcal/validation/1"

    name: Text = ""
    units: Units = unsaid(Units)
    column_units: Mapping[Text, Text] = field(default_factory=dict)
    datasets: tuple[ValidatedDataset, ...] = ()
    findings: tuple[Text, ...] = ()
    provenance: Provenance = Provenance()

    @classmethod
    def of_validation(cls, found: Sequence[Validated], noise: Sequence[DayNoise], name: str,
                      units: Units, provenance: Mapping[str, Any], findings: Sequence[str]
                      ) -> ValidationRecord:
        """Return the record of a validation; what misleads is among its findings."""
        datasets = tuple(ValidatedDataset.of(v, units, n)
                         for v, n in zip(found, noise, strict=True))
        return cls(
            format=cls.FORMAT, name=name, units=units, datasets=datasets,
            column_units=_column_units(units, datasets),
            findings=(*findings, *(t for d in datasets for t in d.misled())),
            provenance=Provenance(**provenance))

    def files(self) -> dict[str, str]:
        """Return file name -> text of everything that validate writes."""
        table = _table(self.datasets)
        return {"validation.csv": csv_text(list(table), list(table.values())),
                self.FILE: self.text()}


def _table(datasets: Sequence[ValidatedDataset]) -> dict[str, list[Any]]:
    """Return the columns of validation.csv; of closure where joint values alone were measured."""
    rows = [(data, e) for data in datasets for e in data.errors]
    kinds = ("position", "rotation", *(["closure"] if any(d.alone for d in datasets) else []))
    return {"dataset": [data.name for data, _ in rows], "model": [e.model for _, e in rows],
            "rows": [data.rows for data, _ in rows],
            **{f"{kind}_{k}": [getattr(getattr(e, kind), k, None) for _, e in rows]
               for kind in kinds for k in SIZES},
            **{k: [getattr(e, k) for _, e in rows]
               for k in ("noise", "closer", "low", "high", "verdict")}}


def _column_units(units: Units, datasets: Sequence[ValidatedDataset]) -> dict[str, str]:
    """Return the unit of every column of validation.csv."""
    compared = {e.unit for d in datasets for e in d.errors}
    own = compared.pop() if len(compared) == 1 else f"{units.length}, of rotations {units.angle}"
    return {name: own if name in ("closer", "low", "high") else
            units.length if name.startswith(("position", "closure")) else
            units.angle if name.startswith("rotation") else "" for name in _table(datasets)}


def _with_interval(size: ErrorSize) -> str:
    """Return ``0.0071 mm rms (95 %: 0.0066 to 0.0078)``."""
    between = "" if size.rms_low is None or size.rms_high is None else (
        f" (95 %: {number(size.rms_low)} to {number(size.rms_high)})")
    return f"{number(size.rms)} {size.unit} rms{between}"


def effect_left_out(model: str) -> str:
    """Return the effect that a model of the file lacks, ``all effects``, or empty."""
    return model.removeprefix(WITHOUT) if model.startswith(WITHOUT) else ""


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
