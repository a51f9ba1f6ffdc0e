"""Results of a diagnosis, as plain data; SI."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ppmcal.calibration.compensation import CandidateModel
from ppmcal.calibration.fit import ENOUGH_REPEATS, Z95, Fit
from ppmcal.calibration.validation import Identification, Validated
from ppmcal.diagnosis.equation_forms import Equation
from ppmcal.diagnosis.extended_model import Added
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.hypotheses import Hypothesis, Untestable
from ppmcal.diagnosis.lack_of_fit import LackOfFit, pure_error
from ppmcal.diagnosis.learning import Learned
from ppmcal.diagnosis.linearisation import Linearisation
from ppmcal.diagnosis.localization import Place
from ppmcal.diagnosis.next_experiment import Proposal
from ppmcal.diagnosis.term_candidates import Visible
from ppmcal.inference.priors import SURE_SIGMAS
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.units import Key, Quantity

OfUnit = Annotated[float, Quantity(of="unit")]
VERDICTS = ("none", "weak", "named", "named-set", "partial", "unnamed")
NAMED = ("named", "named-set", "partial")
"""Verdicts that name something."""
SILENT = ("none", "weak")
"""Verdicts without a proven effect."""
LEARNED_AFTER = ("unnamed", "partial")
"""Verdicts that leave something to learn."""


@dataclass(frozen=True)
class Onset:
    """The row of the campaign where an event starts, with its 95 % interval.

    ``dataset``: the file within which rows are counted, if set.
    """

    row: Annotated[int, Key("value")]
    low: int
    high: int
    dataset: str = ""


@dataclass(frozen=True, eq=False)
class SessionEffect:
    """The size of one effect in each session, everything else shared.

    Attributes:
        labels: of the sessions in which it is observable (S,).
        names: of its free parameters in the model (p,).
        value, sigma: SI (S, p).
        same: probability that it is the same in all of them.
        times: coverage factor, half of a 95 % interval over ``sigma``, as the noise is estimated.
    """

    labels: tuple[str, ...]
    names: tuple[str, ...]
    value: Array
    sigma: Array
    same: float
    times: float = Z95


@dataclass(frozen=True)
class NamedEffect:
    """One effect for which the data are evidence.

    ``parameters``: names in the model; ``visibility``: the part that geometry leaves;
    ``probability`` that it is present rather than an alternative; ``alternatives``: labels of what
    may be present instead, with their ``probabilities``; ``hypothesis``: its origin, which may have
    a value for each of several actuators; ``onset``: for an event, the row where it starts;
    ``sessions``: its size in each of several sessions.
    """

    kind: str
    on: tuple[str, ...]
    parameters: tuple[str, ...]
    visibility: float
    probability: float
    alternatives: tuple[str, ...]
    probabilities: tuple[float, ...]
    hypothesis: Hypothesis
    onset: Onset | None = None
    sessions: SessionEffect | None = None

    @property
    def odds(self) -> tuple[float, ...]:
        """How much more probable it is than each of the alternatives."""
        return tuple(self.probability / p for p in self.probabilities)

    def side(self, mechanism: Mechanism) -> str:
        """Return whether the joint ``lags`` or ``leads`` its reading; empty for other kinds.

        Args:
            mechanism: with the fitted values.
        """
        kind = self.hypothesis.effect
        if kind is None or kind.reversal is None:
            return ""
        return kind.reversal.side({
            n.rpartition(".")[2]: mechanism.parameters[mechanism.names.index(n)].value
            for n in self.parameters})


@dataclass(frozen=True)
class Candidate:
    """One hypothesis of the library and its status.

    ``probability`` that it is present; ``visibility``: the part that geometry leaves, nan if the
    rows in use do not show it; ``status``: named, alternative, weak, not needed.
    """

    hypothesis: Hypothesis
    probability: float
    visibility: float
    status: str
    alternatives: tuple[str, ...] = ()


@dataclass(frozen=True)
class UnknownFound:
    """An unknown cause: a description and its probability.

    ``alternatives``: what it may be instead, with their ``probabilities``.
    """

    looks_like: str
    probability: float
    alternatives: tuple[str, ...] = ()
    probabilities: tuple[float, ...] = ()


@dataclass(frozen=True)
class Predictions:
    """How well left-out rows are predicted: ``score``, their log predictive density.

    ``error``: rms over the stated noise; ``score_sigma``, ``error_sigma``: standard errors.
    """

    score: float
    score_sigma: float
    error: float
    error_sigma: float


@dataclass(frozen=True)
class LeftOutBlocks:
    """Rows left out in turn, in ``blocks``, ``by`` pose, session, time, temperature or load.

    Predicted by ``geometry`` alone, and by the model ``averaged`` over all sets of causes by their
    probability; ``gain``: increase of the score by the latter, with its standard error.
    """

    by: str
    blocks: int
    geometry: Predictions
    averaged: Predictions
    gain: float
    gain_sigma: float

    @property
    def surely_better(self) -> bool:
        """Whether geometry alone clearly predicts worse."""
        return self.gain - SURE_SIGMAS * self.gain_sigma > 0.0

    @property
    def surely_worse(self) -> bool:
        """Whether geometry alone clearly predicts better."""
        return self.gain + SURE_SIGMAS * self.gain_sigma < 0.0


@dataclass(frozen=True)
class Swallowed:
    """A parameter that absorbed an effect: its error without and with the effect, in ``unit``."""

    name: str
    before: OfUnit
    after: OfUnit
    tolerance: OfUnit
    unit: str


@dataclass(frozen=True, eq=False)
class Found:
    """Fits and tests on the training rows: fits without and with effects, first and last tests."""

    before: Fit
    after: Fit
    first: Linearisation
    last: Linearisation
    added: tuple[Added, ...]

    @property
    def noise(self) -> float:
        """The noise over the stated one: from repeats if there are enough, otherwise 1."""
        pure = pure_error(self.first.system)
        return pure.ratio if pure is not None and pure.freedom >= ENOUGH_REPEATS else 1.0


@dataclass(frozen=True, eq=False)
class LearnedTerms:
    """Learned terms.

    Attributes:
        learned: terms and curves, from all rows; seen: those rows.
        without, fit: of all rows, without and with the terms.
        gap: on held-out poses, with the terms learned without these poses.
        equations: for each term, a short equation that predicts equally well, or None.
    """

    learned: Learned
    seen: Visible
    without: Fit
    fit: Fit
    gap: Gap
    equations: tuple[Equation | None, ...] = ()


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """All results of a diagnosis.

    Attributes:
        verdict: one of :data:`VERDICTS`.
        effects: named effects; suspected: candidates that are possibly present.
        remainder: lack of fit with the effects; start: without them.
        gap: on held-out poses, None if none could be held out.
        localised: location of residuals, without and with the effects.
        candidates, untestable, absorbed_by_geometry: tables.
        before: fit to all rows without the effects; identification: with them.
        found: fits and tests on the training rows.
        proposal: what to measure next.
        findings: notes for the user.
        others: the machine under each other set of effects; the last, with empty labels and odds 1,
            is the one without effects.
        learned: terms learned from the remaining residuals, without a cause; included in the
            identification.
        days: each session as predicted by fits of the others, with and without each effect.
        predictive: left-out rows, predicted by geometry alone and by the averaged model.
        nothing: probability that there is only geometry; nan if not computed.
        unknown: unknown causes found.
    """

    verdict: str
    effects: tuple[NamedEffect, ...]
    suspected: tuple[Candidate, ...]
    remainder: LackOfFit
    start: LackOfFit
    gap: Gap | None
    localised: tuple[Place, ...]
    candidates: tuple[Candidate, ...]
    untestable: tuple[Untestable, ...]
    absorbed_by_geometry: tuple[Swallowed, ...]
    before: Fit
    identification: Identification
    found: Found
    proposal: Proposal
    findings: tuple[Note, ...]
    others: tuple[CandidateModel, ...] = ()
    learned: LearnedTerms | None = None
    days: tuple[Validated, ...] = ()
    nothing: float = np.nan
    unknown: tuple[UnknownFound, ...] = ()
    predictive: tuple[LeftOutBlocks, ...] = ()
