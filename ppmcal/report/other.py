"""Sections about compensation, kinematics, checks and simulated truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ppmcal.io.results.commands import accepted_sentence
from ppmcal.io.results.kinematics import KinematicsRecord, modes_sentence, solved_sentence
from ppmcal.report.format import count, sig, to_sigma, whole
from ppmcal.report.headlines import finding_text, other_machine
from ppmcal.report.html import (
    MAX_ROWS,
    Cell,
    amount,
    bullets,
    dotted,
    figures,
    given,
    paragraph,
    table,
    words,
)
from ppmcal.report.kinematics_figures import kinematics_figures
from ppmcal.report.records import Columns, ComparedMachines, Other, ResidualRows, Simulated
from ppmcal.report.residual_figures import command_figure, truth_figures
from ppmcal.report.residuals import predicted
from ppmcal.report.section import Section, filled
from ppmcal.wording import sentence

SHOWN = 30
"""Rows of commands.csv that are shown; the file holds them all."""
CHAPTERS = {"path": "Path", "pose": "Pose", "joints": "Joints", "rates": "Rates",
            "singularity": "Distance to singularity"}


def compensation_section(rows: ResidualRows, lengths: Mapping[str, str]) -> Section:
    """Return summary, first rows and refused rows of a compensation."""
    t = rows.table
    out = []
    if t is None:
        return Section("Compensation", scalars(rows.record.entries()), rows.folder)
    good = np.ones(t.size, dtype=bool)
    good[list(rows.flagged)] = False
    out.append(paragraph(f"{accepted_sentence(int(good.sum()), t.size)}."))
    stats = []
    for kind, quantity in (("position", "length"), ("rotation", "angle")):
        for stage, values in predicted(t, kind).items():
            values = values[good]
            if not np.isfinite(values).any():
                continue
            values = values[np.isfinite(values)]
            stats.append([words(f"{kind}, {stage}"), words(lengths.get(quantity, "")),
                          amount(float(values.mean())), amount(_rms(values)),
                          amount(float(values.max()))])
    out.append(table("Error predicted, accepted targets; corrected: the model's own uncertainty, "
                     "1 sigma", ["error", "unit", "mean", "rms", "max"], stats))
    if not any(np.isfinite(predicted(t, kind)["corrected"][good]).any()
               for kind in ("position", "rotation")):
        out.append(paragraph("What corrected commands leave is unknown: the model's own "
                             "uncertainty is not in the file.", "note"))
    out.append(figures([command_figure(rows, k, lengths.get(q, ""))
                        for k, q in (("position", "length"), ("rotation", "angle"))]))
    return Section("Compensation", "".join(out), rows.folder,
                   parts=filled([_commands(t, np.flatnonzero(good)), refused(rows)]))


def _commands(t: Columns, rows: Sequence[int] | np.ndarray[Any, Any]) -> Section:
    """Return the first accepted rows: what was wanted, what to send, and by how much it differs."""
    sent = [h for h in t.header if h.startswith(("q_", "cmd_")) and not h.endswith("_nominal")]
    errors = [h for h in t.numbers if h.startswith(("error_", "sigma_"))]
    asked = [h for h in t.header if h in t.text or h in ("x", "y")]
    asked = [h for h in asked if h not in ("status", "reason")]
    heads = ["row", *asked]
    for s in sent:
        heads += [s, f"Δ {s}"] if f"{s}_nominal" in t.numbers else [s]
    body = []
    for i in rows[:SHOWN]:
        cells = [amount(float(i) + 1.0, f"{i + 1}")]
        cells += [given(t.text[h][i]) if h in t.text else amount(t.numbers[h][i],
                                                                sig(float(t.numbers[h][i]), 6))
                  for h in asked]
        for s in sent:
            value = float(t.numbers[s][i])
            cells.append(amount(value, sig(value, 7)))
            if f"{s}_nominal" in t.numbers:
                cells.append(amount(value - float(t.numbers[f"{s}_nominal"][i])))
        cells += [amount(float(t.numbers[e][i])) for e in errors]
        body.append(cells)
    more = (f"the first {SHOWN} of {whole(len(rows))} accepted targets; commands.csv has all digits"
            if len(rows) > SHOWN else "rounded; commands.csv has all digits")
    plain = [h.removeprefix("error_").replace("_", " ") if h.startswith("error_")
             else h.replace("_", " ") for h in errors]
    note = f"{more[:1].upper()}{more[1:]}. Δ: change against the uncorrected command."
    return Section("Commands", paragraph(note, "note")
                   + table("", [*heads, *plain], body, sort=True) if body else "")


def refused(rows: ResidualRows) -> Section | None:
    """Return the rows that were refused or have a remark."""
    t = rows.table
    if t is None or not rows.flagged:
        return None
    status, reason = t.words("status"), t.words("reason")
    body = [[amount(float(i + 1), f"{i + 1}"), words(status[i]), words(reason[i], "wrap")]
            for i in rows.flagged[:MAX_ROWS]]
    more = (f"the first {MAX_ROWS} of {whole(len(rows.flagged))}; {rows.kind}.csv has them all"
            if len(rows.flagged) > MAX_ROWS else "")
    return Section(f"{count(len(rows.flagged), 'row')} refused or with a remark",
                   table(more, ["row", "status", "reason"], body, sort=True))


def kinematics_section(rows: ResidualRows) -> Section:
    """Return how many rows were solved, and those that were not."""
    size = rows.table.size if rows.table is not None else 0
    done = size - len(rows.flagged)
    text, parts = f"{solved_sentence(done, size)}." if size else "", []
    if isinstance(rows.record, KinematicsRecord):
        modes = rows.record.modes
        if modes is not None:
            text = (f"{count(sum(modes.counts), 'pose')} in {count(len(modes.counts), 'row')} of "
                    f"joint values. {modes_sentence(modes)} The machine's own is drawn.")
        drawn = {} if rows.table is None else kinematics_figures(rows.record, rows.table)
        parts = [Section(CHAPTERS[name], figures(drawings), count(len(drawings), "picture"),
                         folded=name in ("pose", "rates")) for name, drawings in drawn.items()]
    return Section("Kinematics", paragraph(text) + scalars(rows.record.entries()), rows.folder,
                   parts=filled([*parts, refused(rows)]))


def other_section(other: Other) -> Section:
    """Return findings, plain facts and the size of any other output."""
    findings = [finding_text(f) for f in other.record.findings or ()]
    clean = other.record.findings is not None and not findings
    size = f"{count(other.table.size, 'row')} in its CSV." if other.table is not None else ""
    return Section(other.kind.capitalize(), paragraph(size, "note")
                   + paragraph("Nothing was found wrong." if clean else "")
                   + bullets(findings) + scalars(other.record.entries()), other.folder)


def scalars(record: Mapping[str, Any]) -> str:
    """Return the numbers and words of a JSON that has no section of its own."""
    pairs = []
    for key, value in record.items():
        if key in ("format", "findings", "provenance"):
            continue
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            shown = sig(value, 6) if isinstance(value, float) else str(value)
            pairs.append([words(key.replace("_", " ")), words(shown, "wrap")])
        elif isinstance(value, bool):
            pairs.append([words(key.replace("_", " ")), words("yes" if value else "no")])
    return table("", ["what", "value"], pairs)


def simulation_section(s: Simulated, note: str = "") -> Section:
    """Return what was simulated; ``note`` is what to say of its truth."""
    rows = count(s.measurements.size, "measurement") if s.measurements is not None else "no CSV"
    seed = None if s.truth is None else s.truth.provenance.seed
    text = f"{rows} simulated in {s.folder}" + (f", seed {seed}." if seed is not None else ".")
    return Section("Simulation", paragraph(text) + paragraph(note))


def truth_section(c: ComparedMachines) -> Section:
    """Return the errors put in against those found."""
    body: list[list[Cell]] = []
    for r in c.rows:
        body.append([dotted(r.name), amount(r.true, to_sigma(r.true, r.sigma)),
                     amount(r.found, to_sigma(r.found, r.sigma)),
                     amount(r.found - r.true, to_sigma(r.found - r.true, r.sigma)),
                     amount(r.sigma, sig(r.sigma, 2)), words(r.unit),
                     amount(r.z, sig(r.z, 2), bad=abs(r.z or 0.0) > 4.0), words(r.status)])
    z = np.array([r.z for r in c.rows if r.z is not None])
    text = ""
    if z.size:
        far = int(np.sum(np.abs(z) > 2.0))
        text = (f"{far} of {count(int(z.size), 'error')} found "
                f"{'is' if far == 1 else 'are'} more than 2 sigma from the truth "
                f"(about {sig(0.0455 * z.size, 2)} expected); rms of z {sig(_rms(z))}.")
    heads = ["parameter", "error true", "error found", "found − true", "sigma", "unit", "z",
             "status"]
    told = " ".join(t for t in (sentence(other_machine(c)), c.note) if t)
    return Section("Simulated truth against identified", paragraph(text)
                   + paragraph(told, "bad") + figures(truth_figures(c))
                   + table("z = (found − true) / sigma", heads, body, sort=True),
                   f"{c.truth} and {c.identified}")


def _rms(values: np.ndarray[Any, Any]) -> float:
    return float(np.sqrt(np.mean(values**2)))
