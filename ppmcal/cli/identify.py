"""``ppmcal identify``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ppmcal.cli.common import (
    FILE,
    Console,
    FiniteRange,
    command_line,
    finish,
    json_option,
    leave,
    load,
    number,
    out_option,
    plain_table,
    quiet_option,
    readable,
    seed_option,
    started,
    unit_findings_told,
)
from ppmcal.wording import counted

if TYPE_CHECKING:
    from ppmcal.calibration.summary import Identification
    from ppmcal.io.results.identification import IdentificationRecord
    from ppmcal.io.results.identification_parts import NoiseCheck


def show_result(result: Identification, record: IdentificationRecord, console: Console) -> None:
    """Print what a person wants to know."""
    if not console.speaks:
        return
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
    prior = bool(fit.prior.any())
    _show_redundant(record, prior, console)
    if prior:
        _show_prior_dominated(record, console)
    for sentence in (*record.identifiability.sentences(), *flat_sentences(record.flats)):
        console.say(sentence)
    console.warn([*record.findings, *record.gross_errors.shift_sentences()])
    for sentence in (*row_sentences(record.gross_errors, result.mechanism),
                     *record.gross_errors.unchecked_sentences()):
        console.say(sentence)


def _show_errors(record: IdentificationRecord, console: Console) -> None:
    """Print errors before, after and on what was held out."""
    table = [[label, name, *(number(getattr(f, k)) for k in ("mean", "rms", "p95", "max")), f.unit]
             for label, found in (("before", record.residual.before),
                                  ("after", record.residual.after),
                                  ("held out", record.residual.holdout))
             for name, f in found.items()]
    console.table(plain_table(["", "error", "mean", "rms", "p95", "max", "unit"], table,
                              (2, 3, 4, 5)))
    console.say(f"Held out: {record.holdout_note}.")


def _show_noise(n: NoiseCheck, console: Console) -> None:
    from ppmcal.io.results.identification_wording import noise_verdict

    console.say(f"Noise: {noise_verdict(n)[0]}."
                + (f" Repeats scatter {n.repeat_ratio:.3g} times." if n.repeat_ratio else ""))
    if len(n.by_dataset) > 1:
        console.say("By file: " + ", ".join(f"{name} {number(r, 3)}"
                                            for name, r in n.by_dataset.items()) + ".")


def _show_parameters(record: IdentificationRecord, console: Console) -> None:
    """Print the parameters that moved farthest, in tolerances."""
    free = [p for p in record.parameters if p.status != "fixed"]
    shown = sorted(free, key=lambda p: -abs(p.error or 0.0) / (p.tolerance or 1.0))[:12]
    if shown:
        console.table(plain_table(
            ["parameter", "nominal", "error", "+- 95 %", "unit", "status"],
            [[p.name, number(p.nominal, 7), number(p.error),
              number(None if p.sigma is None else 1.96 * p.sigma, 3), p.unit,
              p.status] for p in shown], (1, 2, 3)))
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
        shown = ", ".join(f"{name} ({ratio:.2f})" for ratio, name in found[:6])
        more = f" and {len(found) - 6} more" if len(found) > 6 else ""
        console.say("Constrained by the prior rather than by these data (posterior sigma over "
                    f"tolerance): {shown}{more}.")


def _show_redundant(record: IdentificationRecord, prior: bool, console: Console) -> None:
    if not record.redundant:
        return
    names = ", ".join(d.name for d in record.redundant[:8])
    rest = len(record.redundant) - 8
    how = "constrained by the prior alone" if prior else "left where nothing else moves them"
    more = f" and {rest} more" if rest > 0 else ""
    console.say(f"Redundant (in unidentifiable combinations with others; {how}): {names}{more}.")


if TYPE_CHECKING:
    from collections.abc import Callable

    from ppmcal.calibration.fit import Fit, FitOptions
    from ppmcal.calibration.problem import Problem
    from ppmcal.model.dataset import Dataset
    from ppmcal.model.mechanism import Mechanism


@click.command("identify")
@click.argument("mech", type=FILE)
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
              help="Parameters that may change, in place of the file's; 'none' for frames only.")
@click.option("--holdout", default="0.2", show_default=True, metavar="FRACTION|CSV",
              help="Poses to hold out, or other measurements to test on; 0 for none.")
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
@quiet_option
@json_option
def command(mech: Path, data: tuple[Path, ...], out: Path, method: str, prior: str,
            damping: float, iterations: int | None, patterns: tuple[str, ...], holdout: str,
            sigma: str, start: Path | None, keep: bool, keep_outliers: bool, seed: int | None,
            quiet: bool, as_json: bool) -> None:
    """Identify the geometry of MECH from the measurements DATA (CSV files).

    Writes identified.yaml (a mechanism file), parameters.csv, residuals.csv and
    identification.json.
    """
    from dataclasses import replace

    from ppmcal.calibration.change_detection import carried_on
    from ppmcal.calibration.fit import FitOptions
    from ppmcal.calibration.misreading import refuse_misread
    from ppmcal.calibration.problem import Problem
    from ppmcal.calibration.summary import report
    from ppmcal.io import Output, provenance
    from ppmcal.io.results.identification import IdentificationRecord
    from ppmcal.io.results.knowledge import read_posterior, refuse_twice

    console = Console(quiet, as_json)
    _refuse_mixtures(method, prior, sigma, keep)
    mechanism, datasets = load(mech, data, patterns)
    other, fraction = _holdout(holdout, mechanism)
    tables = [*data, *(Path(d.source) for d in other)]
    inputs = [*mechanism.inputs, *(str(t) for t in tables),
              *(str(t.with_suffix(".yaml")) for t in tables)]
    notes: list[str] = []
    if start is not None:
        start = start / "identified.yaml" if start.is_dir() else start
        mechanism, notes = started(mechanism, start)
        inputs.append(str(start))
    old = start or mech
    before = read_posterior(old.with_name("identification.json"), mechanism) if keep else None
    inputs += [before.source] if before else []
    seed = 0 if seed is None else seed
    source = provenance(inputs, command_line(), seed)
    if before is not None:
        refuse_twice(before, source)
    chosen = "flat" if prior == "flat" else method
    options = FitOptions(chosen, damping, not keep_outliers and method != "damped", iterations)
    problem = Problem(mechanism, datasets, mechanism.free,
                      earlier=before.data() if before else None)
    if prior == "flat":
        _refuse_unobservable(problem, mech)
    with unit_findings_told(mechanism, datasets) as units, console.progress("Fitting") as show:
        show("comparing the measurements with the nominal machine")
        refuse_misread(problem)
        fit, odd = _fitted(problem, options, sigma, console, show)
        result = report(fit, options, fraction, seed, other)
    if before is not None:
        notes += odd + carried_on(fit, before, options)
    result = replace(result, findings=(*notes, *units, *result.findings), earlier=before)
    record = IdentificationRecord.of(result, source, chosen)
    with Output(out) as output:
        for name, text in record.files(result).items():
            output.add(name, text)
    show_result(result, record, console)
    finish(out, list(output.files), console)
    console.summary(record.summary())
    leave(bool(result.findings or result.gross_errors.homing_shifts))


def _refuse_mixtures(method: str, prior: str, sigma: str, keep: bool) -> None:
    """Refuse options that do not go together."""
    if sigma == "estimated" and method == "damped":
        raise click.UsageError("--sigma estimated goes with --method prior or gcv.")
    if method != "prior" and prior == "flat":
        raise click.UsageError(f"--prior flat goes with --method prior, not {method}.")
    if keep and method == "damped":
        raise click.UsageError("--keep goes with --method prior or gcv.")
    given = click.get_current_context().get_parameter_source("damping")
    if method != "damped" and given == click.core.ParameterSource.COMMANDLINE:
        raise click.UsageError("--damping goes with --method damped.")


def _fitted(problem: Problem, options: FitOptions, sigma: str, console: Console,
            show: Callable[[str], None]) -> tuple[Fit, list[str]]:
    """Fit, with the noise as stated or as the residuals show it; return what was odd too."""
    from ppmcal.calibration.identify import identify
    from ppmcal.calibration.noise import noise_check, with_estimated_noise

    def watch(i: int, c: float) -> None:
        show(f"iteration {i}, chi-squared {c:.6g}")

    odd: list[str] = []
    if sigma == "estimated":
        fit, factor = with_estimated_noise(problem, options, watch)
        _tell_noise(problem.datasets, factor, console)
    else:
        fit = identify(problem, options, watch)
        if problem.earlier is not None and noise_check(fit).failed:
            # what was known before must not pay for the noise of the new rows
            fit, factor = with_estimated_noise(problem, options, watch)
            odd = [f"{d.name}: residuals are {f:.3g} times the stated noise: something is missing "
                   "in the model, or sigma is too small; this file counts that much less"
                   for d, f in zip(problem.datasets, factor.tolist(), strict=True) if f > 1.0]
    _refuse_unconverged(fit, options)
    return fit, odd


def _tell_noise(datasets: tuple[Dataset, ...], factor: Any, console: Console) -> None:
    for d, f in zip(datasets, factor.tolist(), strict=True):
        console.say(f"{d.name}: noise {f:.3g} times the stated one.")


def _refuse_unobservable(problem: Problem, mech: Path) -> None:
    """Refuse a fit without tolerances that nothing keeps from shrinking or growing."""
    from ppmcal.calibration.identifiability import predict_identifiability
    from ppmcal.errors import BadInput

    scale = predict_identifiability(problem, "flat").scale
    if scale is not None and scale.unobservable:
        raise BadInput("these data do not hold the machine's size, and without tolerances "
                       "nothing else does: the fit would run off", f"{mech} with --prior flat",
                       "Keep the tolerances, fix the lengths or the drives (fixed: true), or add "
                       "a measured distance")


def _holdout(text: str, mechanism: Mechanism) -> tuple[tuple[Dataset, ...], float]:
    try:
        fraction = float(text)
    except ValueError:
        return readable(mechanism, [Path(text)]), 0.0
    if not 0.0 <= fraction < 1.0:
        raise click.UsageError(f"--holdout {text}: give a fraction from 0 to below 1, or a CSV.")
    return (), fraction


def _refuse_unconverged(fit: Fit, options: FitOptions) -> None:
    """Refuse a fit that is neither at its minimum nor at the noise, unless asked to stop there.

    Raises:
        NoResult: with how far it got.
    """
    from ppmcal.calibration.noise import noise_check
    from ppmcal.errors import NoResult

    if fit.converged or fit.stopped or options.iterations:
        return
    if options.method == "damped":
        raise NoResult(f"the damped scheme is too slow for these parameters: {fit.reached}",
                       "--method damped",
                       "Use a smaller --damping, fewer free parameters, --iterations to stop "
                       "where you want, or the prior (--method prior)")
    if noise_check(fit).failed:
        raise NoResult(f"the fit did not converge: {fit.reached}",
                       ", ".join(d.source for d in fit.problem.datasets),
                       "Run check on machine and data: units, order of columns, poses that tell "
                       "the parameters apart; or free fewer parameters, or try more --iterations")
