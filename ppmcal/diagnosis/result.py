"""What a diagnosis found, as plain data; SI."""

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
"""Verdicts that say of nothing that it is there."""
LEARNED_AFTER = ("unnamed", "partial")
"""Verdicts that leave something to learn."""


@dataclass(frozen=True)
class Onset:
    """The row of the campaign where an event starts, with its 95 % interval.

    ``dataset``: within which file it is counted, once it is said.
    """

    row: Annotated[int, Key("value")]
    low: int
    high: int
    dataset: str = ""


@dataclass(frozen=True, eq=False)
class SessionEffect:
    """The size of one effect in each session, all else shared.

    Attributes:
        labels: of the sessions in which it can be seen (S,).
        names: of its free parameters in the model (p,).
        value, sigma: SI (S, p).
        same: probability of being the same in all of them.
        times: half of a 95 % interval over ``sigma``, the noise's size not being known exactly.
    """

    labels: tuple[str, ...]
    names: tuple[str, ...]
    value: Array
    sigma: Array
    same: float
    times: float = Z95


@dataclass(frozen=True)
class NamedEffect:
    """One effect that the data ask for.

    ``parameters``: names in the model; ``visibility``: the part that geometry leaves;
    ``probability`` that it is there and nothing else in its place; ``alternatives``: labels of what
    may be in its place, with their ``probabilities``; ``hypothesis``: the one that it came from,
    which may have a value for each of several actuators; ``onset``: of an event, the row where it
    starts; ``sessions``: its size in each, where there are several.
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
        """How much likelier it is than each of the alternatives."""
        return tuple(self.probability / p for p in self.probabilities)

    def side(self, mechanism: Mechanism) -> str:
        """Return whether the joint ``lags`` or ``leads`` its reading, empty for other kinds.

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
    """One hypothesis of the library and what became of it.

    ``probability`` that it is there; ``visibility``: the part that geometry leaves, nan of what the
    rows in use do not tell; ``status``: named, alternative, weak, not needed.
    """

    hypothesis: Hypothesis
    probability: float
    visibility: float
    status: str
    alternatives: tuple[str, ...] = ()


@dataclass(frozen=True)
class UnknownFound:
    """Something that is there and has no name, what it looks like, and how probable it is.

    ``alternatives``: what it may be instead, with their ``probabilities``.
    """

    looks_like: str
    probability: float
    alternatives: tuple[str, ...] = ()
    probabilities: tuple[float, ...] = ()


@dataclass(frozen=True)
class Predictions:
    """How well rows left out are predicted: ``score``, the logarithm of their density.

    ``error``: rms over the stated noise; ``score_sigma``, ``error_sigma``: standard errors.
    """

    score: float
    score_sigma: float
    error: float
    error_sigma: float


@dataclass(frozen=True)
class LeftOutBlocks:
    """Rows left out in turn, so many ``blocks``, ``by`` pose, session, time, temperature or load.

    Predicted by ``geometry`` alone, and by the model ``averaged`` over all sets of causes by their
    probability; ``gain``: by how much the score of that is larger, with its standard error.
    """

    by: str
    blocks: int
    geometry: Predictions
    averaged: Predictions
    gain: float
    gain_sigma: float

    @property
    def surely_better(self) -> bool:
        """Whether geometry alone surely predicts worse."""
        return self.gain - SURE_SIGMAS * self.gain_sigma > 0.0

    @property
    def surely_worse(self) -> bool:
        """Whether geometry alone surely predicts better."""
        return self.gain + SURE_SIGMAS * self.gain_sigma < 0.0


@dataclass(frozen=True)
class Swallowed:
    """A parameter that had moved to imitate an effect: error without and with it, in ``unit``."""

    name: str
    before: OfUnit
    after: OfUnit
    tolerance: OfUnit
    unit: str


@dataclass(frozen=True, eq=False)
class Found:
    """Fits and tests on the training rows: without and with effects, first and last tests."""

    before: Fit
    after: Fit
    first: Linearisation
    last: Linearisation
    added: tuple[Added, ...]

    @property
    def noise(self) -> float:
        """The noise over the stated one: that of repeats where there are enough."""
        pure = pure_error(self.first.system)
        return pure.ratio if pure is not None and pure.freedom >= ENOUGH_REPEATS else 1.0


@dataclass(frozen=True, eq=False)
class LearnedTerms:
    """What was learned.

    Attributes:
        learned: terms and curves, from all rows; seen: those rows.
        without, fit: of all rows, without and with the terms.
        gap: on held-out poses, the terms learned without them.
        equations: for each term, a short equation that does as well, or None.
    """

    learned: Learned
    seen: Visible
    without: Fit
    fit: Fit
    gap: Gap
    equations: tuple[Equation | None, ...] = ()


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Everything that a diagnosis found.

    Attributes:
        verdict: one of :data:`VERDICTS`.
        effects: what was named. possible: what is there but cannot be named.
        remainder: what is left; start: of the fit without effects.
        gap: on held-out poses, None where none could be held out.
        localised: where residuals are, without and with the effects.
        candidates, untestable, absorbed_by_geometry: tables.
        before: fit to all rows without the effects; identification: with them.
        found: fits and tests on the training rows.
        proposal: what to measure next.
        findings: what the user must look at.
        others: the machine under each other set of effects; last, with no effect, in place of
            none, and odds 1, the one without effects.
        blocks: the gap where stretches of time, temperature or load are left out in turn.
        learned: terms learned from what was left, which claim no cause; they are in the
            identification.
        days: each session as fits of the others predict it, with and without each effect.
        predictive: rows left out, predicted by geometry alone and by all that may be there.
        nothing: probability that the geometry is all there is; nan where it was not asked.
        unknown: what is there without a name.
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
