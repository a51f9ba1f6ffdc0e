"""What the machines of a batch have in common: the design's share, and the units'."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.sessions import (
    CERTAIN,
    FEWEST,
    CommonError,
    common_errors,
    share_interval,
)
from ppmcal.io.results.batch import CampaignRecord
from ppmcal.linalg import Array
from ppmcal.plotting.canvas import Drawing
from ppmcal.plotting.layers import Dots, Layer, Points, Strokes, Zero
from ppmcal.plotting.plot import row_y, rows_plot, span
from ppmcal.report.format import count, listed, probability, sig
from ppmcal.report.html import figures, name_cell, number_cell, paragraph, table, text_cell
from ppmcal.report.section import Section

MOST = 0.5
SHOWN, NAMES, ROW = 30, 150.0, 15.0


@dataclass(frozen=True)
class SharedEffect:
    """An effect that some of the machines have."""

    kind: str
    machines: tuple[str, ...]
    of: int
    low: float
    high: float
    sizes: tuple[tuple[str, str, Array], ...]

    @property
    def whose(self) -> str:
        """Return whether it is of the design, or of single units."""
        if self.of < FEWEST:
            return "too few machines to say"
        if self.low > MOST:
            return "the design's"
        return "perhaps the design's" if len(self.machines) > MOST * self.of else "the units'"


def _latest(records: Iterable[CampaignRecord], *commands: str) -> list[CampaignRecord]:
    out: dict[str, CampaignRecord] = {}
    for r in sorted(records, key=lambda r: r.date):
        if r.command in commands and not r.failed:
            out[r.machine] = r
    return list(out.values())


def shared_effects(records: Sequence[CampaignRecord]) -> list[SharedEffect]:
    """Return the effects of the latest diagnosis of each machine, most frequent first."""
    diagnosed = [r for r in _latest(records, "diagnose") if r.verdict != "misread"]
    kinds = dict.fromkeys(q.name for r in diagnosed for q in r.of_kind("effect"))
    out = []
    for kind in kinds:
        own = [(r.machine, q) for r in diagnosed for q in r.of_kind("effect") if q.name == kind]
        machines = tuple(dict.fromkeys(m for m, _ in own))
        sizes = [(name, unit, np.array([q.value for _, q in own if (q.parameter, q.unit) == (
            name, unit) and q.value is not None and q.sigma is not None])) for name, unit in
            dict.fromkeys((q.parameter, q.unit) for _, q in own if q.sigma is not None)]
        low, high = share_interval(len(machines), len(diagnosed))
        out.append(SharedEffect(kind, machines, len(diagnosed), low, high, tuple(sizes)))
    return sorted(out, key=lambda e: -len(e.machines))


def shared_parameters(records: Sequence[CampaignRecord]
                      ) -> list[tuple[str, str, float | None, CommonError]]:
    """Return name, unit, tolerance and mean error of each parameter, surest first.

    Of those that every machine has: what is there only where it was found is never 0 on average.
    """
    columns: dict[tuple[str, str], list[tuple[float, float | None]]] = {}
    fits = _latest(records, "identify", "diagnose")
    for r in fits:
        named = {q.name for q in r.of_kind("effect")}
        for q in r.of_kind("parameter"):
            if (q.value is not None and q.nominal is not None and q.status != "fixed"
                    and q.name.partition(".")[0] not in named):
                columns.setdefault((q.name, q.unit), []).append(
                    (q.value - q.nominal, q.tolerance))
    columns = {k: own for k, own in columns.items() if len(own) == len(fits)}
    found = common_errors([np.array([e for e, _ in own]) for own in columns.values()])
    out = [(name, unit, own[0][1], f) for ((name, unit), own), f in
           zip(columns.items(), found, strict=True) if f is not None]
    return sorted(out, key=lambda o: o[3].p_value)


def common_sentences(records: Sequence[CampaignRecord]) -> list[str]:
    """Return what is the design's, in words."""
    out = [f"{e.kind} is {e.whose}: {len(e.machines)} of {count(e.of, 'machine')} have it."
           for e in shared_effects(records) if "design" in e.whose]
    off = [name for name, _, _, f in shared_parameters(records) if f.of_design]
    if off:
        out.append(f"Off nominal in the same way on all units, so by design: {listed(off)}.")
    return out


def common_effects(records: Sequence[CampaignRecord]) -> Section | None:
    """Return the table of effects by how many machines have them."""
    rows = []
    for e in shared_effects(records):
        share = f"{100.0 * e.low:.0f} to {100.0 * e.high:.0f} %"
        rows.append([text_cell(e.kind),
                     number_cell(len(e.machines), f"{len(e.machines)} of {e.of}"),
                     number_cell(e.low, share), text_cell(e.whose, "warn" if e.low > MOST else ""),
                     text_cell("; ".join(_size(*s) for s in e.sizes), "wrap"),
                     text_cell(listed(e.machines), "wrap")])
    note = ("An effect that most machines have is the design's, not the unit's: certain where the "
            "95 % interval of the share lies above one half. One that all share may also be of an "
            "instrument that measured them all.")
    heads = ["effect", "machines", "share, 95 %", "whose", "size over machines", "which"]
    return Section("Effects that machines have in common", table("", heads, rows, sort=True)
                   + paragraph(note, "note")) if rows else None


def _size(name: str, unit: str, values: Array) -> str:
    spread = f", spread {sig(float(np.std(values, ddof=1)), 2)}" if len(values) > 1 else ""
    return f"{name} {sig(float(np.mean(values)))}{spread} {unit}".strip()


def common_parameters(records: Sequence[CampaignRecord]) -> Section | None:
    """Return the parameters that are off nominal alike on all machines."""
    found = shared_parameters(records)
    if not found:
        return None
    heads = ["parameter", "machines", "mean error", "95 %", "unit", "spread of units", "chance",
             "whose"]
    rows = [[name_cell(name), number_cell(f.machines, str(f.machines)), number_cell(f.mean),
             number_cell(f.half, f"± {sig(f.half, 2)}"), text_cell(unit), number_cell(f.spread),
             number_cell(f.p_value, probability(f.p_value)),
             text_cell("the design's" if f.of_design else "", "warn" if f.of_design else "")]
            for name, unit, _, f in found]
    sure = sum(f.of_design for *_, f in found)
    first = rows[:max(sure, 8)]
    out = table("", heads, first, sort=True)
    if len(rows) > len(first):
        out += (f"<details><summary>{count(len(rows) - len(first), 'further parameter')}"
                "</summary>" + table("", heads, rows[len(first):], sort=True) + "</details>")
    note = ("Chance: that machines drawn around nominal have such a mean, over all parameters; "
            f"below {CERTAIN:g} nominal is off by design (drawing, or controller settings that all "
            "share). Parameters that act alike stand in for each other.")
    return Section("Parameters that are off alike",
                   out + paragraph(note, "note") + figures([_picture(found)]))


def _picture(found: Sequence[tuple[str, str, float | None, CommonError]]) -> Drawing | None:
    """Return mean errors with their intervals and the spread of units, in tolerances."""
    shown = [(name, tolerance, f) for name, _, tolerance, f in found if tolerance][:SHOWN]
    if not shown:
        return None
    values = np.array([[f.mean / t, f.half / t, f.spread / t] for _, t, f in shown])
    mean, half, spread = values.T
    y = row_y(len(shown))
    said = Points([f"{name}\n± {sig(h, 2)} (95 %), spread of units {sig(s, 2)}"
                   for (name, _, _), h, s in zip(shown, half, spread, strict=True)])
    layers: list[Layer] = [
        Zero(upright=True), Strokes(y, mean - spread, mean + spread, "ink", 0.8, 0.4, True),
        Strokes(y, mean - half, mean + half, "after", 2.2, flat=True),
        Dots(mean, y, "after", 6.5, said)]
    ends = np.concatenate([mean - spread, mean + spread, mean - half, mean + half, [0.0]])
    return rows_plot(span(ends), "mean error / tolerance", layers,
                     [(n, f.of_design) for n, _, f in shown]).drawing(
        "Mean error over machines, in tolerances",
        "Dots with 95 % bars; thin lines: one standard deviation of units to each side. Bold: "
        f"the design's.{f' The {len(shown)} surest.' if len(shown) < len(found) else ''}",
        f"{len(shown)} parameters.")
