"""identification.json, parameters.csv, residuals.csv and identified.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Annotated, Any, ClassVar

import numpy as np

from ppmcal.calibration.fit import Flat, HomingShift, Noise, UncheckedRows, Unidentifiable
from ppmcal.calibration.knowledge import (
    CollinearParameters,
    FreedomChoice,
    FreedomSet,
    Scale,
    registered,
)
from ppmcal.calibration.validation import Dependence, DoubtfulStretch, Identification, definition
from ppmcal.codec import in_units, unsaid
from ppmcal.io import write_mechanism
from ppmcal.io.results.identification_parts import (
    CorrelatedPair,
    CovarianceEntry,
    ErrorStages,
    FittedDataset,
    ParameterEstimate,
    RegistrationEntry,
    RowsOfTable,
    Summaries,
    combination_in_units,
    excluded_rows,
    rows_behind,
    summaries,
)
from ppmcal.io.results.identification_tables import (
    missing_csv,
    parameters_csv,
    residuals_csv,
    table_units,
)
from ppmcal.io.results.identification_wording import gross_rows, sets_of, shift_sentence, would_be
from ppmcal.io.results.parts import CampaignSummary, LeftOutRow
from ppmcal.io.results.record import Finite, Flag, Record, Text, Whole
from ppmcal.io.results.units import Numbers, of_joints
from ppmcal.model.dataset import Dataset
from ppmcal.model.registration import Registration
from ppmcal.notes import Note
from ppmcal.store.output import Content
from ppmcal.store.provenance import Provenance
from ppmcal.units import ByCoordinate, Key, Units

CORRELATED = 0.95
STRONGEST = 50


class IdentificationRecord(Record):
    """identification.json, in ``units``; rank, columns, iterations, prior_scale are bare.

    ``by_normal_equations``: of the iterations, those whose step came from normal equations and not
    from QR of the rows, their condition allowing it; the last one never does.
    ``would_be``: what parameters would be ``with_them``, the rows of ``gross_errors``, in the unit
    of each. ``scale`` is missing where it could not be judged.
    ``observability``: O1 to O5, in tolerances per standard deviation; ``unexplained``: rms of
    what neither model nor noise explains; ``doubtful``: stretches of joints in which rows were
    left out that the model misses; ``campaign``: poses too weak for what was fitted, with those
    that are missing in next.csv; ``freedoms``: nested sets of optional
    ones, smallest first, as they predict ``blocks`` left out in turn; ``measured_volume``:
    coordinate -> (low, high); ``earlier``: content hash -> name of the
    tables behind a calibration carried on; ``known_rows``: of all tables behind this one, by which
    copies of them are recognised; ``column_units``: of the CSV files beside it, by file,
    empty for bare numbers.
    """

    FILE: ClassVar[str] = "identification.json"
    FORMAT: ClassVar[str] = "ppmcal/identification/1"

    name: Text = ""
    method: Text = ""
    parameters: tuple[ParameterEstimate, ...] = ()
    rank: Whole | None = None
    columns: Whole | None = None
    redundant: tuple[Dependence, ...] = ()
    unidentifiable: tuple[Unidentifiable, ...] = ()
    iterations: Whole | None = None
    by_normal_equations: Whole | None = None
    converged: Flag | None = None
    prior_scale: Finite | None = None
    residual: ErrorStages = ErrorStages()
    unexplained: Summaries = field(default_factory=dict)
    holdout_note: Text = ""
    noise: Noise = unsaid(Noise)
    observability: Mapping[Text, Finite | None] = field(default_factory=dict)
    correlations: tuple[CorrelatedPair, ...] = ()
    flats: tuple[Flat, ...] = ()
    gross_errors: Annotated[tuple[LeftOutRow, ...], Key("gross_errors.rows")] = ()
    would_be: Annotated[Mapping[Text, Mapping[Text, Finite | None]],
                        Key("gross_errors.would_be")] = field(default_factory=dict)
    homing_shifts: Annotated[tuple[HomingShift, ...], Key("gross_errors.homing_shifts")] = ()
    unchecked: Annotated[tuple[UncheckedRows, ...], Key("gross_errors.unchecked")] = ()
    collinear: Annotated[tuple[CollinearParameters, ...], Key("identifiability.collinear")] = ()
    scale: Annotated[Scale | None, Key("identifiability.scale")] = None
    excluded: tuple[LeftOutRow, ...] = ()
    findings: tuple[Text, ...] = ()
    datasets: tuple[FittedDataset, ...] = ()
    units: Units = unsaid(Units)
    column_units: Mapping[Text, Mapping[Text, Text]] = field(default_factory=dict)
    doubtful: tuple[DoubtfulStretch, ...] = ()
    campaign: CampaignSummary | None = None
    blocks: Annotated[Whole | None, Key("freedoms.blocks", whole=True)] = None
    freedoms: Annotated[tuple[FreedomSet, ...], Key("freedoms.sets")] = ()
    measured_volume: ByCoordinate[Mapping[Text, Numbers]] = field(default_factory=dict)
    provenance: Provenance = Provenance()
    earlier: Mapping[Text, Text] = field(default_factory=dict)
    known_rows: tuple[RowsOfTable, ...] = ()
    covariance: CovarianceEntry | None = None

    @classmethod
    def of(cls, result: Identification, provenance: Mapping[str, Any], method: str,
           freedoms: FreedomChoice | None = None) -> IdentificationRecord:
        """Return the record of an identification."""
        fit, mechanism, units = result.fit, result.mechanism, result.mechanism.units
        gross, open_ = result.gross_errors, result.identifiability
        kept: dict[str, Any] = {} if freedoms is None else {"freedoms": tuple(
            replace(s, kept=n <= freedoms.kept) for n, s in enumerate(freedoms.sets))}
        carried = {} if result.earlier is None else {"earlier": dict(result.earlier.inputs)}
        stages = ErrorStages(before_is=definition(fit.problem.blind),
                                before=summaries(result.before.figures(fit.keep), units),
                                after=summaries(result.after.figures(fit.keep), units),
                                holdout=summaries(result.holdout, units))
        return cls.filled(
            None, units, format=cls.FORMAT, name=mechanism.name, method=method,
            parameters=tuple(ParameterEstimate.of(e, units) for e in result.estimates),
            rank=result.rank, columns=len(result.columns),
            redundant=tuple(combination_in_units(d, mechanism) for d in result.redundant),
            unidentifiable=sets_of(result.unidentifiable, mechanism),
            iterations=fit.iterations, by_normal_equations=fit.summed, converged=fit.converged,
            prior_scale=fit.prior_scale,
            residual=stages, unexplained=summaries(
                {k: {"rms": v} for k, v in result.unexplained.items()}, units),
            holdout_note=result.holdout_note, noise=result.noise,
            observability=result.observability, correlations=_correlations(result),
            flats=result.flats,
            gross_errors=gross_rows(gross, mechanism), would_be=would_be(gross, mechanism),
            homing_shifts=of_joints(gross.homing_shifts, mechanism), unchecked=gross.unchecked,
            collinear=open_.collinear, **({"scale": open_.scale} if open_.scale else {}),
            excluded=(*excluded_rows(fit), *(
                LeftOutRow(dataset=d.name, row=int(row), reason=reason)
                for d in fit.problem.datasets for row, reason in d.dropped)),
            findings=(*mechanism.findings, *result.findings),
            datasets=_datasets(result),
            doubtful=of_joints(result.doubtful, mechanism),
            campaign=CampaignSummary.of(result.campaign, units),
            blocks=None if freedoms is None else freedoms.blocks, **kept,
            units=units, column_units=table_units(fit.problem),
            measured_volume=result.measured_volume,
            provenance=Provenance(**provenance), **carried,
            known_rows=tuple(RowsOfTable.of_rows(k, mechanism) for k in rows_behind(result)),
            covariance=CovarianceEntry.of(result))

    @property
    def free(self) -> list[ParameterEstimate]:
        """The parameters that were fitted."""
        return [p for p in self.parameters if p.status != "fixed"]

    @property
    def far(self) -> tuple[ParameterEstimate, ...]:
        """The parameters that are farther from nominal than tolerances allow."""
        return tuple(p for p in self.parameters if p.far)

    def all_findings(self) -> list[str]:
        """Return the findings, and which drives lost their zero."""
        return [*self.findings, *(Note(t) for s in self.homing_shifts if (t := shift_sentence(s)))]

    def files(self, result: Identification) -> dict[str, Content]:
        """Return file name -> text of everything that identify writes of its ``result``."""
        names = ", ".join(d.name for d in result.fit.problem.datasets)
        missing = {} if result.campaign is None else {
            "next.csv": missing_csv(result.mechanism, result.campaign.missing)}
        return {
            **missing,
            "identified.yaml": write_mechanism(
                result.mechanism, f"identified by ppmcal {self.provenance.version} from {names}"),
            "parameters.csv": parameters_csv(self.parameters),
            "residuals.csv": residuals_csv(result.fit, result.before, result.after),
            self.FILE: self.text()}


def _correlations(result: Identification) -> tuple[CorrelatedPair, ...]:
    """Return the strongly correlated pairs of parameters, strongest first."""
    count = len(result.fit.problem.free)
    c = result.covariance[:count, :count]
    sigma = np.sqrt(np.maximum(np.diagonal(c), 0.0))
    with np.errstate(invalid="ignore", divide="ignore"):
        r = np.triu(c / np.outer(sigma, sigma), 1)
    strong = np.argwhere(np.abs(np.nan_to_num(r)) > CORRELATED).tolist()
    pairs = sorted(strong, key=lambda p: -abs(r[p[0], p[1]]))[:STRONGEST]
    return tuple(CorrelatedPair(a=result.columns[i], b=result.columns[j], value=float(r[i, j]))
                 for i, j in pairs)


def _datasets(result: Identification) -> tuple[FittedDataset, ...]:
    units, fit = result.mechanism.units, result.fit
    stands = registered(fit.problem, fit.state)
    return tuple(FittedDataset(
        name=d.name, source=d.source, kind=d.kind.name, rows=len(d), used=int(k.sum()),
        registration=RegistrationEntry.of(stands.get(d.name, Registration()), units, d.kind),
        registration_before=RegistrationEntry.of(
            result.before_registrations.get(d.name, Registration()), units, d.kind),
        **_further(d, units))
        for d, k in zip(fit.problem.datasets, fit.keep, strict=True))


def _further(data: Dataset, units: Units) -> dict[str, Any]:
    """Return what is said of few data sets: what defines the frame, joints in another form."""
    out: dict[str, Any] = {}
    if data.frame.defined is not None:
        out["frame_by"] = in_units(data.frame.defined, units)
    if data.recorded is not None and not data.recorded.as_machine:
        out["recorded"] = data.recorded
    return out
