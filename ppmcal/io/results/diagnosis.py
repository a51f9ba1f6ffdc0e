"""diagnosis.json and the files beside it: what is missing in a model, and what to measure next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Annotated, Any, ClassVar, NamedTuple

import numpy as np

from ppmcal.calibration.interpretation import plain_mistakes
from ppmcal.calibration.knowledge import coverage
from ppmcal.calibration.validation import definition, residuals, unused_sentences
from ppmcal.codec import in_units, unsaid
from ppmcal.diagnosis import other_days
from ppmcal.diagnosis.hypotheses import Untestable
from ppmcal.diagnosis.localization import Place
from ppmcal.diagnosis.plot_data import PlotData, SelectionStep, plot_data
from ppmcal.diagnosis.result import Candidate, Diagnosis, LeftOutBlocks, Swallowed, UnknownFound
from ppmcal.io import csv_text, write_mechanism
from ppmcal.io.results.beside_model import OtherModel, OtherModels, TriedSet, other_files
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect, HeldOutGap, SuspectedEffect
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import ErrorStages, excluded_rows, summaries
from ppmcal.io.results.identification_tables import residuals_csv
from ppmcal.io.results.learned import LearnedEntry
from ppmcal.io.results.parts import CampaignSummary, LeftOutRow, MisreadingEntry, misreading_entries
from ppmcal.io.results.record import Column, Flag, Record, Shown, Text, Whole, table_text
from ppmcal.io.results.tables import WrittenTable, finite_number, joint_columns, pose_columns
from ppmcal.io.results.validation import ValidatedDataset
from ppmcal.model.dataset import ZERO_CELSIUS
from ppmcal.store.output import Content
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
    the rivals' odds before and after, or without a ``next_file`` what to do instead. ``unused``:
    sentences on data sets of which hardly a row is used, where there are some.
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
    unused: tuple[Text, ...] = ()
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
            **({"unused": tuple(unused)} if (unused := unused_sentences(fit)) else {}),
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


EFFECT_TABLE = WrittenTable("effects.csv", ("p_value", "survival", "probability").__contains__)


def files(result: Diagnosis, record: DiagnosisRecord, of_fit: IdentificationRecord
          ) -> dict[str, Content]:
    """Return file name -> text of everything that diagnose writes but pictures."""
    found, fit = result.identification, result.identification.fit
    alone = residuals(result.before.problem, result.before.state)
    out: dict[str, Content] = {
        "model.yaml": write_mechanism(
            found.mechanism,
            f"diagnosed by ppmcal {record.provenance.version}: {result.verdict}; from "
            + ", ".join(d.name for d in fit.problem.datasets)),
        "effects.csv": effects_csv(result),
        "residuals.csv": residuals_csv(fit, found.before, found.after, alone),
        record.FILE: record.text(),
        of_fit.FILE: of_fit.text(),
    }
    for name, other in other_files(result):
        what = ("fitted by ppmcal without the effects of model.yaml" if other.bare else
                f"diagnosed by ppmcal: {other.effect or 'nothing'} in place of "
                f"{other.instead or 'nothing'}")
        out[name] = write_mechanism(other.mechanism, what)
    if result.proposal.rows:
        out["next.csv"] = next_csv(result)
    return out


def effects_csv(result: Diagnosis) -> str:
    """Return effects.csv: one row per candidate, in the order of what became of it.

    ``p_value`` is empty: what was found has the smallest of thousands.
    """
    mechanism, some, none = result.identification.mechanism, result.candidates, result.untestable
    unknown, blank = [np.nan] * len(none), [""] * len(none)
    return table_text([
        Column("kind", [*(c.hypothesis.family for c in some), *(u.kind for u in none)]),
        Column("on", [*(" ".join(c.hypothesis.on) for c in some), *blank]),
        Column("form", [*("shared" if c.hypothesis.shared else "each" for c in some), *blank]),
        Column("p_value", [np.nan] * (len(some) + len(none))),
        Column("survival", [*(c.visibility for c in some), *unknown]),
        Column("status", [*(c.status for c in some), *["not testable"] * len(none)]),
        Column("alternatives", [*("; ".join(c.alternatives) for c in some),
                                *(f"needs {', '.join(u.missing)}" if u.missing else u.reason
                                  for u in none)]),
        Column("side", [*(_side(result, c) for c in some), *blank]),
        Column("probability", [*(c.probability for c in some), *unknown]),
    ], mechanism.units)


def _side(result: Diagnosis, candidate: Candidate) -> str:
    """Return whether the joints of what is named lag or lead their readings, joint by joint."""
    mine, mechanism = candidate.hypothesis, result.identification.mechanism
    sides = {e.on: side for e in result.effects if candidate.status == "named" and (
        e.hypothesis.family, e.hypothesis.on) == (mine.family, mine.on)
        and (side := e.side(mechanism))}
    if len(set(sides.values())) < 2:
        return next(iter(sides.values()), "")
    return "; ".join(f"{' '.join(on)} {side}" for on, side in sides.items())


def next_csv(result: Diagnosis) -> str:
    """Return next.csv: joints, poses and settings of the measurements to take."""
    mechanism, wanted = result.identification.mechanism, result.proposal
    table = joint_columns(mechanism, wanted.q, "q_{}") | pose_columns(mechanism, wanted.pose)
    for name, values in wanted.columns.items():
        if name.startswith("vel_"):
            a = mechanism.actuators.index(name.removeprefix("vel_"))
            values = values / mechanism.joint_units[a][0]
        table[name] = values - ZERO_CELSIUS if name.startswith("temperature") else values
    return csv_text(list(table), list(table.values()))
