"""From a fit to statements: estimates with intervals, rank, noise check, residuals.

Everything here is derived from the fit's small triangle and one pass over the rows; nothing
is fitted again, except the frames of the nominal machine and of the held-out part.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import (
    BENT,
    LEAST,
    RANK_TOLERANCE,
    STATED,
    Fit,
    FitOptions,
    Flat,
    GrossErrors,
    Noise,
    Posterior,
    Rank,
    Unidentifiable,
    WeakCampaign,
    against_tolerances,
    branch_findings,
    contradictions,
    data_rows,
    find_gross_errors,
    flats,
    noise_check,
    observability,
    prediction_covariance,
    secondary,
    unidentifiable,
    whole_rank,
    with_noise,
)
from ppmcal.calibration.knowledge import (
    Considered,
    Estimate,
    Identifiability,
    SessionVariance,
    by_noise,
    cluster_robust,
    considered,
    coverage,
    estimates,
    far_from_nominal,
    identifiability,
    in_words,
    measured_by,
    none_considered,
    registered,
    with_estimates,
)
from ppmcal.calibration.validation.left_out_rows import (
    DoubtfulStretch,
    LeftOut,
    doubtful_stretches,
    left_out,
)
from ppmcal.calibration.validation.nominal_machine import before, nothing_before
from ppmcal.calibration.validation.residual_vectors import (
    Residuals,
    held_out,
    on_other,
    residuals,
    sessions_left_out,
)
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.notes import Note
from ppmcal.units import Finite, OrNull
from ppmcal.wording import chance, pluralize

BEYOND = 1e3
"""Upper limit of residuals over the noise within sessions: with a smaller noise, the evidence on
their differences drowns in round-off."""

DIAGNOSE = "`ppmcal diagnose` looks for what the model lacks"
"""What to do about residuals that noise does not explain."""


@dataclass(frozen=True)
class Dependence:
    """A redundant quantity: one unit of ``name`` acts like these amounts of the others.

    SI; in a file, units of the file.
    """

    name: str
    depends_on: Mapping[str, OrNull[Finite]]


@dataclass(frozen=True)
class Identification:
    """Everything that identify reports.

    ``fit``: if the noise check failed, with rows ``inflation`` times as noisy as stated.
    ``doubtful``: stretches where the machine differs in no way that the model knows.
    ``sessions``: how far they disagree, None for a single one; ``blocks``: the same for blocks
    of rows, None if they do not; ``covariance`` includes probable differences, with held
    parameters as exact; ``considered``: how far these may be off.
    ``unidentifiable``: what the data determine only in combination, as whole sets.
    ``campaign``: weaknesses of the poses, and missing ones; None: none.
    """

    fit: Fit
    mechanism: Mechanism
    estimates: tuple[Estimate, ...]
    rank: int
    redundant: tuple[Dependence, ...]
    noise: Noise
    observability: Mapping[str, float]
    columns: tuple[str, ...]
    covariance: Array
    inflation: float
    before: Residuals
    before_registrations: Mapping[str, Registration]
    after: Residuals
    holdout: Mapping[str, Mapping[str, float]]
    holdout_note: str
    findings: tuple[Note, ...]
    identifiability: Identifiability
    gross_errors: GrossErrors
    unidentifiable: tuple[Unidentifiable, ...] = ()
    flats: tuple[Flat, ...] = ()
    unexplained: Mapping[str, float] = field(default_factory=dict)
    earlier: Posterior | None = None
    doubtful: tuple[DoubtfulStretch, ...] = ()
    sessions: SessionVariance | None = None
    blocks: SessionVariance | None = None
    campaign: WeakCampaign | None = None
    considered: Considered | None = None

    @property
    def measured_volume(self) -> dict[str, tuple[float, float]]:
        """Range of the measured platform poses, by coordinate, base frame, SI."""
        seen = self.mechanism.measured
        return {} if seen is None else {name: seen.ranges[name]
                                        for name in self.mechanism.coordinates}


def rank_of(fit: Fit) -> tuple[Rank, int, tuple[Dependence, ...]]:
    """Return the geometry's rank, the rank of all columns, and the redundant ones.

    The total counts open frames and targets, which add none where geometry is confounded
    with them (theory.md, section 5).
    """
    count = len(fit.problem.free)
    triangle, _ = data_rows(fit)
    scaled = triangle * fit.scale
    # earlier rows are linearised: information from their bend against the new ones is not real
    largest = float(np.linalg.norm(scaled[:, :count], axis=0).max(initial=BENT))
    least = RANK_TOLERANCE if fit.problem.earlier is None else BENT / largest
    rank, kept, dropped = whole_rank(triangle, count, fit.scale, least,
                                     fit.problem.columns)
    redundant = []
    norms = np.linalg.norm(scaled, axis=0)
    for d in dropped:
        used = [k for k in kept if k != d]
        solution = linalg.lstsq(scaled[:, used], scaled[:, d], rcond=RANK_TOLERANCE)[0]
        weight = np.abs(solution) * norms[used]
        depends = {fit.problem.columns[k]: float(v * fit.scale[k] / fit.scale[d])
                   for k, v, w in zip(used, solution, weight, strict=True)
                   if w > 1e-6 * max(float(weight.max(initial=0.0)), 1e-300)
                   and norms[d] > RANK_TOLERANCE * norms.max()}
        redundant.append(Dependence(fit.problem.columns[d], depends))
    return rank, len(kept), tuple(redundant)


def report(fit: Fit, options: FitOptions, holdout: float, seed: int,
           other: Sequence[Dataset] = (), leave_out: str = "", chosen: Collection[str] = ()
           ) -> Identification:
    """Return all results of a fit.

    Args:
        fit: a finished one.
        options: those of the fit.
        holdout: fraction of the poses to hold out (0: none).
        seed: of the poses that are held out.
        other: data sets to predict instead; their unknown frames or targets are registered on
            them alone.
        leave_out: ``session``: hold out each session in turn instead of poses.
        chosen: names of parameters that the file frees but a choice of freedoms held: the
            intervals include how far they may be off. Parameters held by the user are exact
            there; for predicted poses no parameter that may be off is.

    Raises:
        BadInput, NoResult: see
            :func:`ppmcal.calibration.validation.residual_vectors.sessions_left_out`.
    """
    noise, notes = noise_check(fit), list[Note]()
    inflation = noise.inflation
    rank, total, redundant = rank_of(fit)
    raw, fit = fit, with_noise(fit, inflation, options)
    wrong = (secondary("what left-out rows would change", lambda: find_gross_errors(raw, fit),
                       GrossErrors((), {}, (), ()), notes),
             secondary("the shape of the flat", lambda: tuple(flats(raw)), (), notes))
    against = secondary("readings that contradict each other", lambda: contradictions(raw), [],
                        notes)
    noise = secondary("the errors against the tolerances",
                      partial(against_tolerances, noise, fit), noise, notes)
    sessions, blocks = _differences(fit, noise, notes)
    wider = sessions or blocks
    kept = secondary("what held parameters may be off by", lambda: considered(fit),
                     none_considered(fit), notes)
    more = np.diagonal(kept.in_frames(kept.more(chosen)))
    found = estimates(fit, rank, wider, by_noise(fit, options, more), more, kept.pull)
    mechanism = replace(with_estimates(fit, found), measured=measured_by(fit, noise))
    was = secondary("the errors before calibration", lambda: before(fit.problem, fit.keep),
                    nothing_before(fit.problem), notes)
    stood = {**registered(fit.problem, fit.state), **was.registrations}
    held, note = _held(fit, options, holdout, seed, other, leave_out, inflation, notes)
    after = residuals(fit.problem, fit.state)
    out = secondary("what left-out rows have in common", lambda: left_out(fit),
                    LeftOut(0, 0, False, "", 0.0, 0.0), notes)
    index = secondary("the observability indices", lambda: observability(
        rank.singular, len(rank.kept), sum(int(k.sum()) for k in fit.keep)), {}, notes)
    told = _findings(fit, noise, inflation, found, out, (wider, blocks), notes)
    open_ = secondary("what the data leave open", lambda: identifiability(fit, coverage(fit)),
                      Identifiability(None, ()), notes)
    sets = secondary("what the data see only together",
                     lambda: unidentifiable(rank, fit.problem.columns), (), notes)
    doubtful = secondary("where the machine may be another",
                         lambda: doubtful_stretches(fit, after, out), (), notes)
    return Identification(
        fit, mechanism, found, total, redundant, noise, index, fit.problem.columns,
        kept.in_frames(wider.covariance if wider and wider.differ else prediction_covariance(fit)),
        inflation,
        was.residuals, stood, after, held, note, (*against, *told, *unchecked(fit, total), *notes),
        open_, wrong[0], sets, wrong[1], _unexplained(after.figures(fit.keep), noise),
        doubtful=doubtful, sessions=sessions, blocks=blocks, considered=kept)


def _differences(fit: Fit, noise: Noise, notes: list[Note]
                 ) -> tuple[SessionVariance | None, SessionVariance | None]:
    """Return how far sessions, and blocks of rows, differ; see :func:`cluster_robust`.

    Left out if the tolerances drown in the round-off of data that are much better, such as exact
    ones.
    """
    return secondary("how far sessions, or stretches of rows, differ",
                     lambda: cluster_robust(fit, min(noise.inflation, BEYOND)), (None, None), notes)


def _held(fit: Fit, options: FitOptions, holdout: float, seed: int, other: Sequence[Dataset],
          leave_out: str, inflation: float, notes: list[Note]
          ) -> tuple[Mapping[str, Mapping[str, float]], str]:
    """Return the figures on rows held out of a fit, and how they were obtained.

    A prediction requested by name is not an extra: if it fails, so does the command.
    """
    if leave_out:
        return sessions_left_out(fit.problem, options, fit.keep, inflation)
    if other:
        return on_other(fit, other)
    if holdout <= 0.0:
        return {}, "nothing held out"
    return secondary("the prediction of held-out poses",
                     lambda: held_out(fit, options, holdout, seed, inflation),
                     ({}, "no fit without the held-out poses"), notes)


def _unexplained(after: Mapping[str, Mapping[str, float]], noise: Noise) -> dict[str, float]:
    """Return the rms that neither model nor noise explains, m and rad, in the rows used.

    It is present at other poses too, whatever its cause.
    """
    return {kind: noise.unexplained * figures["rms"] for kind, figures in after.items()
            if kind in ("position", "rotation") and noise.unexplained}


def _findings(fit: Fit, noise: Noise, inflation: float, found: Sequence[Estimate], gone: LeftOut,
              apart: tuple[SessionVariance | None, SessionVariance | None], notes: list[Note]
              ) -> tuple[Note, ...]:
    out = [f for d in fit.problem.datasets for f in d.findings]
    if fit.taken_back:
        out.append(Note(f"no way from home led to a pose of the nominal machine in "
                        f"{pluralize(fit.taken_back, 'row')}; with the fitted machine it does, and "
                        "they are in use", topic="row weights"))
    if gone.sentence:
        out.append(Note(f"{gone.sentence}; {DIAGNOSE}", topic="row weights"))
    if noise.failed:
        out.append(Note(
            f"the residuals are {noise.sigma_ratio:.2f} times the {noise.source} noise "
            f"({chance(noise.chi2_p)}): something is missing in the model, or sigma is too "
            f"small; every measurement counts as {inflation:.2f} times as noisy as "
            f"{noise.source}; {DIAGNOSE}"
            + ", --sigma estimated takes the residuals for noise" * (noise.source == STATED),
            topic="noise"))
    if noise.overstated:
        out.append(Note(
            f"the residuals are only {noise.sigma_ratio:.3g} times the {noise.source} noise: "
            "sigma is too large, in a wrong unit perhaps, so intervals are too wide"
            + (" and the data count too little against the tolerances" if fit.by_tolerances
               else "") + ("; correct it, or use --sigma estimated" if noise.source == STATED else
                           "; correct what the estimate begins with"), topic="noise"))
    out += secondary("limbs in the opposite branch",
                     lambda: branch_findings(fit.problem, fit.state), [], notes)
    if noise.tight:
        out.append(_tight(noise, "so 95 % intervals hold less often; widen the tolerances or use "
                                 "--prior flat"))
    alone = [np.nan if (h := found[p].half_by_noise) is None else h for p in fit.problem.free]
    out += secondary("which parameters sessions disagree about",
                     lambda: in_words(fit, apart[0], np.array(alone), apart[1]), [], notes)
    out += secondary("parameters far from nominal", lambda: far_from_nominal(
        found, fit.problem.mechanism.units), [], notes)
    if fit.stopped:
        out.append(Note(f"the fit was stopped {fit.stopped}: parameters that these data hardly see "
                        "are still near nominal, which the intervals do not allow for; --method "
                        "prior does", topic="convergence"))
    elif not fit.converged:
        out.append(Note("the fit had not converged after "
                        f"{pluralize(fit.iterations, 'iteration')}: use more --iterations, free "
                        "fewer parameters, or measure poses that distinguish them",
                        topic="convergence"))
    # last, because the reasons for left-out rows are printed below it
    for data, reasons in zip(fit.problem.datasets, fit.reasons, strict=True):
        if reasons:
            out.append(rows_left_out(data, reasons))
    return tuple(out)


def _tight(noise: Noise, then: str) -> Note:
    """Return a note on errors larger than tolerances and noise allow; ``then``: what follows."""
    times = (noise.prior_chi2 / noise.prior_degrees) ** 0.5
    return Note(f"the machine's errors are {times:.2g} times what tolerances and noise allow "
                f"({chance(noise.prior_p)}): the tolerances are too tight, or something is missing "
                f"in the model, {then}", topic="tolerances")


def beyond_tolerances(fit: Fit) -> list[Note]:
    """Return in words what a fit finds farther from nominal than tolerances and noise allow."""
    noise = noise_check(fit)
    fit = with_noise(fit, noise.inflation, FitOptions())
    noise, (rank, *_) = against_tolerances(noise, fit), rank_of(fit)
    far = far_from_nominal(estimates(fit, rank), fit.problem.mechanism.units, "identify lists")
    tight = _tight(noise, "or the mechanism file is wrong; `ppmcal identify` shows where")
    return [*[tight] * (noise.tight and not far), *far]


def rows_left_out(data: Dataset, reasons: Mapping[int, str]) -> Note:
    """Return the number of rows left out of a data set, and where the ``reasons`` are."""
    return Note(f"{data.name}: {len(reasons)} of {len(data)} rows left out, see residuals.csv for "
                "each reason", topic="row weights")


def unchecked(fit: Fit, rank: int) -> list[Note]:
    """Return a note if the data have no redundancy with which to check their noise.

    Args:
        fit: a finished one; continued from an earlier one, it has the redundancy of both.
        rank: of all columns: the number of values that the data determine.
    """
    more = fit.information.count - rank
    if fit.problem.earlier is not None or more >= LEAST or not rank:
        return []
    values = pluralize(round(fit.information.count), "measured value")
    sigma = "sigma that its estimate begins with" if all(
        d.estimated for d in fit.problem.datasets) else "stated sigma"
    return [Note(f"{values} for {rank} that they determine: too few to check the noise by, so "
                 f"intervals rest on the {sigma} alone; measure more poses", topic="few rows")]
