"""What identify tells a person."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ppmcal.cli.common import Console, number, plain_table
from ppmcal.wording import counted

if TYPE_CHECKING:
    from ppmcal.calibration.summary import Identification


def show_result(result: Identification, console: Console) -> None:
    """Print what a person wants to know."""
    if not console.speaks:
        return
    from ppmcal.io.results import outliers as blunder_words
    from ppmcal.io.results.identifiability import flat_sentences, sentences

    fit = result.fit
    rows = sum(int(k.sum()) for k in fit.keep)
    open_ = len(result.columns) - len(fit.problem.free)
    more = f" and {open_} of frames and targets" if open_ else ""
    console.say(f"{result.mechanism.name}: {len(fit.problem.free)} parameters{more} from {rows} "
                f"rows, {counted(fit.iterations, 'iteration')}; rank {result.rank} of "
                f"{len(result.columns)}.")
    _show_errors(result, console)
    _show_noise(result, console)
    _show_parameters(result, console)
    _show_redundant(result, console)
    _show_held(result, console)
    for sentence in (*sentences(result.untold, result.mechanism),
                     *flat_sentences(result.flats, result.mechanism)):
        console.say(sentence)
    words = blunder_words.sentences(result.blunders, result.mechanism)
    console.warn([*result.findings, *blunder_words.shifts(result.blunders, result.mechanism)])
    for sentence in words:
        console.say(sentence)


def _show_errors(result: Identification, console: Console) -> None:
    """Print errors before, after and on what was held out."""
    from ppmcal.io.results.identification import figures

    fit, units = result.fit, result.mechanism.units
    table = []
    for label, values in (("before", result.before.figures(fit.keep)),
                          ("after", result.after.figures(fit.keep)),
                          ("held out", result.holdout)):
        for name, f in figures(values, units).items():
            table.append([label, name, *(number(f.get(k)) for k in ("mean", "rms", "p95", "max")),
                          f["unit"]])
    console.table(plain_table(["", "error", "mean", "rms", "p95", "max", "unit"], table,
                              (2, 3, 4, 5)))
    console.say(f"Held out: {result.holdout_note}.")


def _show_noise(result: Identification, console: Console) -> None:
    n = result.noise
    console.say(f"Noise: residuals are {n.sigma_ratio:.3g} times the stated noise "
                f"(p = {n.chi2_p:.2g})."
                + (f" Repeats scatter {n.repeat_ratio:.3g} times." if n.repeat_ratio else ""))
    if len(n.by_dataset) > 1:
        console.say("By file: " + ", ".join(f"{name} {r:.3g}"
                                            for name, r in n.by_dataset.items()) + ".")


def _show_parameters(result: Identification, console: Console) -> None:
    """Print the parameters that moved farthest, in tolerances."""
    from ppmcal.io.results.identification import parameter

    units = result.mechanism.units
    free = [parameter(e, units) for e in result.estimates if e.status != "fixed"]
    shown = sorted(free, key=lambda p: -abs(p["error"]) / (p["tolerance"] or 1.0))[:12]
    if shown:
        console.table(plain_table(
            ["parameter", "nominal", "error", "+- 95 %", "unit", "status"],
            [[p["name"], number(p["nominal"], 7), number(p["error"]),
              number(None if p["sigma"] is None else 1.96 * p["sigma"], 3), p["unit"],
              p["status"]] for p in shown], (1, 2, 3)))
    if len(free) > len(shown):
        console.say(f"The {len(shown)} largest errors against tolerance; all {len(free)} in "
                    "parameters.csv.")


HELD = 0.8
"""A parameter known to this part of its tolerance is held by it, not by the data."""


def _show_held(result: Identification, console: Console) -> None:
    """Name what the data hardly know better than the drawing did."""
    from ppmcal.io.results.identification import of_tolerance

    if not result.fit.prior.any():
        return
    held = [(e.name, of_tolerance(e) or 0.0) for e in result.estimates if e.status == "identified"]
    held = sorted((h for h in held if h[1] > HELD), key=lambda h: -h[1])
    if held:
        shown = ", ".join(f"{name} ({ratio:.2f})" for name, ratio in held[:6])
        more = f" and {len(held) - 6} more" if len(held) > 6 else ""
        console.say("Held by their tolerances rather than by these data (uncertainty after over "
                    f"before): {shown}{more}.")


def _show_redundant(result: Identification, console: Console) -> None:
    if not result.redundant:
        return
    names = ", ".join(d.name for d in result.redundant[:8])
    rest = len(result.redundant) - 8
    how = ("held by their tolerances" if result.fit.prior.any()
           else "left where nothing else moves them")
    more = f" and {rest} more" if rest > 0 else ""
    console.say(f"Redundant (the data cannot tell them from others; {how}): {names}{more}.")
