"""What an identification gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from ppmcal.calibration.fit import Noise
from ppmcal.calibration.knowledge import FreedomChoice, Identifiability
from ppmcal.calibration.validation import UNUSED, Identification, Residuals
from ppmcal.commands.inputs import imports_behind
from ppmcal.commands.result import Result
from ppmcal.controllers import own_words
from ppmcal.io.results import identification_wording as wording
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import before_words
from ppmcal.io.results.parts import campaign_sentences
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import about
from ppmcal.store.output import Content
from ppmcal.wording import abbreviate_list, number, pluralize
from ppmcal.wording.told import Findings, ShortTable, Told

if TYPE_CHECKING:
    from ppmcal.calibration.compensation import Readings
    from ppmcal.io.results.batch import CampaignQuantity

PRIOR_DOMINATED = 0.8
"""A parameter known to this part of its tolerance is constrained by the prior, not the data."""
SHOWN = 12
"""Parameters that are shown."""


def _errors(record: IdentificationRecord) -> Iterator[Told]:
    """Yield errors before, after and on what was held out."""
    stages = record.residual
    told = [(label, name, f) for label, found in (
        ("before", stages.before), ("after", stages.after), ("held out", stages.holdout))
        for name, f in found.items()]
    # gaps of limbs have signs, and no mean of their sizes
    alone = bool(told) and all(name == "closure" for _, name, _ in told)
    kinds = ("rms", "max") if alone else ("mean", "rms", "p95", "max")
    yield ShortTable(["", "error", *kinds, "unit"], [
        [label, name, *(number(getattr(f, k)) for k in kinds), f.unit] for label, name, f in told],
        tuple(range(2, 2 + len(kinds))))
    yield f"Held out: {record.holdout_note}.{before_words(stages.before_is)}"


def _noise(n: Noise) -> Iterator[Told]:
    repeats = (f" Repeats scatter {n.repeat_ratio:.3g} times the {n.source} noise."
               if n.repeat_ratio else "")
    yield f"Noise: {wording.noise_verdict(n)[0]}.{repeats}"
    if len(n.by_dataset) > 1:
        ratios = ", ".join(f"{name} {number(r, 3)}" for name, r in n.by_dataset.items())
        yield f"By file: {ratios}."


def _parameters(record: IdentificationRecord) -> Iterator[Told]:
    """Yield the parameters that moved farthest, in tolerances."""
    free = record.free
    shown = sorted(free, key=lambda p: -abs(p.error or 0.0) / (p.tolerance or 1.0))[:SHOWN]
    if shown:
        wider = any(p.sigma_sessions is not None for p in shown)
        yield ShortTable(
            ["parameter", *["nominal"] * (not wider), "error", "+- 95 %", *["by noise"] * wider,
             "unit", "status"],
            [[p.name, *[number(p.nominal, 7)] * (not wider), number(p.error), number(p.half, 3),
              *[number(p.by_noise, 3)] * wider, p.unit,
              p.status_words] for p in shown], (1, 2, 3))
        if wider:
            yield ("By noise: the 95 % interval of noise alone; +- 95 % also counts how far "
                   "sessions, or parts of one, differ.")
    for sentence in wording.short_intervals(record.method):
        yield f"{sentence}."
    if len(free) > len(shown):
        yield (f"The {len(shown)} largest errors against tolerance; all {len(free)} in "
               "parameters.csv.")


def _prior_dominated(record: IdentificationRecord) -> Iterator[Told]:
    """Yield what the data hardly know better than the nominal values' tolerances."""
    found = sorted(((p.of_tolerance or 0.0, p.name) for p in record.parameters
                    if p.status == "identified" and (p.of_tolerance or 0.0) > PRIOR_DOMINATED),
                   key=lambda h: -h[0])
    if found:
        names = [f"{name} ({ratio:.2f})" for ratio, name in found]
        yield ("Constrained by the prior rather than by these data (posterior sigma over "
               f"tolerance): {abbreviate_list(names, 'parameters.csv')}.")


def _redundant(record: IdentificationRecord, prior: bool) -> Iterator[Told]:
    if record.unidentifiable:
        count = sum(s.combinations for s in record.unidentifiable)
        how = "held by the prior" if prior else "left at nominal"
        yield (f"{count} redundant: combinations of parameters that these data cannot identify "
               f"({how}): {wording.unidentifiable_words(record.unidentifiable)}.")


@dataclass(frozen=True, eq=False, repr=False)
class IdentificationResult(Result):
    """A calibrated machine and how well it is known.

    Attributes:
        identification: everything, SI: the fit, its residuals, noise and findings.
        method: ``prior``, ``flat``, ``gcv`` or ``damped``.
        notes: sentences on noise and scale of each file, where they were estimated.
        freedoms: which optional ones were kept, and why; None where there was no choice.
    """

    COMMAND: ClassVar[str] = "identify"
    TABLE: ClassVar[str] = "parameters.csv"
    UNTOLD: ClassVar[tuple[str, ...]] = ("covariance", "known_rows")

    identification: Identification
    method: str
    notes: tuple[str, ...] = ()
    freedoms: FreedomChoice | None = None

    @property
    def mechanism(self) -> Mechanism:
        """The machine with the identified values and, as tolerances, what is still unknown."""
        return self.identification.mechanism

    @property
    def readings(self) -> Readings:
        """Other readings of the measurements: none were sought."""
        from ppmcal.calibration.compensation import Readings

        return Readings((), None)

    @property
    def converged(self) -> bool:
        """Whether the fit is at its minimum."""
        return self.identification.fit.converged

    @property
    def parameters(self) -> Any:
        """One row per parameter, file units: nominal, value, error, sigma, tolerance, status."""
        return self.to_frame()

    @property
    def covariance(self) -> Array:
        """Covariance (C, C) of the free parameters, frames and targets, SI (``columns``)."""
        return self.identification.covariance

    @property
    def columns(self) -> tuple[str, ...]:
        """What the C rows of :attr:`covariance` are."""
        return tuple(self.identification.columns)

    @property
    def residuals(self) -> Residuals:
        """Measured minus predicted of every row after the fit, SI."""
        return self.identification.after

    @property
    def identifiability(self) -> Identifiability:
        """What the data leave open: scale, exactly correlated parameters."""
        return self.identification.identifiability

    def files(self) -> Mapping[str, Content]:
        """Return identified.yaml, parameters.csv, residuals.csv and identification.json."""
        return dict(self.record.files(self.identification))

    @cached_property
    def record(self) -> IdentificationRecord:
        """The content of identification.json, file units."""
        return IdentificationRecord.of(self.identification, self.provenance, self.method,
                                       self.freedoms)

    def remarks(self) -> Sequence[str]:
        """Return the findings, and which drives lost their zero."""
        return self.record.all_findings()

    @property
    def warnings(self) -> list[str]:
        """Nothing: findings are printed above the rows that were left out."""
        return []

    def told(self) -> Iterator[Told]:
        """Yield the noise that was estimated, the fit, its errors, and what the data leave open."""
        found, record = self.identification, self.record
        fit = found.fit
        rows = sum(int(k.sum()) for k in fit.keep)
        open_ = len(found.columns) - len(fit.problem.free)
        more = f" and {open_} of frames and targets" if open_ else ""
        unused = about(record.all_findings(), (UNUSED,))
        yield Findings(unused)
        yield from self.notes
        yield (f"{record.name}: {len(fit.problem.free)} parameters{more} from {rows} rows, "
               f"{pluralize(fit.iterations, 'iteration')}; rank {found.rank} of "
               f"{len(found.columns)}.")
        yield from (*_errors(record), *_noise(record.noise), *_parameters(record))
        if controller := self._controller():
            yield f"{controller}."
        yield from _redundant(record, fit.by_tolerances)
        if fit.by_tolerances:
            yield from _prior_dominated(record)
        yield from wording.open_sentences(record.collinear, record.scale)
        yield from wording.flat_sentences(record.flats)
        yield from campaign_sentences(record.campaign)
        # above the rows left out
        yield Findings([f for f in record.all_findings() if f not in unused])
        yield from wording.row_sentences(record.gross_errors, record.would_be, found.mechanism)
        yield from wording.unchecked_sentences(record.unchecked)

    def _controller(self) -> str:
        """Return what the controller that the machine was imported from calls its parameters."""
        machine = self.identification.fit.problem.mechanism
        path = Path(machine.source)
        if machine.source not in machine.inputs or not path.is_file():
            return ""
        forms = [str(run.source.options.get("form", "")) for run in imports_behind(path)]
        return next(filter(None, (own_words(machine, form) for form in forms)), "")

    def quantities(self) -> Iterator[CampaignQuantity]:
        """Yield errors, noise and parameters."""
        from ppmcal.io.results.batch import fit_quantities

        return fit_quantities(self.record)

    def headline(self) -> str:
        """Return parameters, rank and the error before and after."""
        found, stages = self.identification, self.record.residual
        errors = "".join(
            f"; {name} error {stages.before[name].rms:.4g} -> {after.rms:.4g} {after.unit} rms"
            for name, after in list(stages.after.items())[:1])
        return (f"{self.mechanism.name}: {len(found.fit.problem.free)} parameters, rank "
                f"{found.rank} of {len(found.columns)}{errors}")
