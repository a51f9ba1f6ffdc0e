"""The machine's geometry from measurements."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    hint_sentences,
    noise_check,
    noise_sentences,
    registration_hints,
    secondary,
    too_few,
    with_estimated_noise,
)
from ppmcal.calibration.fit import identify as fitted
from ppmcal.calibration.interpretation import (
    InterpretationError,
    place_hints,
    refuse_after_fit,
    refuse_before_fit,
    refuse_columns,
    refuse_other_machine,
    slack_ropes,
    unit_findings,
    without_known,
    without_shared,
)
from ppmcal.calibration.knowledge import (
    choice_sentence,
    coverage,
    noise_beyond_tolerances,
    predict_identifiability,
    pulled_apart,
    tilt_sentences,
    with_chosen_freedoms,
    with_held,
)
from ppmcal.calibration.validation import Identification, report, unused, unused_sentences
from ppmcal.commands.identify.options import IdentifyArguments
from ppmcal.commands.identify.result import IdentificationResult
from ppmcal.commands.inputs import data_files, datasets_of, prepared, started
from ppmcal.commands.spec import Path_, Refusal
from ppmcal.design.missing_poses import poses_to_tell, weak_campaign
from ppmcal.errors import BadInput, NoResult, PpmcalError
from ppmcal.io.results.knowledge import KNOWLEDGE, check_data_not_reused, read_posterior
from ppmcal.io.results.parts import MISREAD, misreading_entries
from ppmcal.io.sidecar import sidecar_path
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import too_long
from ppmcal.wording.progress import start_stage

APART, FREEDOMS, MISSING, PATTERN, TOLERATED = (
    "whether instruments pull apart", "whether some parameters should be one",
    "which poses are missing", "whether residuals have a pattern",
    "whether the tolerances are kept")
"""What is reported beside a fit."""
PERCENT = re.compile(r"(\d+(?:\.\d+)?) ?%")
AMPLE = 12
"""With so many values more than columns a residual is in too many directions for a pattern, and
nothing of the diagnosis need be loaded."""


def run(asked: IdentifyArguments) -> IdentificationResult:
    """Identify the geometry of a machine from measurements."""
    method, prior, sigma, seed, start = (
        asked.method, asked.prior, asked.sigma, asked.seed, asked.start)
    refuse_mixtures(method, prior, sigma, asked.keep)
    machine, datasets = prepared(asked.mechanism, asked.data, asked.free)
    other, fraction = _held_out(asked.holdout, machine)
    other, notes = _of_their_own(datasets, other)
    inputs: list[Path_] = [*machine.inputs, *data_files((*datasets, *other))]
    origin = Path(machine.source)
    if start is not None:
        origin = Path(start) / "identified.yaml" if Path(start).is_dir() else Path(start)
        machine, more = started(machine, origin)
        notes += more
        inputs.append(str(origin))
    before = read_posterior(origin.with_name(KNOWLEDGE), machine) if (
        asked.keep) else None
    inputs += [before.source] if before else []
    source = source_of("identify", inputs, seed)
    if before is not None:
        check_data_not_reused(before, source)
        datasets, other = (without_known(d, machine.actuators, before.known, before.source)
                           for d in (datasets, other))
    chosen = "flat" if prior == "flat" else method
    options = FitOptions(chosen, asked.damping,
                         not asked.keep_outliers and method != "damped", asked.iterations)
    problem = Problem(machine, datasets, machine.free, earlier=before.data() if before else None)
    if prior == "flat":
        _refuse_unobservable(problem, machine.source)
    with with_unit_findings(machine, datasets) as units:
        start_stage("comparing the measurements with the nominal machine")
        refuse_before_fit(problem)
        start_stage("choosing what to fit")
        extra = list[Note]()
        as_filed = problem
        problem, choice = secondary(
            FREEDOMS, partial(with_chosen_freedoms, problem, options, _estimated(problem, sigma)),
            (problem, None), extra)
        start_stage("fitting")
        fit, odd, told = fitted_rows(problem, options, sigma)
        start_stage("looking for wrong rows")
        refuse_after_fit(fit)
        start_stage("judging the fit")
        held = set(as_filed.free) - set(problem.free)
        found = report(fit, options, fraction, seed, other, asked.leave_out,
                       [machine.names[p] for p in held])
        _refuse_wandering(fit, found, options)
        if chosen == "prior":
            refuse_other_machine(found.fit)
    start_stage("judging the campaign")
    if held:
        found = replace(found, identifiability=secondary(
            "what the data leave open", lambda: with_held(found.fit, held),
            found.identifiability, extra))
    campaign = secondary(MISSING, lambda: weak_campaign(found.fit, seed), None, extra)
    also = partial(said_beside, extra)
    # what an earlier calibration knew may be all that so few poses lack
    beside = [] if before is not None or not problem.free else also(
        "whether the poses are too few", lambda: too_few(fit))
    if chosen == "prior":
        beside += also("what else the registration might fit", lambda: hint_sentences(
            found.fit, registration_hints(found.fit)))
        beside += also("whether a stated point is elsewhere", lambda: place_hints(found.fit))
    beside += also(PATTERN, lambda: left_over(fit, seed))
    if before is not None:
        from ppmcal.calibration.sessions import carried_on

        notes += odd + also("how far the machine has changed",
                            lambda: carried_on(fit, before, options))
    beside += also("whether ropes are slack", lambda: slack_ropes(fit))
    beside += also(TOLERATED, lambda: noise_beyond_tolerances(fit, _estimated(problem, sigma)))
    beside += also("what touches beside the tool leave open", lambda: tilt_sentences(found.fit))
    if sigma != "estimated":
        beside += also(APART, lambda: pulled_apart(fit, problem.datasets))
    told += [*also("the scale of true lengths", lambda: scale_sentences(found)),
             *also("the offsets of encoders", lambda: offset_sentences(found)),
             *([choice_sentence(choice)] if choice else [])]
    whole = replace(found, findings=(
        *unused_sentences(found.fit), *notes, *units, *beside, *extra, *found.findings),
                    earlier=before, campaign=campaign)
    return IdentificationResult(source, tuple(whole.findings), whole, chosen, tuple(told),
                                choice)


def when_refused(error: PpmcalError, _: IdentifyArguments, __: Path | None) -> Refusal:
    """Return why there is no result; of files that were read wrongly also how to read them."""
    entries = (misreading_entries(error.found, error.units)
               if isinstance(error, InterpretationError) else ())
    return Refusal({"format": MISREAD, "exit_code": error.exit_code, "reason": str(error),
                    "misreadings": [e.entries() for e in entries]})


def said_beside(failed: list[Note], what: str, make: Callable[[], Iterable[Note]]) -> list[Note]:
    """Return the sentences of an analysis beside a fit; where it fails ``failed`` says that."""
    return secondary(what, lambda: list(make()), [], failed)


def scale_sentences(found: Identification) -> Iterator[Note]:
    """Yield what each data set shows of true lengths, where that was fitted, with 95 %."""
    fit, names, none = found.fit, list(found.columns), unused(found.fit)
    for i, (data, registration) in enumerate(zip(fit.problem.datasets, fit.state.registrations,
                                                 strict=True)):
        column = f"scale of {data.name}"    # targets of one file share that of the first
        if data.scale.fitted and column in names and i not in none:
            place = names.index(column)
            sigma = float(np.sqrt(found.covariance[place, place]))
            half = coverage(fit) * sigma
            stated = "" if data.scale.sigma is None else (
                f"; its file says {float(data.scale.value[0]):g} with a standard deviation of "
                f"{data.scale.sigma:g}")
            yield Note(f"{data.name}: readings come out {too_long(registration.scale)} "
                       f"(+- {100.0 * half:.2g} %, 95 %){stated}.", NOTE)


def offset_sentences(found: Identification) -> Iterator[Note]:
    """Yield what each encoder at a joint reads more than is true, where fitted, with 95 %."""
    fit, names, none = found.fit, list(found.columns), unused(found.fit)
    for i, (data, at) in enumerate(zip(fit.problem.datasets, fit.state.registrations,
                                       strict=True)):
        own = [n for n in names if n.startswith("offset.") and n.endswith(f" of {data.name}")]
        if data.offset.fitted and own and i not in none:
            place, units = names.index(own[0]), data.units
            half = coverage(fit) * float(np.sqrt(found.covariance[place, place]))
            yield Note(f"{data.name}: the encoder at {data.kind.at} reads "
                       f"{units.words(at.offset, data.kind.quantity, 6)} more than is true (+- "
                       f"{units.words(half, data.kind.quantity, 2)}, 95 %).", NOTE)


def refuse_mixtures(method: str, prior: str, sigma: str, keep: bool) -> None:
    """Refuse options that do not go together.

    Raises:
        BadInput: with the option, and what goes with it.
    """
    for value, name, allowed in ((method, "method", ("prior", "gcv", "damped")),
                                 (prior, "prior", ("tolerances", "flat")),
                                 (sigma, "sigma", ("stated", "estimated"))):
        if value not in allowed:
            raise BadInput(f"'{value}' is not a {name}", f"--{name}",
                           f"There are: {', '.join(allowed)}")
    if sigma == "estimated" and method == "damped":
        raise BadInput("--sigma estimated goes with --method prior or gcv", "--method",
                       "Choose one")
    if method != "prior" and prior == "flat":
        raise BadInput(f"--prior flat goes with --method prior, not {method}", "--method",
                       "Choose one")
    if keep and method == "damped":
        raise BadInput("--keep goes with --method prior or gcv", "--method", "Choose one")


@contextmanager
def with_unit_findings(mechanism: Mechanism, datasets: Sequence[Dataset]) -> Iterator[list[Note]]:
    """Yield what `check` says of units and limits; a fit that fails inside says it too."""
    found = unit_findings(mechanism, datasets, sidecar_path)
    try:
        yield found
    except InterpretationError as error:
        if error.found:
            raise
        raise InterpretationError(error.what, error.where,
                                  " ".join([*found, error.hint]).strip()) from None
    except PpmcalError as error:
        hint = " ".join([*found, error.hint]).strip()
        where = error.where or ", ".join(d.source for d in datasets)
        raise type(error)(error.what, where, hint) from None


def fitted_rows(problem: Problem, options: FitOptions, sigma: str
                ) -> tuple[Fit, list[Note], list[Note]]:
    """Fit, with the noise as stated or as the residuals show it.

    Returns:
        The fit, what was odd about the noise, and what the estimated noise is.
    """
    odd, told = list[Note](), list[Note]()
    which = _estimated(problem, sigma)
    if any(which) and options.method != "damped":
        fit, factor = with_estimated_noise(problem, options, which)
        told = noise_sentences(problem, factor, which)
    else:
        fit = fitted(problem, options)
        if problem.earlier is not None and noise_check(fit).failed:
            # what was known before must not pay for the noise of the new rows
            fit, factor = with_estimated_noise(problem, options)
            odd = [Note(f"{d.name}: residuals are {f:.3g} times the stated noise: something is "
                        "missing in the model, or sigma is too small; this file counts that much "
                        "less; identify it alone, or look with `ppmcal diagnose`")
                   for d, f in zip(problem.datasets, factor.tolist(), strict=True) if f > 1.0]
    _refuse_unconverged(fit, options)
    return fit, odd, told


def _estimated(problem: Problem, sigma: str) -> list[bool]:
    """Return the data sets whose noise is estimated."""
    return [sigma == "estimated" or d.estimated for d in problem.datasets]


def _refuse_unobservable(problem: Problem, source: str) -> None:
    """Refuse a fit without tolerances that nothing keeps from shrinking or growing."""
    scale = predict_identifiability(problem, "flat").scale
    if scale is not None and scale.unobservable:
        raise BadInput("these data do not hold the machine's size, and without tolerances "
                       "nothing else does: the fit would run off", f"{source} with --prior flat",
                       "Keep the tolerances, fix the lengths or the drives (fixed: true), or add "
                       "a measured distance")


def left_over(fit: Fit, seed: int) -> list[Note]:
    """Return what pattern a residual has that hardly any freedom is left for, in words."""
    if fit.information.count > len(fit.problem.columns) + AMPLE:
        return []
    from ppmcal.diagnosis.left_over_pattern import left_over_pattern, pattern_sentence

    pattern = left_over_pattern(fit)
    if pattern is None:
        return []
    touches = all(d.kind.touches for d in fit.problem.datasets)
    more = poses_to_tell(fit, pattern.slots, seed)
    return [Note(f"{pattern_sentence(pattern, more, touches)}.")]


def _held_out(holdout: Any, machine: Mechanism) -> tuple[tuple[Dataset, ...], float]:
    """Return other measurements to test on, or the part of the poses to hold out."""
    try:
        fraction = float(holdout)
    except (TypeError, ValueError):
        if isinstance(holdout, str) and (percent := PERCENT.fullmatch(holdout)):
            raise BadInput(f"'{holdout}' is not a fraction of the poses", "--holdout",
                           f"Write --holdout {float(percent[1]) / 100.0:g}") from None
        return datasets_of(machine, holdout), 0.0
    if not 0.0 <= fraction < 1.0:
        raise BadInput(f"{holdout} is not a fraction of the poses", "--holdout",
                       "Give a fraction from 0 to below 1, or a CSV")
    return (), fraction


def _of_their_own(datasets: Sequence[Dataset], other: Sequence[Dataset]
                  ) -> tuple[tuple[Dataset, ...], list[Note]]:
    """Return held-out measurements without rows that the fit has too, and what is left out.

    Raises:
        BadInput: one has no row of its own.
    """
    if not other:
        return (), []
    told = {f for d in other for f in d.findings}
    own = without_shared((*datasets, *other))[len(datasets):]
    return own, [f for d in own for f in d.findings if f not in told]


def _refuse_unconverged(fit: Fit, options: FitOptions) -> None:
    """Refuse a fit that is neither at its minimum nor at the noise, unless asked to stop there.

    Raises:
        NoResult: with how far it got.
        InterpretationError: columns that are read in another way agree better.
    """
    if fit.converged or fit.stopped or options.iterations:
        return
    if options.method == "damped":
        raise NoResult(f"the damped scheme is too slow for these parameters: {fit.reached}",
                       "--method damped",
                       "Use a smaller --damping, fewer free parameters, --iterations to stop "
                       "where you want, or the prior (--method prior)")
    if noise_check(fit).failed:
        refuse_columns(fit)
        raise _unconverged(fit, fit.reached)


def _refuse_wandering(fit: Fit, found: Identification, options: FitOptions) -> None:
    """Refuse a fit that finds no minimum once its rows are as noisy as they show themselves to be.

    Raises:
        NoResult: with that noise.
    """
    if fit.converged and not found.fit.converged and not options.iterations:
        raise _unconverged(fit, f"with rows {found.inflation:.3g} times as noisy as stated, which "
                           "is what they leave, it does not come to a minimum")


def _unconverged(fit: Fit, reached: str) -> NoResult:
    return NoResult(f"the fit did not converge: {reached}",
                    ", ".join(d.source for d in fit.problem.datasets),
                    "Run check on machine and data: units, order of columns, poses that tell "
                    "the parameters apart; or free fewer parameters, or try more --iterations")
