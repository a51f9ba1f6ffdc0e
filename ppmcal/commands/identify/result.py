"""What an identification gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

from ppmcal.calibration.compensation import Readings
from ppmcal.calibration.knowledge import FreedomChoice, Identifiability
from ppmcal.calibration.validation import Identification, Residuals
from ppmcal.commands.identify.told import told
from ppmcal.commands.result import Result
from ppmcal.io.results.batch import CampaignQuantity, fit_quantities
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.store.output import Content
from ppmcal.wording.told import Told


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
        yield from self.notes
        yield from told(self.identification, self.record)

    def quantities(self) -> Iterator[CampaignQuantity]:
        """Yield errors, noise and parameters."""
        return fit_quantities(self.identification)

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        return self.record.summary()

    def headline(self) -> str:
        """Return parameters, rank and the error before and after."""
        found, stages = self.identification, self.record.residual
        errors = "".join(
            f"; {name} error {stages.before[name].rms:.4g} -> {after.rms:.4g} {after.unit} rms"
            for name, after in list(stages.after.items())[:1])
        return (f"{self.mechanism.name}: {len(found.fit.problem.free)} parameters, rank "
                f"{found.rank} of {len(found.columns)}{errors}")
