"""Learned terms: the effect of the most probable unknown causes, as functions without a cause.

Which functions are present is inferred along with all other causes; their values are the posterior
of the same blocks, at the reported fits, from the rows that are not outliers. They go into the
machine unless they clearly predict held-out poses worse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ppmcal.calibration.fit import Fit, FitOptions, rows_with_outliers
from ppmcal.calibration.validation import split
from ppmcal.diagnosis.equation_forms import Equation
from ppmcal.diagnosis.equations import equations, sized_again
from ppmcal.diagnosis.explanation import Round
from ppmcal.diagnosis.held_out_gap import Gap, measure_gap
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.learning import Learned, Placed, learned
from ppmcal.diagnosis.linear_system import INVISIBLE, MOST_ROWS, Whitening, build, range_basis
from ppmcal.diagnosis.options import DiagnosisOptions
from ppmcal.diagnosis.refit import with_mechanism
from ppmcal.diagnosis.result import Found, LearnedTerms
from ppmcal.diagnosis.term_candidates import Visible
from ppmcal.diagnosis.unknown_causes import UnknownCause
from ppmcal.errors import PpmcalError
from ppmcal.inference.priors import SURE
from ppmcal.linalg import Bools, subsample
from ppmcal.model.dataset import Dataset
from ppmcal.model.effects.learned import JOINT, learned_kind
from ppmcal.model.mechanism import Mechanism, with_effect


def learned_beyond(asked: Round, found: Found, named: bool, whole: Fit, held: Sequence[Dataset],
                   options: DiagnosisOptions) -> LearnedTerms | None:
    """Return unknown causes as learned terms; None if not functions, or predicting clearly worse.

    Args:
        asked: the last question and its answer.
        found: the fits of the training rows.
        named: whether the last of these has effects.
        whole: the current fit of all rows.
        held: the held-out poses.
        options: of the diagnosis.
    """
    forms = functions(asked)
    if not (forms and held):
        return None
    belong = [there.copy() for there in rows_with_outliers(whole)]
    for dataset, row in asked.rows:
        belong[dataset][row] = False
    out = split(whole.problem.datasets, options.holdout, options.seed)
    base = found.after if named else found.before
    training = [b[~o] & r for b, o, r in zip(belong, out, rows_with_outliers(base), strict=True)]
    return learned_terms((base, training), (whole, belong), forms, held, asked.whitening,
                         found.noise, options)


def functions(asked: Round) -> list[Placed]:
    """Return the most probable function of each unknown cause; anonymous shapes count as one."""
    sources = asked.asked.sources
    causes = {(c.curve.inputs, c.curve.acts, c.curve.signed, c.on): c for c in sources
              if isinstance(c, UnknownCause) and c.curve is not None}
    every = asked.fit.problem.mechanism.actuators
    out: dict[str, Placed] = {}
    for place in asked.unnamed:
        source = sources[place.leader]
        if isinstance(source, Hypothesis):
            key = (("travel",), JOINT, False, tuple(a in source.on for a in every))
            source = causes.get(key, source)
        if isinstance(source, UnknownCause) and source.curve is not None:
            out[source.label] = source.curve, source.on
    return list(out.values())


def with_learned(whole: Fit, terms: LearnedTerms | None, options: FitOptions) -> Fit:
    """Return a fit of all rows with the learned terms, if any, in the machine."""
    if terms is None:
        return whole
    return with_mechanism(whole, with_terms(whole.problem.mechanism, terms.learned), options)


def learned_terms(training: tuple[Fit, Sequence[Bools]], whole: tuple[Fit, Sequence[Bools]],
                  forms: Sequence[Placed], held: Sequence[Dataset], whitening: Whitening,
                  noise: float, options: DiagnosisOptions) -> LearnedTerms | None:
    """Return functions learned beyond a fit, None if rows do not determine or contradict them.

    Args:
        training: the fit without the held-out rows, and the rows to learn from (N,).
        whole: the same for all rows.
        forms: the functions.
        held: rows left out of ``training``.
        whitening: of the residuals.
        noise: over the stated noise.
        options: of the diagnosis.
    """
    base = training[0]
    try:
        trained, rows, fit = _fitted(*training, forms, whitening, options.fit)
        gap = measure_gap(base, fit, held, noise, options.seed)
        if gap is None or gap.worse:
            return None
        terms, seen, final = _fitted(*whole, forms, whitening, options.fit)
    except PpmcalError:
        return None
    short = _as_well(base, fit, trained, rows, gap, held, options)
    return LearnedTerms(terms, seen, whole[0], final, gap, sized_again(seen, terms, short))


def _as_well(base: Fit, fit: Fit, terms: Learned, seen: Visible, gap: Gap,
             held: Sequence[Dataset], options: DiagnosisOptions
             ) -> tuple[Equation | None, ...]:
    """Return the equations of the training rows that predict held-out poses as well as the terms.

    Each replaces its own term, with the others unchanged. ``fit``: with the terms; ``gap``: its
    own.
    """
    out: list[Equation | None] = []
    for i, found in enumerate(equations(seen, terms)):
        after = None
        if found is not None:
            curves = (*terms.curves[:i], found, *terms.curves[i + 1:])
            machine = with_terms(base.problem.mechanism, replace(terms, curves=curves))
            try:
                other = with_mechanism(base, machine, options.fit)
                after = measure_gap(fit, other, held, gap.noise, options.seed)
            except PpmcalError:
                after = None
        spare = (1.0 - SURE.value) * max(gap.before**2 - gap.after**2, 0.0)
        good = after is not None and not after.worse and (
            after.after**2 - after.before**2 <= spare)
        out.append(replace(found, after=after.after) if good and found and after else None)
    return tuple(out)


def _fitted(fit: Fit, rows: Sequence[Bools], forms: Sequence[Placed], whitening: Whitening,
            options: FitOptions) -> tuple[Learned, Visible, Fit]:
    """Return the terms, the rows used to learn them, and the fit with them.

    Raises:
        NoResult: the rows do not determine one of them.
    """
    seen = visible(fit, rows, whitening)
    found = learned(seen, forms)
    return found, seen, with_mechanism(fit, with_terms(fit.problem.mechanism, found), options)


def visible(fit: Fit, keep: Sequence[Bools], whitening: Whitening) -> Visible:
    """Return rows of a fit with the residuals that geometry and effects cannot absorb."""
    system = build(fit.problem, fit.state, subsample(list(keep), MOST_ROWS))
    basis = range_basis(whitening.apply(system.jacobian, system), INVISIBLE)
    residual = whitening.apply(system.residual[..., None], system)[:, 0]
    return Visible(system, whitening, basis, residual - basis @ (basis.T @ residual))


def with_terms(mechanism: Mechanism, found: Learned) -> Mechanism:
    """Return the machine with learned terms as fixed effects."""
    for term, curve in zip(found.terms, found.curves, strict=True):
        mechanism = with_effect(mechanism, learned_kind(curve), term.on, {})
    return mechanism
