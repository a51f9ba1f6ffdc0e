"""The section about a diagnosis: verdict in words, effects, pictures, what to do next."""

from __future__ import annotations

from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect
from ppmcal.io.results.diagnosis_wording import (
    actuators,
    effect_name,
    gap_closed,
    headline,
    imitated,
    learned,
    learned_gap,
    name_of,
    next_step,
    own_values,
    rivals,
    stages,
    survives,
    together,
    tried_sets,
    unconfirmed,
    worst_block,
)
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.diagnosis_format import amounts, in_unit, odds_to
from ppmcal.report.format import number, probability, sig
from ppmcal.report.html import Cell, amount, bullets, dotted, figures, paragraph, table, words
from ppmcal.report.records import Diagnosed
from ppmcal.report.residual_figures import residual_figures
from ppmcal.report.validation import days
from ppmcal.wording import where


def diagnosis_section(d: Diagnosed) -> str:
    """Return everything about one diagnosis."""
    r = d.record
    out = ["<h2>Diagnosis</h2>", _lead(r), _days(r), _effects(r), _suspects(r),
           _remainder(r), _learned(r), _pictures(r), _swallowed(r), _places(r), _untestable(r),
           _next(r), _findings(r)]
    return "".join(out) + figures(residual_figures(d.residuals, r.units))


def _pictures(r: DiagnosisRecord) -> str:
    """Return the pictures, in columns."""
    return figures([p for some in pictures(r).values() for p in some], "diagnosis")


def _lead(r: DiagnosisRecord) -> str:
    text = paragraph(headline(r), "big")
    facts = [stages(r), gap_closed(r), worst_block(r)]
    if r.confirmed is False and r.effects:
        facts.append(unconfirmed(r))
    return text + paragraph(" ".join(f for f in facts if f))


def _days(r: DiagnosisRecord) -> str:
    """Return how each session is predicted from the others."""
    head = "<h3>Each session, predicted by a fit of the others</h3>" if r.validation else ""
    return head + days(r.validation)


def _effects(r: DiagnosisRecord) -> str:
    """Return the effects that the diagnosis names, one row for each of their parameters."""
    rows: list[list[Cell]] = []
    for group in together(r):
        one = own_values(r, group).replace("+-", "±")
        # values of one hypothesis are one line
        for some in [group] if one else [[e] for e in group]:
            e, on = some[0], [a for e in some for a in e.on]
            survival = number(e.survival)
            own = one or "; ".join(f"{name} {text}".strip()
                                   for name, text in amounts(e) or [("", "–")])
            rows.append([
                words(e.kind), words(where(on, actuators(r)) or "machine"), words(own, "wrap"),
                amount(e.p_value, probability(e.p_value) or "–"),
                amount(survival, "–" if survival is None else f"{survival:.0%}".replace("%", " %")),
                words(_rivals(r, e), "wrap")])
    stand = [f"{effect_name(r, g[0])}: {text}" for g in together(r) if (text := survives(g[0]))]
    told = bullets(stand) + paragraph(tried_sets(r))
    if not rows:
        return told
    return table("What is missing in the model, with 95 % intervals; visible: the part that "
                 "geometry cannot imitate",
                 ["effect", "on", "size ± 95 %", "chance of noise alone", "visible",
                  "cannot be told from"], rows) + told


def _rivals(r: DiagnosisRecord, e: DiagnosedEffect) -> str:
    names = rivals(r, e)
    odds = [number(o) for o in e.odds]
    odds += [None] * (len(names) - len(odds))
    return "; ".join(n if o is None else f"{n} (odds {odds_to(o)} to 1 against it)"
                     for n, o in zip(names, odds, strict=False)) or "nothing else"


def _suspects(r: DiagnosisRecord) -> str:
    """Return what may be there but cannot be named."""
    lines = []
    for e in r.possible:
        p = probability(e.p_value)
        why = {"imitation": "explains part of it, but is probably only an imitation",
               "consistent": "consistent with it, but would not stand if the rest were explained"
               }.get(e.status, "suspected, too weak to be named")
        lines.append(f"{name_of(r, e.kind, e.on)}: {why}" + (f" ({p})." if p else "."))
    return bullets(lines)


def _remainder(r: DiagnosisRecord) -> str:
    """Return what is left after all that was named."""
    rest = r.remainder
    ratio = number(rest.rms_ratio)
    which = f"{rest.noise_reference} " if rest.noise_reference else ""
    text = "" if ratio is None else (
        f"In the rows used, residuals are {sig(ratio)} times the {which}noise "
        f"{'with what is named' if r.effects else 'with geometry alone'}. ")
    if rest.follows:
        p = probability(rest.p_value)
        text += f"What is left follows {rest.follows}" + (f" ({p})." if p else ".")
    elif ratio is not None:
        text += "What is left follows nothing that was recorded."
    return paragraph(text)


def _learned(r: DiagnosisRecord) -> str:
    """Return the shapes that were learned from what is left."""
    return bullets([*learned(r), learned_gap(r)]) if r.learned else ""


def _swallowed(r: DiagnosisRecord) -> str:
    """Return the parameters that had moved to imitate an effect."""
    rows = [[dotted(s.name), *(amount(v, in_unit(v, s.unit))
                               for v in (s.before, s.after, s.tolerance))] for s in r.swallowed]
    if not rows:
        return ""
    return ("<h3>Geometry that had imitated the effect</h3>"
            + paragraph(f"{imitated(r)} Their errors from nominal:", "note")
            + table("", ["parameter", "error without effects", "error with effects", "tolerance"],
                    rows, sort=True))


def _places(r: DiagnosisRecord) -> str:
    """Return where residuals exceed what noise gives there."""
    rows = [[words(p.by), words(p.value), amount(p.rms_ratio), amount(p.rms_ratio_after),
             amount(p.p_value, probability(p.p_value) or "–")] for p in r.localised]
    if not rows:
        return ""
    body = table("rms of the residuals of that group over what noise gives in it; p: how often "
                 "noise alone gives more before",
                 ["by", "group", "before", "after", "chance of noise alone"], rows, sort=True)
    return f"<details><summary>Where the residuals are, group by group</summary>{body}</details>"


def _untestable(r: DiagnosisRecord) -> str:
    """Return the kinds of effect that could not be tested, and the columns they lack."""
    rows = [[words(u.kind), words(", ".join(u.missing) or u.reason, "wrap")]
            for u in r.not_testable]
    return table("Not testable: record these columns to test for the effect",
                 ["effect", "columns missing"], rows)


def _next(r: DiagnosisRecord) -> str:
    """Return what to measure next."""
    text = next_step(r)
    return "<h3>Measure next</h3>" + paragraph(text[:1].upper() + text[1:]) if text else ""


def _findings(r: DiagnosisRecord) -> str:
    return "<h3>Findings</h3>" + bullets(r.findings) if r.findings else ""
