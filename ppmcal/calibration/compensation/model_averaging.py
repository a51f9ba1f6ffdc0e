"""Commands that suit all models between which the data cannot decide.

Each candidate is a machine weighted by its odds. Their disagreement at a target is an
uncertainty of the command there (Hoeting et al. 1999, Bayesian model averaging). If
commands without any of their effects are closer to all of them, those are sent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.compensation.commands import Compensation, compensate
from ppmcal.calibration.compensation.pose_sigma import ParameterCovariance
from ppmcal.calibration.compensation.safe_commands import refused, sent
from ppmcal.calibration.fit import turn_between
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.needed_columns import missing_columns
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import predict
from ppmcal.linalg import Array
from ppmcal.model.dataset import Environment, environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

UNREACHED = ("its result is not known: a machine that the measurements cannot tell from this one "
             "does not take these joint values")
OWN = ("q", "command", "seen", "pose", "position_after", "rotation_after", "status", "reason")
"""Fields replaced by those of another machine; nominal commands and uncertainties stay."""


@dataclass(frozen=True)
class CandidateModel:
    """A machine that also explains the measurements: with ``effect`` ``instead`` of another.

    Without ``instead`` it has one more effect than the model, without ``effect`` one less.
    ``odds`` of the model against it; ``effects``: all of its effects.
    """

    effect: str
    instead: str
    odds: float
    mechanism: Mechanism
    effects: tuple[str, ...] = ()

    @property
    def bare(self) -> bool:
        """Whether it is the machine without effects, which is not a model of its own."""
        return not self.effect and not self.instead


def probabilities(readings: Sequence[CandidateModel]) -> list[float]:
    """Return the probability of the model and of each candidate, among those tried."""
    weight = np.array([1.0, *(1.0 / r.odds for r in readings)])
    return [float(w) for w in weight / weight.sum()]


@dataclass(frozen=True)
class Readings:
    """All candidates besides the model, and the machine fitted without effects, if known."""

    others: tuple[CandidateModel, ...]
    without: Mechanism | None


@dataclass(frozen=True)
class Targets:
    """Wanted poses (N, 6) in the frame of a data set ("" for the base), and their environment.

    As for :func:`ppmcal.calibration.compensation.compensate`.
    """

    wanted: Array
    dataset: str
    columns: Mapping[str, Array]
    sequence: bool = False


def averaged(model: Mechanism, result: Compensation, readings: Readings,
             knowledge: ParameterCovariance | None, targets: Targets) -> tuple[Compensation,
                                                                               tuple[Note, ...]]:
    """Return the commands with the candidates' disagreement in their uncertainty, and notes.

    Args:
        model: the machine with which the commands were made.
        result: those commands.
        readings: candidates for the same measurements.
        knowledge: covariance and measured volume.
        targets: wanted poses.
    """
    if not readings.others:
        return result, ()
    targets, notes = _at_rest(readings.others, result, targets)
    machines = [model, *(r.mechanism for r in readings.others)]
    weight = np.array(probabilities(readings.others))
    own = _expected(machines, weight, result.q, result, targets)
    note = "the measurements cannot tell " + "; nor ".join(_untold(readings.others))
    bare = _without(readings.without, result, knowledge, targets)
    if bare is not None:
        plain = _expected(machines, weight, bare.q, result, targets)
        both = np.isfinite(own[0]) & np.isfinite(plain[0])
        if both.any() and np.mean(plain[0][both] ** 2) < np.mean(own[0][both] ** 2):
            length = model.units.factor("length")
            note += (": left out of these commands, which would be off by "
                     f"{_rms(own[0]) / length:.3g} {model.units.length} with it and are by "
                     f"{_rms(plain[0]) / length:.3g} without, over these candidates")
            result, own = replace(result, **{name: getattr(bare, name) for name in OWN}), plain
        else:
            note += "; the difference at the targets is in the uncertainty"
    result = refused(result, dict.fromkeys(
        np.flatnonzero(sent(result) & ~np.isfinite(own[0] + own[1])).tolist(), UNREACHED))
    before = _expected(machines, weight, result.q_nominal, result, targets)
    return replace(result, position_before=before[0], rotation_before=before[1],
                   sigma_position=np.hypot(result.sigma_position, own[0]),
                   sigma_rotation=np.hypot(result.sigma_rotation, own[1])), (
                       Note(note, NOTE, "other models"), *notes)


def _at_rest(others: Sequence[CandidateModel], result: Compensation, targets: Targets
             ) -> tuple[Targets, list[Note]]:
    """Return the targets with joints at rest if only candidates need velocities, and notes.

    The model needs none, or the targets would have them.
    """
    needed = {name: r for r in others for name in missing_columns(
        r.mechanism, _environment(r.mechanism, result, targets)) if name.startswith("vel_")}
    if not needed:
        return targets, []
    names = ", ".join(dict.fromkeys(r.effect for r in needed.values()))
    still = dict.fromkeys(needed, np.zeros(len(targets.wanted)))
    return replace(targets, columns={**targets.columns, **still}), [
        Note(f"{names}: depends on joint velocities, which the targets do not have, and counts as "
             f"at rest; add the columns {', '.join(needed)} if the machine is to be right in "
             "motion", NOTE, "other models")]


def _environment(mechanism: Mechanism, result: Compensation, targets: Targets) -> Environment:
    return environment(targets.columns, mechanism.actuators, mechanism.gravity, result.q_nominal,
                       targets.sequence)


def _untold(others: Sequence[CandidateModel]) -> list[str]:
    """Return what the candidates leave open, in words."""
    swaps = [r for r in others if r.effect and r.instead]
    out = []
    if swaps:
        named, labels = (", ".join(dict.fromkeys(words)) for words in (
            [r.instead for r in swaps], [r.effect for r in swaps]))
        out.append(f"{named} from {labels}")
    there = dict.fromkeys(r.effect or r.instead for r in others if not (r.effect and r.instead))
    return out + [f"whether there is {name}" for name in there]


def _rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def _without(mechanism: Mechanism | None, result: Compensation,
             knowledge: ParameterCovariance | None, targets: Targets) -> Compensation | None:
    """Return the commands of the machine without effects; None if it is not known."""
    if mechanism is None or (targets.dataset and targets.dataset not in mechanism.registrations):
        return None
    found = compensate(mechanism, targets.wanted, mechanism.registration(targets.dataset),
                       None, targets.dataset, targets.columns, targets.sequence)
    # refused commands stay refused
    good = np.array([a == b == "ok" for a, b in zip(found.status, result.status, strict=True)])
    return replace(found, q=np.where(good[:, None], found.q, np.nan),
                   status=tuple(b if a == "ok" else a
                                for a, b in zip(result.status, found.status, strict=True)),
                   reason=tuple(a or b for a, b in zip(result.reason, found.reason, strict=True)))


def _expected(machines: Sequence[Mechanism], weight: Array, q: Array, result: Compensation,
              targets: Targets) -> tuple[Array, Array]:
    """Return the expected errors (N,) of commands, rms over the machines, m and rad.

    ``weight``: their probabilities.
    """
    errors = np.array([_errors(m, q, result, targets) for m in machines])
    mean = np.sqrt(np.einsum("j,jkn->kn", weight, errors**2))
    return mean[0], mean[1]


def _errors(mechanism: Mechanism, q: Array, result: Compensation, targets: Targets
            ) -> tuple[Array, Array]:
    """Return position and rotation errors (N,) of commands if the machine is this one.

    An instrument that shows (1 + s) times the truth leads the machine astray either way: off its
    readings, or, about the middle of the targets, off the truth. The larger error counts.
    """
    registration = mechanism.registration(targets.dataset)
    reached = reached_poses(Model(mechanism), q, _environment(mechanism, result, targets))
    point, turn = predict(registration, reached.pose)
    wanted = result.seen[:, :3]
    miss = point - wanted
    position = np.linalg.norm(miss, axis=1)
    if reached.model.shift is not None and reached.model.shift.stretch is not None:
        stretch = reached.model.shift.stretch
        shown = miss + (stretch @ point[..., None])[..., 0]
        about = wanted - np.nanmean(wanted, axis=0)
        position = np.fmax(np.linalg.norm(shown, axis=1), np.linalg.norm(
            shown - (stretch @ about[..., None])[..., 0], axis=1))
    away = turn_between(turn, cga.rotation_matrix(pose_motor(result.seen)))
    return position, np.linalg.norm(away, axis=1)
