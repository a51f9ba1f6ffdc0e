"""The page's first three lines: is it calibrated, how sure is that, and what to do next."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from ppmcal.calibration.fit import LARGER
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import (
    cause_probability,
    gap_closed,
    left_out_error,
    next_step,
)
from ppmcal.io.results.diagnosis_wording import headline as diagnosis_headline
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_wording import noise_verdict
from ppmcal.model.instruments import find_instrument
from ppmcal.report.format import count, typeset
from ppmcal.report.headlines import accuracy, figure, main_kind, unseen
from ppmcal.report.records import Diagnosed, Identified, ReportData

State = Literal["ok", "warn", "bad"]
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
    return [Verdict(name * several, _lines(one, d, data))
            for name, (one, d) in list(found.items())[:MOST]]


def _accuracy(one: Identified, d: DiagnosisRecord | None, data: ReportData) -> str:
    """Return how accurate the machine is, what no fit has seen first."""
    text = accuracy(one, data)
    told = d is not None and not unseen(one, main_kind(one), data) and left_out_error(d)
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


def _lines(one: Identified, d: DiagnosisRecord | None, data: ReportData) -> tuple[Line, ...]:
    good = _calibrated(one, d, _accuracy(one, d, data))
    return good, _certainty(one, d), _next(one, d, good.state, data.use)


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
    return Line("Calibrated?", "Yes", f"{text}.", "ok")


def _certainty(one: Identified, d: DiagnosisRecord | None) -> Line:
    """Return what speaks for it: noise, what unseen poses say, what cannot be identified."""
    r = one.record
    words, fine = noise_verdict(r.noise)
    parts = [typeset(words)] if words else []
    if r.noise.tight:
        parts.append("the errors are larger than the tolerances allow")
    if d is not None and d.effects:
        parts += filter(None, [cause_probability(d), gap_closed(d).rstrip(".")])
    free = sum(p.status != "fixed" for p in r.parameters)
    if r.redundant:
        parts.append(f"{count(len(r.redundant), 'combination')} of {count(free, 'parameter')} "
                     "not determined by these poses; predictions are unaffected")
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
    scale = one.record.identifiability.scale
    kinds = [find_instrument(d.kind) for d in one.record.datasets]
    if scale is not None and scale.open and (scale.sigma is None or scale.prior_dominated):
        return "how large the machine is rests on tolerances, not on these data"
    if any(k.along_line for k in kinds) and all(k.scalar for k in kinds):
        return ("how large the machine is rests on the measured distances alone: rods and the "
                "scale of distances are one direction")
    return ""


def _next(one: Identified, d: DiagnosisRecord | None, state: State, use: Callable[[str], str]
          ) -> Line:
    """Return what to do now; ``use``: with a folder's model, where it is good."""
    if d is not None and d.next_file:
        return Line("Next?", "Measure", next_step(d), "warn")
    if one.record.campaign is not None:
        poses = count(one.record.campaign.poses, "more pose")
        return Line("Next?", "Measure", f"{poses}, listed in next.csv, would tell the rest.",
                    "warn")
    if state == "ok":
        told = use(one.folder) or f"ppmcal compensate {one.folder} TARGETS.csv corrects commands"
        return Line("Next?", "Use it", f"{told}; ppmcal validate tells on another day whether it "
                    "still holds.", "ok")
    if d is None:
        return Line("Next?", "Diagnose", "ppmcal diagnose MODEL DATA finds which effect is "
                    "missing.", "warn")
    words = next_step(d)
    words = words[:1].upper() + words[1:] or f"{diagnosis_headline(d)} See below."
    return Line("Next?", "Look closer", words, "warn")
