"""The page's first three lines: is it calibrated, how accurate and how sure, what next."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ppmcal.calibration.fit import LARGER
from ppmcal.calibration.knowledge import FAR, FAR_BECAUSE
from ppmcal.io.results import diagnosis_wording as wording
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_parts import Summaries
from ppmcal.io.results.identification_wording import noise_verdict, noise_words
from ppmcal.io.results.parts import ErrorChange, ErrorSize
from ppmcal.io.results.simulation import ComparedMachines
from ppmcal.model.instruments import find_instrument
from ppmcal.report.html import count, typeset, whole, with_unit
from ppmcal.report.records import Diagnosed, Identified, ReportData
from ppmcal.store.provenance import Provenance
from ppmcal.wording import abbreviate_list

IN_THE_FIT = "in the fit"


def figure(one: Identified, stage: str, kind: str) -> ErrorSize:
    """Return the errors of one stage (before, after, holdout) and kind, an empty one if missing."""
    found: Summaries = getattr(one.record.residual, stage)
    return found.get(kind) or ErrorSize()


def main_kind(one: Identified) -> str:
    """Return the kind of error to head the page with: position if there is one."""
    kinds = ("position", "rotation", *one.record.residual.after)
    return next((k for k in kinds if figure(one, "after", k).rms is not None), "")


def accuracy(one: Identified, data: ReportData) -> str:
    """Return the error to expect of poses that no fit has seen, where it is known, else in the fit.

    Empty where neither is known.
    """
    kind = main_kind(one)
    before, after = (figure(one, s, kind).rms for s in ("before", "after"))
    if after is None:
        return ""
    unit = figure(one, "after", kind).unit
    more = [f"{with_unit(before, unit)} before"] if before is not None else []
    first, where = unseen(one, kind, data) or (with_unit(after, unit), IN_THE_FIT)
    if where != IN_THE_FIT:
        more.append(f"{with_unit(after, unit)} {IN_THE_FIT}")
    return f"rms {kind} error {first} {where}" + (f" ({', '.join(more)})" if more else "")


def unseen(one: Identified, kind: str, data: ReportData) -> tuple[str, str] | None:
    """Return the error with its unit, and of what it is: of poses kept out, else of other data.

    Else what is promised of commands; None where nothing of these is there.
    """
    held = figure(one, "holdout", kind)
    if held.rms is not None:
        kept = "poses" if held.count is None else count(held.count, "row")
        return with_unit(held.rms, held.unit), f"on {kept} kept out of the fit"
    for v in data.validated:
        for day in v.record.datasets if _is_of(one, v.record.provenance) else ():
            size = getattr(day.errors[0], kind, None) if day.errors else None
            if size is not None and size.rms is not None:
                return with_unit(size.rms, size.unit), f"on {day.name}, which no fit has seen"
    for c in data.compensated:
        if _is_of(one, c.record.provenance):
            promised = c.record.predicted.get(kind, ErrorChange())
            if promised.after is not None:
                return (with_unit(promised.after, promised.unit),
                        f"promised for {count(c.record.rows or 0, 'target')}")
    return None


def _is_of(one: Identified, provenance: Provenance) -> bool:
    """Whether a result was made with the machine in the folder of an identification."""
    return any(Path(name).absolute().parent == Path(one.folder).absolute()
               for name in provenance.inputs)


def headline(one: Identified, data: ReportData) -> list[str]:
    """Return one or two sentences about an identification; none where a diagnosis says them."""
    if one.diagnosed:
        return []
    rows = sum(d.rows or 0 for d in one.record.datasets)
    used = sum(d.used or 0 for d in one.record.datasets)
    names = abbreviate_list([d.name for d in one.record.datasets if d.name])
    source = f" from {whole(used)} of {whole(rows)} measurements" if rows else ""
    source += f" ({names})" if source and names else ""
    first = f"{one.name} was calibrated{source}"
    out = [": ".join(filter(None, (first, accuracy(one, data)))) + "."]
    verdict, _ = noise_verdict(one.record.noise)
    if verdict:
        out.append(typeset(verdict[0].upper() + verdict[1:] + "."))
    return out


def finding_text(entry: Any) -> str:
    """Return a finding as one sentence, whatever form it has."""
    if isinstance(entry, Mapping):
        place = entry.get("where") or entry.get("place") or entry.get("file") or ""
        what = entry.get("what") or entry.get("text") or entry.get("message") or entry.get(
            "finding") or ", ".join(f"{k}: {v}" for k, v in entry.items())
        parts = [f"{place}: {what}" if place else str(what), str(entry.get("mend") or "")]
        return " ".join(p for p in parts if p)
    return str(entry)


def other_machine(c: ComparedMachines) -> str:
    """Return that the model is not the machine simulated, empty where it is."""
    many = len(c.other)
    return (f"the model identified is not the machine simulated: {count(many, 'nominal value')} "
            f"{'differs' if many == 1 else 'differ'} ({abbreviate_list(c.other)}); true errors "
            "count from the model's own nominal values, which its tolerances may not allow for"
            ) if many else ""


State = Literal["ok", "warn", "bad"]
AFTER_A_CHECK = "After a check"
MOST = 4
"""So many machines have lines of their own."""
SETTLED = ("none", "named", "")
"""Verdicts of a diagnosis after which nothing is open."""


@dataclass(frozen=True)
class Line:
    """A question, its answer as a word and a sentence, and how good that is."""

    question: str
    word: str
    text: str
    state: State


@dataclass(frozen=True)
class Verdict:
    """Three lines about one machine; ``of`` names it where there are several."""

    of: str
    lines: tuple[Line, ...]


def verdicts(data: ReportData) -> list[Verdict]:
    """Return the verdict on each machine: on its last calibration, and its last diagnosis.

    Of one campaign that is the calibration with the effects which its diagnosis names, in
    whichever order the folders were given.
    """
    found: dict[str, tuple[Identified, DiagnosisRecord | None]] = {}
    by_folder = {d.folder: d for d in data.diagnosed}
    for one in data.identified:
        if one.name in found and one.folder not in by_folder:
            then = found[one.name][0]
            if then.folder in by_folder and _inputs(then.record) == _inputs(one.record) != set():
                continue
        found[one.name] = one, _diagnosis(one, by_folder, data.diagnosed)
    several = len(found) > 1
    out = []
    for name, (one, d) in list(found.items())[:MOST]:
        good = _calibrated(one, d, _accuracy(one, d, data))
        out.append(Verdict(name * several, (
            good, _certainty(one, d), _next(one, d, good, data.use))))
    return out


def _accuracy(one: Identified, d: DiagnosisRecord | None, data: ReportData) -> str:
    """Return how accurate the machine is, what no fit has seen first."""
    text = accuracy(one, data)
    told = d is not None and not unseen(one, main_kind(one), data) and wording.left_out_error(d)
    text = f"{told}; {text}" if told else text
    return text[:1].upper() + text[1:]


def _diagnosis(one: Identified, by_folder: dict[str, Diagnosed], every: Sequence[Diagnosed]
               ) -> DiagnosisRecord | None:
    """Return the diagnosis of an identification: of its folder, else of its measurements."""
    if one.folder in by_folder:
        return by_folder[one.folder].record
    own = _inputs(one.record)
    same = [d.record for d in every if own and own == _inputs(d.record)]
    return same[-1] if same else None


def _inputs(record: IdentificationRecord | DiagnosisRecord) -> set[str]:
    """Return the digests of the files that a result is of."""
    return set(record.provenance.inputs.values()) - {""}


def _calibrated(one: Identified, d: DiagnosisRecord | None, text: str) -> Line:
    """Return whether the machine is calibrated; ``text``: by how much."""
    r, kind = one.record, main_kind(one)
    before, after = (figure(one, s, kind) for s in ("before", "after"))
    if after.rms is None:
        return Line("Calibrated?", "Not known", "The folder does not say what is left.", "warn")
    noisy = r.noise.state == LARGER
    if before.rms is not None and after.rms > before.rms:
        return Line("Calibrated?", "No", f"{text}: it rose.", "bad")
    if r.converged is False:
        return Line("Calibrated?", "No", f"{text}; the fit had not converged.", "bad")
    if r.campaign is not None:
        return Line("Calibrated?", "In part", f"{text}; these poses cannot tell all of it.", "warn")
    if d is not None and d.verdict == "named-set" and not noisy:
        return Line("Calibrated?", "Yes, cause open", f"{text}; more than one explanation "
                    "remains of what geometry does not explain.", "warn")
    if noisy or (d is not None and d.verdict not in SETTLED):
        return Line("Calibrated?", "Not fully", f"{text}; unmodelled residuals remain.", "warn")
    if r.far:
        return Line("Calibrated?", AFTER_A_CHECK, f"{text}; {FAR}: "
                    f"{abbreviate_list([p.name for p in r.far])}.", "warn")
    return Line("Calibrated?", "Yes", f"{text}.", "ok")


def _certainty(one: Identified, d: DiagnosisRecord | None) -> Line:
    """Return what speaks for it: noise, what unseen poses say, what cannot be identified."""
    r = one.record
    words, fine = noise_words(r.noise), noise_verdict(r.noise)[1]
    parts = [typeset(words)] if words else []    # what that means is among the findings
    if r.noise.tight:
        parts.append("the errors are larger than the tolerances allow")
    if d is not None and d.effects:
        parts += filter(None, [wording.cause_probability(d), wording.gap_closed(d).rstrip(".")])
    if r.redundant:
        parts.append(f"{count(len(r.redundant), 'redundant combination')} of "
                     f"{count(len(r.free), 'parameter')}; predictions are unaffected")
    weak = [p for p in r.parameters if p.disagree]
    if weak:
        parts.append(f"sessions disagree on {count(len(weak), 'parameter')}")
    size = _size(one)
    parts += [size] if size else []
    text = "; ".join((p[:1].lower() if i else p[:1].upper()) + p[1:] for i, p in enumerate(parts))
    sure = fine and not r.noise.tight and not weak and not size and (
        d is None or (d.verdict in SETTLED and (d.confirmed is not False or not d.effects)))
    if not parts:
        return Line("How sure?", "Not known", "The folder does not hold a check of the noise.",
                    "warn")
    return Line("How sure?", "Sure" if sure else "With doubts", f"{text}.",
                "ok" if sure else "warn")


def _size(one: Identified) -> str:
    """Return what the machine's size rests on where that is little, else nothing."""
    scale = one.record.scale
    kinds = [find_instrument(d.kind) for d in one.record.datasets]
    if scale is not None and scale.open and (
            scale.prior_dominated or not math.isfinite(scale.sigma)):
        return "how large the machine is rests on tolerances, not on these data"
    if any(k.along_line for k in kinds) and all(k.scalar for k in kinds):
        return ("how large the machine is rests on the measured distances alone: rods and the "
                "scale of distances are one direction")
    return ""


def to_compensate(folder: str) -> str:
    """Return how commands are corrected with the model of a folder."""
    return f"ppmcal compensate {folder} TARGETS.csv corrects commands"


def _next(one: Identified, d: DiagnosisRecord | None, good: Line, use: Callable[[str], str]
          ) -> Line:
    """Return what to do now.

    ``good``: whether it is calibrated; ``use``: what to do with a folder's model, if so.
    """
    if d is not None and d.next_file:
        return Line("Next?", "Measure", wording.next_step(d), "warn")
    if one.record.campaign is not None:
        poses = count(one.record.campaign.poses, "more pose")
        return Line("Next?", "Measure", f"{poses}, listed in next.csv, would tell the rest.",
                    "warn")
    if good.state == "ok":
        told = use(one.folder) or to_compensate(one.folder)
        return Line("Next?", "Use it", f"{told}; ppmcal validate tells on another day whether it "
                    "still holds.", "ok")
    if good.word == AFTER_A_CHECK:
        return Line("Next?", "Check", f"{FAR_BECAUSE.capitalize()}; which, only the machine can "
                    "tell. Commands and controller numbers of this model are for after that check.",
                    "warn")
    if d is None:
        return Line("Next?", "Diagnose", "ppmcal diagnose MODEL DATA finds which effect is "
                    "missing.", "warn")
    words = wording.next_step(d)
    words = words[:1].upper() + words[1:] or f"{wording.headline(d)} See below."
    return Line("Next?", "Look closer", words, "warn")
