"""Sections about an identification: figures, parameters, residuals, excluded rows."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ppmcal.report.format import (
    NBSP,
    count,
    exact,
    number,
    probability,
    sig,
    to_sigma,
    whole,
    with_unit,
)
from ppmcal.report.headlines import figure, redundancy, tolerances
from ppmcal.report.html import (
    MAX_ROWS,
    Cell,
    amount,
    bullets,
    definitions,
    dotted,
    error_bar,
    paragraph,
    table,
    words,
)
from ppmcal.report.identifiability import blunder_section, told_section
from ppmcal.report.records import Identified
from ppmcal.report.residual_figures import residual_figures
from ppmcal.report.residuals import quantity_of, used

STAGES = (("before", "before"), ("after", "after"), ("holdout", "held out"))
COLUMNS = ("mean", "rms", "p95", "max")


def identified_section(one: Identified) -> str:
    """Return everything about one identification below the headline."""
    units = {str(p.get("name")): str(p.get("unit") or "") for p in one.parameters}
    return "".join([accuracy(one), parameters(one), redundant(one), correlations(one),
                    told_section(one.record), plots(one), excluded(one),
                    blunder_section(one.record, units)])


def accuracy(one: Identified) -> str:
    """Return the table of errors before, after and held out."""
    residual = one.record.get("residual") or {}
    kinds = list(dict.fromkeys(k for s, _ in STAGES for k in residual.get(s) or {}))
    rows = []
    for kind in kinds:
        for stage, name in STAGES:
            part = figure(one, stage, kind)
            if any(number(part.get(c)) is not None for c in COLUMNS):
                rows.append([words(f"{kind}, {name}"), words(part.get("unit")),
                             *(amount(part.get(c)) for c in COLUMNS)])
    if not rows:
        return ""
    notes = [str(one.record.get("holdout_note") or "")]
    if "closure" in kinds:
        notes.append("Closure is the limb condition at the measured poses, as a length.")
    note = " ".join(n[0].upper() + n[1:].rstrip(".") + "." for n in notes if n)
    return ("<h2>Error before and after</h2>" + '<div class="pair">'
            + table("p95: 95 % of the rows are below it", ["error", "unit", *COLUMNS], rows)
            + f"<div>{_fit_facts(one)}{paragraph(note, 'note')}</div></div>")


def _fit_facts(one: Identified) -> str:
    """Return noise, rank, iterations and observability."""
    r = one.record
    noise: Mapping[str, Any] = r.get("noise") or {}
    facts: list[tuple[str, str]] = []
    if number(noise.get("sigma_ratio")) is not None:
        facts.append(("Residual over stated noise", sig(noise["sigma_ratio"])))
    own = noise.get("by_dataset") or {}
    if len(own) > 1:
        facts.append(("The same by file", ", ".join(f"{n} {sig(v)}" for n, v in own.items())))
    if number(noise.get("chi2")) is not None:
        facts.append(("χ² of data and prior", f"{sig(noise['chi2'], 4)} with "
                      f"{sig(noise.get('degrees'), 4)} degrees of freedom, "
                      f"{probability(noise.get('chi2_p'))}".rstrip(", ")))
    if number(noise.get("repeat_ratio")) is not None:
        facts.append(("Scatter of repeats over stated noise", sig(noise["repeat_ratio"])))
    if number(r.get("rank")) is not None:
        columns = r.get("columns")
        size = len(columns) if isinstance(columns, list) else number(columns)
        of = f" of {size:.0f} unknowns, frames and targets included" if size else ""
        facts.append(("Rank", f"{r['rank']:.0f}{of}"))
    if number(r.get("iterations")) is not None:
        state = {True: ", converged", False: ", not converged", None: ""}[_truth(r)]
        facts.append(("Iterations", f"{r['iterations']:.0f}{state}"))
    scale = number(r.get("prior_scale"))
    if scale is not None and scale != 1.0:
        facts.append(("Tolerances scaled by", sig(scale)))
    index = [f"{k}{NBSP}{sig(v)}" for k, v in sorted((r.get("observability") or {}).items())
             if k in ("O1", "O2", "O3", "O4", "O5")]
    facts.append(("Observability indices", " · ".join(index)))
    facts.append(("Measured region", _region(one)))
    return definitions(facts)


def _truth(record: Mapping[str, Any]) -> bool | None:
    """Return whether the fit converged, None if that is not said."""
    value = record.get("converged")
    return value if isinstance(value, bool) else None


def _region(one: Identified) -> str:
    """Return the ranges of the measured coordinates in words."""
    parts = []
    for name, ends in (one.record.get("measured_volume") or {}).items():
        unit = one.unit(quantity_of(name))
        shown = [with_unit(e, unit, 4) for e in ends or ()]
        parts.append(f"{name} {' … '.join(shown)}")
    return "; ".join(parts)


def parameters(one: Identified) -> str:
    """Return the table of parameters; fixed ones follow in a table of their own."""
    if not one.parameters:
        return ""
    free = [p for p in one.parameters if p.get("status") != "fixed"]
    fixed = [p for p in one.parameters if p.get("status") == "fixed"]
    heads = ["parameter", "unit", "nominal", "value", "95 % interval", "error", "tolerance",
             "error against tolerance", "sigma", "sigma, data only", "status"]
    note = ("Bars: error in tolerances, shaded: one to each side, ends: three; "
            "line: 95 % interval; red tip: beyond the end.")
    out = ("<h2>Parameters</h2>" + paragraph(note, "note")
           + table("", heads, [_row(p) for p in free], sort=True))
    if fixed:
        rows = [[dotted(p.get("name")), amount(p.get("value"), exact(p.get("value"))),
                 words(p.get("unit"))] for p in fixed]
        name = f"{count(len(fixed), 'parameter')} held fixed"
        out += (f"<details><summary>{name}</summary>"
                + table("", ["parameter", "value", "unit"], rows) + "</details>")
    return out


def _row(p: Mapping[str, Any]) -> list[Cell]:
    sigma, value = number(p.get("sigma")), number(p.get("value"))
    low, high = number(p.get("low")), number(p.get("high"))
    if low is None and high is None and sigma is not None and value is not None:
        low, high = value - 1.96 * sigma, value + 1.96 * sigma
    interval = "–" if low is None and high is None else (
        f"{to_sigma(low, sigma)} … {to_sigma(high, sigma)}")
    away = tolerances(p)
    status = str(p.get("status") or "")
    return [dotted(p.get("name")), words(p.get("unit")),
            amount(p.get("nominal"), exact(p.get("nominal"))),
            amount(value, to_sigma(value, sigma)), amount(low, interval),
            amount(p.get("error"), to_sigma(p.get("error"), sigma), bad=(away or 0.0) > 3.0),
            amount(p.get("tolerance"), exact(p.get("tolerance"))), Cell(error_bar(p), away),
            amount(sigma, sig(sigma, 2)), amount(p.get("sigma_data"), sig(p.get("sigma_data"), 2)),
            words(status, "warn" if status == "redundant" else "")]


def redundant(one: Identified) -> str:
    """Return the redundant parameters, each with its combination in words."""
    entries = one.record.get("redundant") or []
    if not entries:
        return ""
    return (f"<h3>{count(len(entries), 'quantity', 'quantities')} that these data cannot tell "
            "apart</h3>" + bullets([redundancy(e) for e in entries])
            + paragraph("Predictions do not depend on how such a combination is split; the prior "
                        "splits it by the tolerances. Coefficients are in the file's units.",
                        "note"))


def correlations(one: Identified) -> str:
    """Return the strongest correlations."""
    found = [c for c in one.record.get("correlations") or [] if number(c.get("value")) is not None]
    found.sort(key=lambda c: -abs(c["value"]))
    rows = [[dotted(c.get("a")), dotted(c.get("b")), amount(c["value"])] for c in found[:12]]
    more = f"the strongest 12 of {len(found)}" if len(found) > 12 else ""
    return ("<h3>Strong correlations</h3>" + table(more, ["parameter", "with", "correlation"], rows)
            if rows else "")


def plots(one: Identified) -> str:
    """Return the residual plots."""
    drawings = residual_figures(one)
    if not drawings or one.residuals is None:
        return ""
    keep = used(one.residuals)
    out = whole(int((~keep).sum()))
    note = (count(one.residuals.size, "row")
            + ("." if keep.all() else f", {out} of them left out of the fit."))
    return ("<h2>Residuals</h2>" + paragraph(note, "note")
            + f'<div class="plots">{"".join(drawings)}</div>')


def excluded(one: Identified) -> str:
    """Return the rows that the fit left out, with reasons."""
    entries = excluded_rows(one)
    if not entries:
        return ""
    rows = [[words(e["dataset"]), amount(e["row"], exact(e["row"])), words(e["reason"], "wrap")]
            for e in entries[:MAX_ROWS]]
    more = (f"the first {MAX_ROWS} of {whole(len(entries))}; residuals.csv has them all"
            if len(entries) > MAX_ROWS else "")
    return (f"<h3>{count(len(entries), 'row')} left out of the fit</h3>"
            + table(more, ["data set", "row", "reason"], rows, sort=True))


def excluded_rows(one: Identified) -> list[dict[str, Any]]:
    """Return the rows left out, from the JSON, else from residuals.csv."""
    if one.record.get("excluded") is not None:
        return [{k: e.get(k) for k in ("dataset", "row", "reason")}
                for e in one.record["excluded"]]
    t = one.residuals
    if t is None:
        return []
    row, names, reasons = t.number("row"), t.words("dataset"), t.words("reason")
    return [{"dataset": names[i], "row": number(float(row[i])), "reason": reasons[i]}
            for i in (~used(t)).nonzero()[0]]
