"""The section about a diagnosis: verdict in words, effects, pictures, what to do next."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

from ppmcal.io.results import diagnosis_wording as wording
from ppmcal.io.results.diagnosis import EFFECT_TABLE, DiagnosisRecord
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect
from ppmcal.io.results.identification_tables import NEXT_TABLE, RESIDUAL_TABLE
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.diagnosis_tables import amounts, in_unit, ladder, next_poses, odds_to, tried
from ppmcal.report.html import (
    Cell,
    bullets,
    count,
    figures,
    name_cell,
    number,
    number_cell,
    paragraph,
    probability,
    sig,
    table,
    text_cell,
)
from ppmcal.report.identified import calibration, is_fit
from ppmcal.report.records import Diagnosed, ReportData
from ppmcal.report.residual_figures import coordinate_figures, residual_figures
from ppmcal.report.rows import DataRows
from ppmcal.report.section import Chapter, Folder, Kind, Section, filled
from ppmcal.report.validation import days, misled
from ppmcal.report.validation import drawings as of_days
from ppmcal.wording import actuator_list


def drawings(d: Diagnosed) -> dict[str, list[Drawing]]:
    """Return the pictures of a diagnosis."""
    r = d.record
    rows = None if d.residuals is None else DataRows(d.folder, d.residuals, r.units)
    return {**pictures(r), "days": of_days(r.validation),
            "residuals": residual_figures(rows), "coordinates": coordinate_figures(rows)}


def diagnosis_section(d: Diagnosed) -> Section:
    """Return the chapter about one diagnosis: the gap, what closes it, and what was refused."""
    r, drawn = d.record, drawings(d)
    shown = [p for name in ("inputs", "actuators", "terms") for p in drawn.get(name, ())]
    told = bullets([*wording.learned(r), wording.learned_gap(r)]) if r.learned else ""
    body = (_lead(r) + '<div class="story">' + figures(drawn.get("gap", []))
            + f"<div>{ladder(r)}{_remainder(r)}{told}</div></div>{_effects(r)}")
    return Section("The missing effect", body, d.folder, parts=filled([
        Section("What the residuals follow, before and after", figures(shown)),
        Section("What these data cannot tell apart", figures(drawn.get("alternatives", []))),
        Section("Each session, predicted by a fit of the others", days(r.validation) or "".join(
            paragraph(t) for t in wording.another_day(r))),
        _next(d), _refused(d), _absorbed(r), _places(r),
        Section("Residuals", figures([*drawn["residuals"], *drawn["coordinates"]]), folded=True),
        Section("Findings", bullets(r.findings) if r.findings else "")]))


def _lead(r: DiagnosisRecord) -> str:
    text = paragraph(wording.headline(r), "big")
    facts = [wording.stages(r), wording.gap_closed(r), wording.predicted(r)]
    if r.confirmed is False and r.effects:
        facts.append(wording.unconfirmed(r))
    return text + paragraph(" ".join(f for f in facts if f))


def _effects(r: DiagnosisRecord) -> str:
    """Return the effects that the diagnosis names, one row for each of their parameters."""
    rows: list[list[Cell]] = []
    for group in wording.together(r):
        one = wording.own_values(group).replace("+-", "±")
        # values of one hypothesis are one line
        for some in [group] if one else [[e] for e in group]:
            e, on = some[0], [a for e in some for a in e.on]
            visibility = number(e.visibility)
            own = one or "; ".join(f"{name} {text}".strip()
                                   for name, text in amounts(e) or [("", "–")])
            rows.append([
                text_cell(e.called),
                text_cell(actuator_list(on, wording.actuators(r)) or "machine"),
                text_cell(own, "wrap"),
                number_cell(e.p_value if e.probability is None else e.probability,
                            wording.probable(e.probability) or probability(e.p_value) or "–"),
                number_cell(visibility,
                            "–" if visibility is None else f"{visibility:.0%}".replace("%", " %")),
                text_cell(_rivals(r, e), "wrap")])
    sides = [f"{wording.effect_name(r, g[0]) if len(g) == 1 else g[0].called}: {text}"
             for g in wording.together(r) for text in wording.side(g)]
    told = bullets(sides) + paragraph(wording.unknown_causes(r)) + paragraph(wording.tried_sets(r))
    if not rows:
        return told
    return table("What is missing in the model, with 95 % intervals; visible: the part that "
                 "geometry cannot imitate",
                 ["effect", "on", "size ± 95 %", "probability", "visible",
                  "cannot be told from"], rows) + told


def _rivals(r: DiagnosisRecord, e: DiagnosedEffect) -> str:
    names = wording.rivals(r, e)
    odds = [number(o) for o in e.odds]
    odds += [None] * (len(names) - len(odds))
    return "; ".join(n if o is None else f"{n} (odds {odds_to(o)} to 1 against it)"
                     for n, o in zip(names, odds, strict=False)) or "nothing else"


def _refused(d: Diagnosed) -> Section:
    """Return what was tried and not named, and what could not be tried for want of columns."""
    r = d.record
    untestable = [[text_cell(u.kind), text_cell(", ".join(u.missing) or u.reason, "wrap")]
                  for u in r.not_testable]
    size = count(d.effects.size, "hypothesis", "hypotheses") if d.effects is not None else ""
    return Section("What was tried and refused", _suspects(r) + tried(d.effects)
                   + table("Not testable: record these columns to test for the effect",
                           ["effect", "columns missing"], untestable), size, folded=True)


def _suspects(r: DiagnosisRecord) -> str:
    """Return what may be there but cannot be named."""
    lines = []
    for e in r.suspected:
        p = wording.probable(e.probability)
        lines.append(f"{wording.name_of(r, e.called, e.on)}: suspected, too weak to be named"
                     + (f" ({p})." if p else "."))
    return bullets(lines)


def _remainder(r: DiagnosisRecord) -> str:
    """Return what is left after all that was named."""
    ratio = number(r.rms_ratio)
    which = f"{r.noise_reference} " if r.noise_reference else ""
    text = "" if ratio is None else (
        f"In the rows used, residuals are {sig(ratio)} times the {which}noise "
        f"{'with what is named' if r.effects else 'with geometry alone'}. ")
    if r.follows and not r.unknown:      # of an older version: now told with what is missing
        p = probability(r.p_value)
        text += f"What is left follows {r.follows}" + (f" ({p})." if p else ".")
    elif ratio is not None and not r.unknown:
        text += "What is left follows nothing that was recorded."
    return paragraph(text)


def _absorbed(r: DiagnosisRecord) -> Section | None:
    """Return the parameters that had moved to imitate an effect."""
    rows = [[name_cell(s.name), *(number_cell(v, in_unit(v, s.unit))
                                  for v in (s.before, s.after, s.tolerance))]
            for s in r.absorbed_by_geometry]
    if not rows:
        return None
    return Section(
        "Geometry that had imitated the effect",
        paragraph(f"{wording.confounded(r)} Their errors from nominal:", "note")
        + table("", ["parameter", "error without effects", "error with effects", "tolerance"],
                rows, sort=True), count(len(rows), "parameter"), folded=True)


def _places(r: DiagnosisRecord) -> Section | None:
    """Return where residuals exceed what noise gives there."""
    rows = [[text_cell(p.by), text_cell(p.value), number_cell(p.rms_ratio),
             number_cell(p.rms_ratio_after),
             number_cell(p.p_value, probability(p.p_value) or "–")] for p in r.localised]
    if not rows:
        return None
    body = table("rms of the residuals of that group over what noise gives in it; p: how often "
                 "noise alone gives more before",
                 ["by", "group", "before", "after", "chance of noise alone"], rows, sort=True)
    return Section("Where the residuals are, group by group", body, count(len(rows), "group"),
                   folded=True)


def _next(d: Diagnosed) -> Section | None:
    """Return what to measure next, and the poses for it."""
    text = wording.next_step(d.record)
    if not text:
        return None
    return Section("Measure next", paragraph(text[:1].upper() + text[1:]) + next_poses(d.next))


def _read(folder: Folder) -> Iterator[Diagnosed]:
    if folder.has("diagnosis.json", "effects.csv"):
        yield Diagnosed(folder.name, folder.record(DiagnosisRecord), folder.table(EFFECT_TABLE),
                        None if is_fit(folder) else folder.table(RESIDUAL_TABLE),
                        folder.table(NEXT_TABLE))


def _chapters(d: Diagnosed, data: ReportData) -> Iterator[Chapter]:
    """Yield a diagnosis, with the fit behind it."""
    yield f"Diagnosis in {d.folder}", partial(diagnosis_section, d)
    for one in data.identified:
        if one.diagnosed and one.folder == d.folder:
            yield calibration(one, data)


def _findings(d: Diagnosed, _: ReportData) -> list[tuple[str, str]]:
    r = d.record
    out = list(r.findings)
    if r.verdict not in ("", "none", "named"):
        out.append(f"Diagnosis: {wording.verdict(r)}")
    if r.confirmed is False and r.effects and not out:
        out.append(wording.unconfirmed(r))
    return [(d.folder, text) for text in (*out, *misled(r.validation))]


def _shown(d: Diagnosed, _: ReportData) -> dict[str, Any]:
    return {"folder": d.folder, "diagnosis": d.record.entries(),
            "candidates": [] if d.effects is None else EFFECT_TABLE.entries(d.effects)}


DIAGNOSE: Kind[Diagnosed] = Kind(
    "diagnosed", "diagnoses", "diagnosis", 30, ("diagnosis.json", "effects.csv"), _read, _chapters,
    _shown, lambda d: [("diagnose", d.record)], _findings,
    lambda d, _: drawings(d), lambda d, _: [wording.lead(d.record)])
