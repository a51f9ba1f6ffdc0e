"""The section about a diagnosis: verdict in words, effects, pictures, what to do next."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

from ppmcal.io.results.record import UnitNames
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.diagnosis_wording import (
    actuators,
    amounts,
    effect_name,
    gap_closed,
    headline,
    in_unit,
    odds_to,
    rivals,
)
from ppmcal.report.format import count, number, probability, sig
from ppmcal.report.headlines import finding_text
from ppmcal.report.html import Cell, amount, bullets, dotted, paragraph, table, words
from ppmcal.report.records import Diagnosed
from ppmcal.report.residual_figures import residual_figures
from ppmcal.report.svg_bars import BarPicture
from ppmcal.wording import where

Record = Mapping[str, Any]


def diagnosis_section(d: Diagnosed) -> str:
    """Return everything about one diagnosis."""
    r = d.record
    out = ["<h2>Diagnosis</h2>", _lead(r), _effects(r), _suspects(r), _remainder(r), _story(r),
           _swallowed(r), _places(r), _untestable(r), _next(r), _findings(r)]
    if d.residuals is not None:
        drawings = residual_figures(d.residuals, UnitNames.model_validate(r.get("units") or {}))
        out.append(f'<div class="plots">{"".join(drawings)}</div>' if drawings else "")
    return "".join(out)


def _story(r: Record) -> str:
    """Return the pictures, in columns."""
    drawings = "".join(_figure(p) for some in pictures(r).values() for p in some)
    return f'<div class="story">{drawings}</div>' if drawings else ""


def _figure(picture: BarPicture) -> str:
    key = f' <span class="legend">{picture.key}</span>.' if picture.key else ""
    return (f"<figure>{picture.document()}<figcaption><b>{escape(picture.title)}.</b>{key} "
            f"{escape(picture.caption)}</figcaption></figure>")


def _lead(r: Record) -> str:
    text = paragraph(headline(r), "big")
    facts = [gap_closed(r)]
    if r.get("confirmed") is False and r.get("effects"):
        facts.append("The held-out poses alone do not prove the improvement.")
    return text + paragraph(" ".join(f for f in facts if f))


def _effects(r: Record) -> str:
    """Return the effects that the diagnosis names, one row for each of their parameters."""
    rows: list[list[Cell]] = []
    for e in r.get("effects") or []:
        survival = number(e.get("survival"))
        values = amounts(e) or [("", "–")]
        own = "\n".join(f"{name} {text}".strip() for name, text in values)
        rows.append([
            words(e.get("kind")), words(where(e.get("on") or [], actuators(r)) or "machine"),
            words(own.replace("\n", "; "), "wrap"),
            amount(e.get("p_value"), probability(e.get("p_value")) or "–"),
            amount(survival, "–" if survival is None else f"{survival:.0%}".replace("%", " %")),
            words(_rivals(r, e), "wrap")])
    return table("What is missing in the model, with 95 % intervals; visible: the part that "
                 "geometry cannot imitate",
                 ["effect", "on", "size ± 95 %", "chance of noise alone", "visible",
                  "cannot be told from"], rows)


def _rivals(r: Record, e: Record) -> str:
    names = rivals(r, e)
    odds = [number(o) for o in e.get("odds") or []]
    odds += [None] * (len(names) - len(odds))
    return "; ".join(n if o is None else f"{n} (odds {odds_to(o)} to 1 against it)"
                     for n, o in zip(names, odds, strict=False)) or "nothing else"


def _suspects(r: Record) -> str:
    """Return what may be there but cannot be named."""
    lines = []
    for e in r.get("possible") or []:
        p = probability(e.get("p_value"))
        why = ("explains part of it, but is probably only an imitation"
               if e.get("status") == "imitation" else "suspected, too weak to be named")
        lines.append(f"{effect_name(r, e)}: {why}" + (f" ({p})." if p else "."))
    return bullets(lines)


def _remainder(r: Record) -> str:
    """Return what is left after all that was named."""
    rest = r.get("remainder") or {}
    ratio, follows = number(rest.get("rms_ratio")), rest.get("follows")
    source = rest.get("noise_reference")
    which = f"{source} " if source else ""
    text = "" if ratio is None else (
        f"In the rows used, residuals are {sig(ratio)} times the {which}noise "
        f"{'with what is named' if r.get('effects') else 'with geometry alone'}. ")
    if follows:
        p = probability(rest.get("p_value"))
        text += f"What is left follows {follows}" + (f" ({p})." if p else ".")
    elif ratio is not None:
        text += "What is left follows nothing that was recorded."
    return paragraph(text)


def _swallowed(r: Record) -> str:
    """Return the parameters that had moved to imitate an effect."""
    rows = []
    for s in r.get("swallowed") or []:
        unit = str(s.get("unit") or "")
        rows.append([dotted(s.get("name")),
                     *(amount(s.get(k), in_unit(s.get(k), unit))
                       for k in ("before", "after", "tolerance"))])
    if not rows:
        return ""
    return ("<h3>Geometry that had imitated the effect</h3>" + paragraph(
        f"{count(len(rows), 'parameter')} had moved by more than the tolerance to make up for "
        "what was missing; these are their errors from nominal without and with the effects.",
        "note") + table("", ["parameter", "error without effects", "error with effects",
                             "tolerance"], rows, sort=True))


def _places(r: Record) -> str:
    """Return where residuals exceed what noise gives there."""
    rows = []
    for e in r.get("localised") or []:
        rows.append([words(e.get("by")), words(e.get("value")), amount(e.get("rms_ratio")),
                     amount(e.get("rms_ratio_after")),
                     amount(e.get("p_value"), probability(e.get("p_value")) or "–")])
    if not rows:
        return ""
    body = table("rms of the residuals of that group over what noise gives in it; p: how often "
                 "noise alone gives more before",
                 ["by", "group", "before", "after", "chance of noise alone"], rows, sort=True)
    return f"<details><summary>Where the residuals are, group by group</summary>{body}</details>"


def _untestable(r: Record) -> str:
    """Return the kinds of effect that could not be tested, and the columns they lack."""
    rows = [[words(e.get("kind")), words(", ".join(str(m) for m in e.get("missing") or []) or
                                         str(e.get("reason") or ""), "wrap")]
            for e in r.get("not_testable") or []]
    return table("Not testable: record these columns to test for the effect",
                 ["effect", "columns missing"], rows)


def _next(r: Record) -> str:
    """Return what to measure next."""
    wanted = r.get("next_measurements") or {}
    reason, file, rows = wanted.get("reason"), wanted.get("file"), number(wanted.get("rows"))
    if not reason and not file:
        return ""
    text = str(reason or "").rstrip(".")
    text = f"{text[:1].upper()}{text[1:]}." if text else ""
    if file:
        much = f" ({count(int(rows), 'row')})" if rows else ""
        text += f" They are in {file}{much}."
    before, after = number(wanted.get("odds_before")), number(wanted.get("odds_after"))
    if file and before and after:
        text += (f" The odds between the rivals are {odds_to(before)} to 1 now and should be "
                 f"about {odds_to(after)} to 1 then.")
    return "<h3>Measure next</h3>" + paragraph(text.strip())


def _findings(r: Record) -> str:
    lines = [finding_text(f) for f in r.get("findings") or []]
    return "<h3>Findings</h3>" + bullets(lines) if lines else ""
