"""The effect that the model misses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import ClassVar

from ppmcal.calibration.compensation import Readings
from ppmcal.calibration.fit import FitOptions, Problem, secondary
from ppmcal.calibration.interpretation import (
    InterpretationError,
    interpretation_sentence,
    refuse_before_fit,
)
from ppmcal.calibration.knowledge import (
    choice_sentence,
    noise_beyond_tolerances,
    pulled_apart,
    with_chosen_freedoms,
)
from ppmcal.calibration.validation import UNUSED, Identification, unused_sentences
from ppmcal.codec import encoded
from ppmcal.commands.diagnose.options import DiagnoseArguments
from ppmcal.commands.identify.run import (
    APART,
    FREEDOMS,
    MISSING,
    PATTERN,
    TOLERATED,
    left_over,
    said_beside,
    with_unit_findings,
)
from ppmcal.commands.inputs import data_files, prepared
from ppmcal.commands.result import Result
from ppmcal.commands.spec import Refusal
from ppmcal.design.missing_poses import weak_campaign
from ppmcal.diagnosis.diagnose import DiagnosisOptions
from ppmcal.diagnosis.hypotheses import SOME_FILES, Untestable
from ppmcal.diagnosis.next_experiment import with_poses
from ppmcal.diagnosis.own_noise import diagnose_with_own_noise
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.errors import BadInput, PpmcalError, refuse_unknown
from ppmcal.io.results import diagnosis_wording as wording
from ppmcal.io.results.batch import CampaignQuantity, effect_quantities, fit_quantities
from ppmcal.io.results.diagnosis import DiagnosisRecord, files
from ppmcal.io.results.diagnosis_parts import EffectValue, HeldOutGap
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.parts import campaign_sentences, misreading_entries
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects import GEOMETRY, effect_kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.sessions import one_session, session_masks
from ppmcal.notes import FINDING, NOTE, Note, about, topic_of
from ppmcal.store.inputs import current
from ppmcal.store.output import Content, Output
from ppmcal.store.provenance import Provenance, source_of
from ppmcal.wording import abbreviate_list, actuator_list, number, rate
from ppmcal.wording.progress import note, start_stage
from ppmcal.wording.told import Told


def told(result: Diagnosis, record: DiagnosisRecord) -> Iterator[str]:
    """Yield what a person wants to know."""
    yield f"{record.name}: {wording.verdict(record)}"
    yield "Disagreement with geometry alone: " + _where(result)
    yield wording.stages(record)
    yield from (*effects(record), *wording.another_day(record), *_suspected(result), *_left(result))
    yield from filter(None, (
        wording.unknown_causes(record), wording.tried_sets(record),
        wording.gap_closed(record) if record.effects else "", wording.predicted(record),
        wording.confounded(record), *wording.learned(record), wording.learned_gap(record)))
    if record.not_testable:
        yield "Not testable: " + "; ".join(_lacking(record.not_testable)) + "."
    yield from campaign_sentences(record.campaign)
    yield f"Next: {wording.next_step(record)}"


def _lacking(untestable: Sequence[Untestable]) -> list[str]:
    """Return ``compliance, windup (need payload)``: the kinds by what they lack, and where.

    Of a kind that lacks the same about the base, or in its products with travel, that once.
    """
    kinds: dict[tuple[tuple[str, ...], str], dict[str, None]] = {}
    for u in untestable:
        where = f", {u.reason}" if topic_of(u.reason) == SOME_FILES or not u.missing else ""
        kinds.setdefault((u.missing, where), {})[u.kind] = None
    for alike in kinds.values():
        for kind in [k for k in alike if " " in k and k.partition(" ")[0] in alike]:
            del alike[kind]
    return [f"{', '.join(some)} ({where.removeprefix(', ')})" if not missing else
            f"{', '.join(some)} (need{'s' if len(some) == 1 else ''} "
            f"{', '.join(missing[:2])}{' ...' if len(missing) > 2 else ''}{where})"
            for (missing, where), some in kinds.items()]


def _where(result: Diagnosis) -> str:
    strong = [p for p in result.localised if p.by == "actuator" and p.p_value < 0.01]
    strong.sort(key=lambda p: -p.rms_ratio)
    text = f"residuals are {result.start.ratio:.2f} times the {result.start.source} noise"
    if strong:
        text += ", most at " + ", ".join(f"{p.value} ({p.rms_ratio:.1f} x)" for p in strong[:3])
    return text + "."


def effects(record: DiagnosisRecord) -> list[str]:
    """Return the named effects with their sizes, and what they cannot be told from."""
    out = []
    for group in wording.together(record):
        on = list(dict.fromkeys(a for e in group for a in e.on))
        heads = ["" if list(e.on) == on else f"{actuator_list(e.on, wording.actuators(record))} "
                 for e in group]
        chances = [wording.probable(e.probability) for e in group]
        alone = [f" ({p})" if len(set(chances)) > 1 else "" for p in chances]
        sizes = wording.own_values(group) or "; ".join(
            f"{head}{when}{': ' * bool(when)}{_values(e.parameters)}{p}"
            for head, e, p in zip(heads, group, alone, strict=True) for when in [wording.onset(e)])
        out.append(f"{wording.name_of(record, group[0].called, on)}: {sizes}"
                   + ("." if alone[0] else f"; {chances[0]}."))
        out += [f"  {head}{_values(e.derived)}"
                + (f" at mid-stroke ({number(at.value)} {at.unit})." if at else ".")
                for head, e in zip(heads, group, strict=True) if e.derived
                for at in [e.mid_stroke]]
        out += [f"  {line[0].upper() if line.startswith('the ') else line[0]}{line[1:]}"
                for line in wording.side(group)]
        if others := wording.rivals(record, group[0]):
            out.append(
                f"  Cannot be told from: {abbreviate_list(others, 'effects.csv', joint='; ')}.")
    return out


def _suspected(result: Diagnosis) -> list[str]:
    names = [f"{c.hypothesis.label} ({wording.probable(c.probability)})"
             for c in sorted(result.suspected, key=lambda c: -c.probability)]
    return [f"Suspected: {abbreviate_list(names, 'effects.csv')}."] if names else []


def _left(result: Diagnosis) -> list[str]:
    """Return what is left, where that is more than noise."""
    left = result.remainder
    if left.adequate or result.unknown:
        return []
    return [f"What is left is {left.ratio:.2f} times the {left.source} noise."]


def _values(values: Mapping[str, EffectValue]) -> str:
    """Return ``width 0.02 +- 0.001 mm`` of all values that have an uncertainty."""
    return ", ".join(
        f"{name.removesuffix('_mid_stroke')} {number(v.value * f)} "
        f"+- {number(v.half * f, 2)} {unit}".rstrip()
        for name, v in values.items() if v.half is not None and v.value is not None
        for f, unit in [rate(v.unit, v.value)])


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult(Result):
    """What the model misses, with the model that has it.

    Attributes:
        diagnosis: everything, SI: verdict, named effects, gap on held-out poses, rivals.
        png: whether the pictures are saved as PNG too.
    """

    COMMAND: ClassVar[str] = "diagnose"
    TABLE: ClassVar[str] = "effects.csv"

    diagnosis: Diagnosis
    png: bool = False

    @property
    def verdict(self) -> str:
        """``none``, ``named``, ``named-set``, ``partial`` or ``unnamed``."""
        return self.diagnosis.verdict

    @property
    def mechanism(self) -> Mechanism:
        """The machine with the effects that were found, identified."""
        return self.diagnosis.identification.mechanism

    @property
    def identification(self) -> Identification:
        """The fit of that machine."""
        return self.diagnosis.identification

    @property
    def readings(self) -> Readings:
        """The machine under each other set of effects, and without effects."""
        others = self.diagnosis.others
        bare = [r.mechanism for r in others if r.bare]
        return Readings(tuple(r for r in others if not r.bare), bare[-1] if bare else None)

    @cached_property
    def record(self) -> DiagnosisRecord:
        """The content of diagnosis.json, file units."""
        return DiagnosisRecord.of(self.diagnosis, self.provenance)

    @cached_property
    def fit_record(self) -> IdentificationRecord:
        """The content of identification.json, of the fit with the effects, file units."""
        return IdentificationRecord.of(self.identification, self.provenance, "prior")

    def files(self) -> Mapping[str, Content]:
        """Return model.yaml, effects.csv, residuals.csv, diagnosis.json, ... and pictures."""
        from ppmcal.report.figure_files import diagnosis_files

        return {**files(self.diagnosis, self.record, self.fit_record),
                **diagnosis_files(self.record, self.png)}

    def remarks(self) -> Sequence[str]:
        """Return the verdict, a finding unless it is none or named, and the findings."""
        sound = self.verdict in ("none", "named") and not self.record.unused
        level = NOTE if sound else FINDING
        return [Note(self.headline(), level), *self.findings]

    @property
    def warnings(self) -> list[str]:
        """What needs a look."""
        told = about(self.record.findings, (UNUSED,))     # by the headline
        return [f for f in self.record.findings if f not in told]

    def told(self) -> Iterator[Told]:
        """Yield the verdict, what was found and how sure it is, and what to measure next."""
        return told(self.diagnosis, self.record)

    def quantities(self) -> Iterator[CampaignQuantity]:
        """Yield those of the fit, and of the effects."""
        yield from fit_quantities(self.fit_record)
        yield from effect_quantities(self.record)

    def headline(self) -> str:
        """Return the verdict with the effects that are named."""
        return wording.headline(self.record)


def run(asked: DiagnoseArguments) -> DiagnosisResult:
    """Find the physical effect that a model misses, name it and add it."""
    kinds, holdout, seed = asked.kinds, asked.holdout, asked.seed
    refuse_unknown("effect", kinds, [*effect_kinds(), GEOMETRY], "--kind")
    if not 0.0 <= holdout <= 0.9:
        raise BadInput(f"{holdout:g} is not a fraction of the poses", "--holdout", "Give 0 to 0.9")
    machine, datasets = prepared(asked.mechanism, asked.data, asked.free)
    if asked.leave_out and len(session_masks(datasets)) < 2:
        raise one_session()
    problem = Problem(machine, datasets, machine.free)
    with with_unit_findings(machine, datasets) as units:
        start_stage("comparing the measurements with the nominal machine")
        refuse_before_fit(problem, every_column=True)
        extra = list[Note]()
        problem, choice = secondary(
            FREEDOMS, partial(with_chosen_freedoms, problem, FitOptions(),
                              [d.estimated for d in datasets]), (problem, None), extra)
        found, told = diagnose_with_own_noise(problem, DiagnosisOptions(
            0.0 if asked.leave_out else holdout, seed, tuple(kinds) or None,
            by_session=bool(asked.leave_out),
            held=tuple(machine.names[p] for p in set(machine.free) - set(problem.free))))
    for line in (*told, *([choice_sentence(choice)] if choice else [])):
        note(line)
    start_stage("judging the campaign")
    fit = found.identification.fit
    filed = as_filed(fit.problem.datasets, datasets)
    campaign = secondary(MISSING, lambda: weak_campaign(fit, seed), None, extra)
    also = partial(said_beside, extra)
    beside = [*also(PATTERN, lambda: left_over(found.before, seed)),
              *also(TOLERATED, lambda: noise_beyond_tolerances(fit, [d.estimated for d in filed])),
              *also(APART, lambda: pulled_apart(fit, filed))]
    found = replace(found, findings=(
        *unused_sentences(fit), *units, *beside, *found.findings, *extra),
                    identification=replace(found.identification, campaign=campaign))
    found = replace(found, proposal=with_poses(found.proposal, campaign))
    source = source_of("diagnose", [*machine.inputs, *data_files(datasets)], seed)
    return DiagnosisResult(source, tuple(found.findings), found, asked.png)


def as_filed(fitted: Sequence[Dataset], files: Sequence[Dataset]) -> list[Dataset]:
    """Return the file that each data set of a fit is of, or is a session of."""
    own = {data.name: data for data in files}
    return [own[data.name if data.name in own else data.entire.name] for data in fitted]


def when_refused(error: PpmcalError, asked: DiagnoseArguments, folder: Path | None
                 ) -> Refusal | None:
    """Write diagnosis.json with how files are to be read, where they were read wrongly."""
    if not isinstance(error, InterpretationError) or not error.found or folder is None:
        return None
    machine, datasets = prepared(asked.mechanism, asked.data)
    record = DiagnosisRecord(
        format=DiagnosisRecord.FORMAT, name=machine.name, verdict="misread",
        misreadings=misreading_entries(error.found, machine.units), effects=(), localised=(),
        not_testable=(), follows=None, p_value=None,
        gap=HeldOutGap(noise=1.0, before=None, after=None, closed=None, interval=None),
        next_reason="Correct how the file is read, then diagnose again.", next_file=None,
        findings=tuple(f"{m.source}: {interpretation_sentence(m, machine.units)}."
                       for m in error.found), units=machine.units,
        provenance=Provenance(**source_of(
            "diagnose", [*machine.inputs, *data_files(datasets)], asked.seed)))
    current().source.update(encoded(record.provenance))
    output = Output(folder)
    output.add(record.FILE, record.text())
    output.write()
    return Refusal(record.entries(), (record.FILE,))
