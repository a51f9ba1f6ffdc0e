"""How well the machine behind kinematics is known: from its calibration, sigmas or tolerances."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ppmcal.calibration.compensation import (
    ParameterCovariance,
    PoseRows,
    forward_sigma,
    independent,
    joint_sigma,
    left_joint_sigma,
    sigma_by_differences,
)
from ppmcal.io.results.kinematics_uncertainty import (
    COVARIANCE,
    SIGMAS,
    TOLERANCES,
    ModelSigma,
)
from ppmcal.io.results.knowledge import knowledge_of, read_identification
from ppmcal.io.results.own_calibration import of_other_values
from ppmcal.io.results.tables import joint_columns
from ppmcal.kinematics.closure import Model
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

MOST = 200
"""From so many rows on, what tolerances allow is reported."""
Solve = Callable[[Model], Array]


@dataclass(frozen=True, eq=False)
class CarriedKnowledge:
    """What is known of a machine's parameters, where that is from, and the files behind it."""

    knowledge: ParameterCovariance
    source: str
    files: tuple[str, ...] = ()


def carried(mechanism: Mechanism) -> CarriedKnowledge | None:
    """Return what a machine's file carries: a covariance beside it, sigmas, tolerances, or None.

    A nominal file is not taken for the machine of an identification.json that happens to lie
    beside it: only a file with sigmas was written by a calibration.

    Raises:
        BadInput: the identification.json beside a calibrated machine cannot be used.
    """
    sigma = {p.name: p.sigma for p in mechanism.parameters
             if p.sigma is not None and np.isfinite(p.sigma)}
    if sigma:
        beside = Path(mechanism.source).with_name("identification.json")
        record = read_identification(beside) if mechanism.inputs and beside.is_file() else None
        if record is not None and not of_other_values(record, mechanism):
            return CarriedKnowledge(knowledge_of(record, mechanism, beside), COVARIANCE,
                                    (str(beside),))
        return CarriedKnowledge(independent(mechanism, sigma), SIGMAS)
    allowed = {p.name: p.prior_sigma for i, p in enumerate(mechanism.parameters)
               if i in mechanism.free and p.prior_sigma is not None}
    return CarriedKnowledge(independent(mechanism, allowed), TOLERANCES) if allowed else None


@dataclass(frozen=True, eq=False)
class SolvedRows:
    """Kinematics that were solved, and how they follow from the machine.

    ``at``: poses, joint values and conditions (N rows); ``registration``: what sees the platform,
    of the data set ``dataset``, if any; ``solve``: joint values and rates of a model (N, k) or
    (N, 2 k), for inverse kinematics and velocities.
    """

    which: str
    at: PoseRows
    registration: Registration
    dataset: str
    solve: Solve | None = None

    def first(self, most: int) -> SolvedRows:
        """Return at most so many rows, evenly spread, where none is solved again."""
        if self.solve is not None or len(self.at.q) <= most:
            return self
        some = np.linspace(0, len(self.at.q) - 1, most).astype(int)
        return replace(self, at=self.at.take(some))


def model_sigma(mechanism: Mechanism, solved: SolvedRows, known: CarriedKnowledge | None
                ) -> ModelSigma:
    """Return how well kinematics are known: columns in file units, and the entry of the JSON."""
    if known is None:
        return ModelSigma()
    if known.source == TOLERANCES:
        solved = solved.first(MOST)
    knowledge, columns = known.knowledge, dict[str, Array]()
    if solved.which == "forward":
        position, rotation = forward_sigma(Model(mechanism), solved.registration, solved.at,
                                           knowledge, solved.dataset)
        columns["sigma_position"] = position / mechanism.units.factor("length")
        if mechanism.motion.turns:
            columns["sigma_rotation"] = rotation / mechanism.units.factor("angle")
        return ModelSigma.of(mechanism, columns, known.source, solved.dataset or "base")
    k = len(mechanism.actuators)
    q = _joints(mechanism, solved, knowledge)
    columns |= joint_columns(mechanism, q[:, :k], "sigma_q_{}")
    if q.shape[1] > k:
        columns |= joint_columns(mechanism, q[:, k:], "sigma_rate_{}")
    return ModelSigma.of(mechanism, columns, known.source, "")


def _joints(mechanism: Mechanism, solved: SolvedRows, knowledge: ParameterCovariance) -> Array:
    """Return standard deviations of joint values, and of rates where they were asked for, SI."""
    model, short = Model(mechanism), mechanism.dependent > 0
    if solved.which == "inverse" and not short:
        return joint_sigma(model, solved.at, knowledge)
    assert solved.solve is not None
    found = sigma_by_differences(solved.solve, mechanism, knowledge)
    k = len(mechanism.actuators)
    left = left_joint_sigma(model, solved.at, knowledge)
    found[:, :k] = np.hypot(found[:, :k], left)
    if short:
        # a pose that names everything lies on this machine's surface alone
        near = joint_sigma(model, solved.at, knowledge)
        found[:, :k] = np.where(np.isnan(found[:, :k]), near, found[:, :k])
    return found
