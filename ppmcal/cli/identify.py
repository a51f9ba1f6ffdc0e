"""``ppmcal identify``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from ppmcal.cli import completion
from ppmcal.cli.common import (
    FILE,
    MODEL,
    Console,
    FiniteRange,
    console_options,
    examples,
    finish,
    leave,
    leave_out_option,
    out_option,
    plain_table,
    refuse_two_holdouts,
    seed_option,
)
from ppmcal.wording import counted, number, some

if TYPE_CHECKING:
    from ppmcal.calibration.fit import Noise
    from ppmcal.calibration.validation import Identification
    from ppmcal.io.results.identification import IdentificationRecord


def show_result(result: Identification, record: IdentificationRecord, console: Console) -> None:
    """Print what a person wants to know."""
    if not console.speaks:
        return
    from ppmcal.io.results.campaign import campaign_sentences
    from ppmcal.io.results.gross_errors import row_sentences
    from ppmcal.io.results.identifiability import flat_sentences

    fit = result.fit
    rows = sum(int(k.sum()) for k in fit.keep)
    open_ = len(result.columns) - len(fit.problem.free)
    more = f" and {open_} of frames and targets" if open_ else ""
    console.say(f"{record.name}: {len(fit.problem.free)} parameters{more} from {rows} "
                f"rows, {counted(fit.iterations, 'iteration')}; rank {result.rank} of "
                f"{len(result.columns)}.")
    _show_errors(record, console)
    _show_noise(record.noise, console)
    _show_parameters(record, console)
    prior = fit.by_tolerances
    _show_redundant(record, prior, console)
    if prior:
        _show_prior_dominated(record, console)
    for sentence in (*record.identifiability.sentences(), *flat_sentences(record.flats),
                     *campaign_sentences(record.campaign)):
        console.say(sentence)
    console.warn([*record.findings, *record.gross_errors.shift_sentences()])
    for sentence in (*row_sentences(record.gross_errors, result.mechanism),
                     *record.gross_errors.unchecked_sentences()):
        console.say(sentence)


def _show_errors(record: IdentificationRecord, console: Console) -> None:
    """Print errors before, after and on what was held out."""
    from ppmcal.io.results.identification_parts import before_words

    table = [[label, name, *(number(getattr(f, k)) for k in ("mean", "rms", "p95", "max")), f.unit]
             for label, found in (("before", record.residual.before),
                                  ("after", record.residual.after),
                                  ("held out", record.residual.holdout))
             for name, f in found.items()]
    console.table(plain_table(["", "error", "mean", "rms", "p95", "max", "unit"], table,
                              (2, 3, 4, 5)))
    console.say(f"Held out: {record.holdout_note}.{before_words(record.residual.before_is)}")


def _show_noise(n: Noise, console: Console) -> None:
    from ppmcal.io.results.identification_wording import noise_verdict

    console.say(f"Noise: {noise_verdict(n)[0]}."
                + (f" Repeats scatter {n.repeat_ratio:.3g} times the {n.source} noise."
                   if n.repeat_ratio else ""))
    if len(n.by_dataset) > 1:
        console.say("By file: " + ", ".join(f"{name} {number(r, 3)}"
                                            for name, r in n.by_dataset.items()) + ".")


def _show_parameters(record: IdentificationRecord, console: Console) -> None:
    """Print the parameters that moved farthest, in tolerances."""
    from ppmcal.io.results.identification_wording import short_intervals

    free = [p for p in record.parameters if p.status != "fixed"]
    shown = sorted(free, key=lambda p: -abs(p.error or 0.0) / (p.tolerance or 1.0))[:12]
    if shown:
        wider = any(p.sigma_sessions is not None for p in shown)
        console.table(plain_table(
            ["parameter", *["nominal"] * (not wider), "error", "+- 95 %", *["by noise"] * wider,
             "unit", "status"],
            [[p.name, *[number(p.nominal, 7)] * (not wider), number(p.error),
              number(p.half, 3),
              *[number(p.by_noise, 3)] * wider, p.unit,
              p.status + ", sessions disagree" * bool(p.disagree)] for p in shown],
            (1, 2, 3)))
        if wider:
            console.say("By noise: the 95 % interval of noise alone; +- 95 % also counts how far "
                        "sessions, or parts of one, differ.")
    for sentence in short_intervals(record.method):
        console.say(f"{sentence}.")
    if len(free) > len(shown):
        console.say(f"The {len(shown)} largest errors against tolerance; all {len(free)} in "
                    "parameters.csv.")


PRIOR_DOMINATED = 0.8
"""A parameter known to this part of its tolerance is constrained by the prior, not the data."""


def _show_prior_dominated(record: IdentificationRecord, console: Console) -> None:
    """Name what the data hardly know better than the nominal values' tolerances."""
    found = sorted(((p.of_tolerance or 0.0, p.name) for p in record.parameters
                    if p.status == "identified" and (p.of_tolerance or 0.0) > PRIOR_DOMINATED),
                   key=lambda h: -h[0])
    if found:
        names = [f"{name} ({ratio:.2f})" for ratio, name in found]
        console.say("Constrained by the prior rather than by these data (posterior sigma over "
                    f"tolerance): {some(names, 'parameters.csv')}.")


def _show_redundant(record: IdentificationRecord, prior: bool, console: Console) -> None:
    if not record.unidentifiable:
        return
    from ppmcal.io.results.identifiability import unidentifiable_words

    count = sum(s.combinations for s in record.unidentifiable)
    how = "constrained by the prior alone" if prior else "left where nothing else moves them"
    console.say(f"{count} redundant: combinations that these data cannot identify ({how}): "
                f"{unidentifiable_words(record.unidentifiable)}.")


@click.command("identify", epilog=examples(
    "ppmcal identify mine.yaml run1.csv",
    "ppmcal identify mine.yaml run1.csv run2.csv --leave-out session",
    "ppmcal identify mine.yaml run2.csv --start identified --keep --out kept"))
@click.argument("mech", type=MODEL)
@click.argument("data", type=FILE, nargs=-1, required=True)
@out_option("identified")
@click.option("--method", type=click.Choice(["prior", "gcv", "damped"]), default="prior",
              show_default=True, help="prior: tolerances as prior; gcv: their common scale "
              "chosen by generalised cross-validation; damped: the scheme of the PPM paper.")
@click.option("--prior", type=click.Choice(["tolerances", "flat"]), default="tolerances",
              show_default=True, help="flat: no prior at all.")
@click.option("--damping", type=FiniteRange(min=0.0, min_open=True), default=0.9,
              show_default=True, help="The damping of --method damped.")
@click.option("--iterations", type=click.IntRange(1, 100000), default=None,
              help="Stop after so many and write what was reached  [default: 60, damped: 6000, "
              "and no result without convergence].")
@click.option("--free", "patterns", multiple=True, metavar="PATTERN",
              shell_complete=completion.parameters,
              help="Parameters that may change, in place of the file's; 'none' for frames only.")
@click.option("--holdout", default="0.2", show_default=True, metavar="FRACTION|CSV",
              help="Poses to hold out, or other measurements to test on; 0 for none.")
@leave_out_option
@click.option("--sigma", type=click.Choice(["stated", "estimated"]), default="stated",
              show_default=True, help="estimated: the noise of each file as its residuals show "
              "it, where the stated one does not fit.")
@click.option("--start", type=click.Path(path_type=Path), default=None, metavar="OLD",
              help="Start from the values of an earlier calibration: its folder or "
              "identified.yaml.")
@click.option("--keep", is_flag=True, help="Carry on the calibration of --start (or of MECH): "
              "what its data knew stays known; identification.json must be beside it.")
@click.option("--keep-outliers", is_flag=True, help="Use every row as it is.")
@seed_option
@console_options
def command(mech: Path, data: tuple[Path, ...], out: Path, method: str, prior: str,
            damping: float, iterations: int | None, patterns: tuple[str, ...], holdout: str,
            leave_out: str | None, sigma: str, start: Path | None, keep: bool, keep_outliers: bool,
            seed: int | None, console: Console) -> None:
    """Identify the geometry of MECH from the measurements DATA (CSV files).

    Writes identified.yaml (a mechanism file), parameters.csv, residuals.csv and
    identification.json.
    """
    from ppmcal.api.identify import identify

    given = click.get_current_context().get_parameter_source("damping")
    if method != "damped" and given == click.core.ParameterSource.COMMANDLINE:
        raise click.UsageError("--damping goes with --method damped.")
    refuse_two_holdouts(leave_out)
    with console.misread():
        result = identify(mech, data, method=method, prior=prior, damping=damping,
                          iterations=iterations, free=patterns, holdout=holdout,
                          leave_out=leave_out or "", sigma=sigma, start=start, keep=keep,
                          keep_outliers=keep_outliers, seed=seed or 0)
    written = result.save(out)
    for note in result.notes:
        console.say(note)
    show_result(result.identification, result.record, console)
    finish(out, [p.name for p in written], console)
    console.summary(result.record.summary())
    leave(result.needs_a_look)
