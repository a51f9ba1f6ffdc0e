"""diagnosis.json: what is missing in a model, how sure that is, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, NamedTuple

from ppmcal.calibration.interpretation import plain_mistakes
from ppmcal.calibration.knowledge import coverage
from ppmcal.calibration.validation import definition, residuals
from ppmcal.codec import in_units, unsaid
from ppmcal.diagnosis import other_days
from ppmcal.diagnosis.hypotheses import Untestable
from ppmcal.diagnosis.localization import Place
from ppmcal.diagnosis.plot_data import PlotData, SelectionStep, plot_data
from ppmcal.diagnosis.result import Diagnosis, LeftOutBlocks, Swallowed, UnknownFound
from ppmcal.io.results.campaign import CampaignSummary
from ppmcal.io.results.diagnosis_parts import (
    DiagnosedEffect,
    HeldOutGap,
    SuspectedEffect,
)
from ppmcal.io.results.identification_parts import ErrorStages, excluded_rows, summaries
from ppmcal.io.results.interpretation import MisreadingEntry, misreading_entries
from ppmcal.io.results.learned_parts import LearnedEntry
from ppmcal.io.results.other_models import OtherModel, OtherModels, TriedSet, other_files
from ppmcal.io.results.parts import LeftOutRow
from ppmcal.io.results.record import Flag, Record, Shown, Text, Whole
from ppmcal.io.results.tables import finite_number
from ppmcal.io.results.validation import ValidatedDataset
from ppmcal.store.provenance import Provenance
from ppmcal.units import Key, Units

CHOSEN = ("effects", "learned terms")
"""What rows left out of the fits choose all the same: which names stand, and which shapes."""


class DiagnosisRecord(Record):
    """diagnosis.json, in the units of the machine's file.

    ``coverage``: half of a 95 % interval over sigma, for what only noise makes uncertain.
    ``nothing``: probability that geometry is all there is; ``unknown``: what is there without a
    name. ``ratio_before``, ``ratio_after``: rms over the noise without and with the effects, over
    so many ``rows``; ``serial_correlation``: of the noise from row to row. ``rms_ratio``: what is
    left over the noise; ``follows``: what the likeliest unknown cause in it looks like, ``known``:
    probability that there is none; ``p_value``: null. ``next_reason``: what to measure next, with
    the rivals' odds before and after, or without a ``next_file`` what to do instead.
    """

    FILE: ClassVar[str] = OtherModels.FILE
    FORMAT: ClassVar[str] = OtherModels.FORMAT
    EARLIER: ClassVar[tuple[str, ...]] = OtherModels.EARLIER

    name: Text = ""
    verdict: Text = ""
    misreadings: tuple[MisreadingEntry, ...] = ()
    effects: tuple[DiagnosedEffect, ...] = ()
    suspected: Annotated[tuple[SuspectedEffect, ...], Key("possible")] = ()
    nothing: Shown | None = None
    unknown: tuple[UnknownFound, ...] = ()
    learned: tuple[LearnedEntry, ...] = ()
    residual: ErrorStages = ErrorStages()
    follows: Annotated[Text | None, Key("remainder.follows")] = None
    p_value: Annotated[Shown | None, Key("remainder.p_value")] = None
    known: Annotated[Shown | None, Key("remainder.known")] = None
    rms_ratio: Annotated[Shown | None, Key("remainder.rms_ratio")] = None
    noise_reference: Annotated[Text, Key("remainder.noise_reference")] = ""
    noise_ratio: Annotated[Shown | None, Key("remainder.noise_ratio")] = None
    gap: HeldOutGap = HeldOutGap()
    confirmed: Flag | None = None
    predictive: tuple[LeftOutBlocks, ...] = ()
    ratio_before: Annotated[Shown | None, Key("fit.before")] = None
    ratio_after: Annotated[Shown | None, Key("fit.after")] = None
    rows: Annotated[Whole, Key("fit.rows")] = 0
    serial_correlation: Annotated[Shown | None, Key("noise.serial_correlation")] = None
    localised: tuple[Place, ...] = ()
    not_testable: tuple[Untestable, ...] = ()
    absorbed_by_geometry: Annotated[tuple[Swallowed, ...], Key("swallowed")] = ()
    next_reason: Annotated[Text, Key("next_measurements.reason")] = ""
    next_file: Annotated[Text | None, Key("next_measurements.file")] = None
    next_rows: Annotated[Whole, Key("next_measurements.rows")] = 0
    odds_before: Annotated[Shown | None, Key("next_measurements.odds_before")] = None
    odds_after: Annotated[Shown | None, Key("next_measurements.odds_after")] = None
    excluded: tuple[LeftOutRow, ...] = ()
    findings: tuple[Text, ...] = ()
    campaign: CampaignSummary | None = None
    other_models: tuple[OtherModel, ...] = ()
    sets: tuple[TriedSet, ...] = ()
    validation: tuple[ValidatedDataset, ...] = ()
    plot_data: PlotData = PlotData()
    coverage: Shown | None = None
    units: Units = unsaid(Units)
    provenance: Provenance = Provenance()

    @classmethod
    def of(cls, result: Diagnosis, provenance: Mapping[str, Any]) -> DiagnosisRecord:
        """Return the record of a diagnosis."""
        fit = result.identification.fit
        units = result.identification.mechanism.units
        left, noise, wanted = result.remainder, result.found.last.noise, result.proposal
        return cls(
            format=cls.FORMAT, name=result.identification.mechanism.name, verdict=result.verdict,
            misreadings=misreading_entries(
                [m for d in fit.problem.datasets for m in plain_mistakes(
                    d, fit.problem.mechanism)], units),
            effects=tuple(DiagnosedEffect.of(result, e) for e in result.effects),
            suspected=tuple(SuspectedEffect.of(c) for c in result.suspected),
            nothing=result.nothing,
            unknown=result.unknown, predictive=result.predictive,
            learned=LearnedEntry.all_of(result),
            residual=_errors(result),
            follows=left.follows or None, p_value=None, known=left.known, rms_ratio=left.ratio,
            noise_reference=left.source, noise_ratio=left.reference,
            gap=HeldOutGap.of(result.gap, CHOSEN),
            confirmed=_confirmed(result),
            ratio_before=result.start.ratio, ratio_after=left.ratio,
            rows=sum(int(k.sum()) for k in fit.keep), serial_correlation=noise.rho,
            localised=result.localised, not_testable=result.untestable,
            absorbed_by_geometry=in_units(result.absorbed_by_geometry, units),
            next_reason=wanted.reason, next_file="next.csv" if wanted.rows else None,
            next_rows=wanted.rows, odds_before=wanted.odds_before, odds_after=wanted.odds_after,
            excluded=excluded_rows(fit),
            findings=(*result.identification.mechanism.findings, *result.findings),
            campaign=CampaignSummary.of(result.identification.campaign, units),
            other_models=tuple(OtherModel.of(name, other) for name, other in other_files(result)),
            sets=TriedSet.each(result),
            validation=tuple(ValidatedDataset.of(d, units) for d in result.days),
            plot_data=in_units(plot_data(result), units),
            coverage=coverage(fit), units=units,
            provenance=Provenance(**provenance))


def _errors(result: Diagnosis) -> ErrorStages:
    """Return the errors of the nominal machine, of geometry alone and of what was found."""
    found, units = result.identification, result.identification.mechanism.units
    alone = residuals(result.before.problem, result.before.state)
    before, geometry, after = (summaries(errors.figures(found.fit.keep), units)
                               for errors in (found.before, alone, found.after))
    worse = any((geometry[k].rms or 0.0) > (b.rms or 0.0) for k, b in before.items()
                if k in geometry)
    own = [old & new for old, new in zip(result.before.keep, found.fit.keep, strict=True)]
    out = sum(int((new & ~old).sum())
              for old, new in zip(result.before.keep, found.fit.keep, strict=True))
    return ErrorStages(before_is=definition(found.fit.problem.blind), before=before,
                       geometry=geometry, after=after,
                       own_rows=summaries(alone.figures(own), units) if worse and out else None,
                       left_out=out if worse and out else None)


class GapStep(NamedTuple):
    """One model on the way from nominal to the noise: residuals over the noise, and what it closes.

    Shares are of the squares that exceed the noise, as effects add in squares: ``of_whole`` of the
    first model's, ``of_geometry``, of effects, of what geometry leaves; None where there is none.
    """

    step: SelectionStep
    ratio: float
    of_whole: float | None
    of_geometry: float | None


def gap_steps(steps: Sequence[SelectionStep]) -> list[GapStep]:
    """Return what each step closes of the gap, those left out whose residuals are not known."""
    known = [(s, r) for s in steps if (r := finite_number(s.rms_ratio)) is not None]
    excess = [max(r**2 - 1.0, 0.0) for _, r in known]
    fitted = next((e for (s, _), e in zip(known, excess, strict=True) if s.what == "geometry"),
                  0.0)
    gone = [None, *(a - b for a, b in pairwise(excess))]
    return [GapStep(s, r, _part(g, excess[0]), _part(g, fitted) if s.what == "effect" else None)
            for (s, r), g in zip(known, gone, strict=False)]


def _part(gone: float | None, gap: float) -> float | None:
    return None if gone is None or not gap > 0.0 else gone / gap


def _confirmed(result: Diagnosis) -> bool | None:
    """Return whether sessions left out in turn, or else held-out poses, bear the effects out."""
    by_days = other_days.confirmed(result.days)
    return by_days if by_days is not None or result.gap is None else result.gap.confirmed
