"""Corrected commands: what to send so that the real machine goes to the wanted poses.

The identified machine's inverse kinematics is the correction. Besides the commands this
gives the error of the uncorrected ones, the error left after correction, and the
uncertainty of both; unsafe rows are refused, each with its reason.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.compensation.pose_sigma import (
    ParameterCovariance,
    by_kind,
    frame_variance,
    pose_sigma,
    tolerance_sigma,
)
from ppmcal.calibration.fit import in_other_branch, turn_between
from ppmcal.calibration.knowledge import IMPLAUSIBLE, far_outside, measured_ranges
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import final_shift
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.needed_columns import remembers
from ppmcal.kinematics.partial_pose import (
    PoseConvention,
    named_only,
    pose_motor,
    pose_vector,
    wanted_poses,
)
from ppmcal.kinematics.registration import after_events, measured_pose, predict
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Environment, environment
from ppmcal.model.effects.learned import LEARNED
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
from ppmcal.wording.progress import stage

NOTHING = 1e-9
"""Errors and steps below this part of the reach, or of a radian, are round-off."""
UNKNOWN = "the model's uncertainty there cannot be predicted"
KINDS = {"position": "length", "rotation": "angle"}
"""Kinds of error that are reported separately, and their quantity."""


@dataclass(frozen=True)
class Compensation:
    """Commands for N wanted poses, SI; nan where refused.

    ``command`` is the pose to command on a controller that uses the nominal geometry; ``seen``
    (N, 6) the wanted pose as measured, open coordinates solved for; ``pose`` (N, 6) that of the
    platform in the base frame. ``position_before`` ... ``rotation_after``: errors of the nominal
    and of the corrected commands if the model is exact (N,), m and rad; ``sigma_position``,
    ``sigma_rotation``: the model's standard uncertainty at the corrected commands,
    ``sigma_position_before``, ``sigma_rotation_before`` at the nominal ones (N,), nan: unknown.
    ``frame``: the part of ``sigma_position`` and of ``sigma_rotation`` (N,) due to the definition
    of the base axes; None: nothing defines them.
    """

    q: Array
    q_nominal: Array
    command: Array
    seen: Array
    pose: Array
    position_before: Array
    position_after: Array
    rotation_before: Array
    rotation_after: Array
    sigma_position: Array
    sigma_rotation: Array
    sigma_position_before: Array
    sigma_rotation_before: Array
    status: tuple[str, ...]
    reason: tuple[str, ...]
    frame: tuple[Array, Array] | None = None

    def expected(self, kind: str) -> tuple[Array, Array]:
        """Return the expected rms errors (N,) of nominal and of corrected commands, m or rad.

        Both include the uncertainty of the model. Where that is unknown, the error of corrected
        commands is nan, and that of nominal ones is the error of an exact model.

        Args:
            kind: ``position`` or ``rotation``.
        """
        unknown = np.nan_to_num(getattr(self, f"sigma_{kind}_before"))
        return (np.hypot(getattr(self, f"{kind}_before"), unknown),
                np.hypot(getattr(self, f"{kind}_after"), getattr(self, f"sigma_{kind}")))

    def parts(self, kind: str) -> tuple[float | None, float | None]:
        """Return the frame's and the machine's part of the sigma, rms over the commands.

        Argument as for :meth:`expected`; None: unknown, or nothing defines the base axes.
        """
        rows = finite_rows(self.q)
        if self.frame is None or not rows.any():
            return None, None
        whole = getattr(self, f"sigma_{kind}")[rows]
        frame = self.frame[[*KINDS].index(kind)][rows]
        return _rms(frame), _rms(np.sqrt(np.maximum(whole**2 - frame**2, 0.0)))

    def rms(self, kind: str) -> tuple[float | None, float | None, float | None]:
        """Return rms over the commands, m or rad: expected before and after, the model's sigma.

        None: unknown, or no command. Argument as for :meth:`expected`.
        """
        before, after = self.expected(kind)
        rows = finite_rows(self.q) & np.isfinite(before + getattr(self, f"{kind}_after"))
        return _rms(before[rows]), _rms(after[rows]), _rms(getattr(self, f"sigma_{kind}")[rows])


def _rms(values: Array) -> float | None:
    known = values.size > 0 and bool(np.isfinite(values).all())
    return float(np.sqrt(np.mean(values**2))) if known else None


@stage("finding commands")
def compensate(mechanism: Mechanism, wanted: Array, registration: Registration,
               knowledge: ParameterCovariance | None = None, dataset: str = "",
               columns: Mapping[str, Array] | None = None, sequence: bool = False
               ) -> Compensation:
    """Return corrected commands.

    Args:
        mechanism: the identified machine (its nominals are the controller's model).
        wanted: poses (N, 6) as the instrument would measure them, nan where open.
        registration: frame and target; ``Registration()`` for platform poses in the base frame.
        knowledge: covariance and measured volume, None where not available.
        dataset: name of the data set that ``registration`` belongs to.
        columns: variables that effects depend on, as in :func:`ppmcal.model.dataset.environment`.
        sequence: targets are visited in order, which gives the directions of approach.

    An instrument's own error (its scale, say) is not commanded into the machine: targets are
    true positions in its frame. Events in mid-run are taken as at the end of the run.
    """
    k = len(mechanism.actuators)
    model, nominal = Model(mechanism), Model(mechanism.nominal())
    before_events = registration
    if dataset:
        registration = after_events(registration, final_shift(mechanism).of(dataset))
    full, failed = wanted_poses(model, registration, wanted)
    columns = dict(columns or {})
    ordered = sequence or "time" in columns
    rough = inverse_table(nominal, full).q if ordered else np.full((len(full), k), np.nan)
    rows = environment(columns, mechanism.actuators, mechanism.gravity, rough, sequence)
    # effects move the surface of a machine with fewer actuators than coordinates: open coordinates
    # stay open, or the pose would be off that surface
    open_ = (np.isnan(wanted) & np.isin(np.arange(6), mechanism.dof)).any(axis=1)
    asked, seen_by = full, PoseConvention()
    if mechanism.effects and open_.any():
        asked, seen_by = wanted, PoseConvention(seen=registration)
    table = inverse_table(model, asked, rows, seen_by)
    if rows.history is not None and remembers(mechanism):
        # effects that depend on the way follow the joints that are sent, not the nominal ones
        sent = np.where(finite_rows(table.q)[:, None], table.q, rough)
        rows = environment(columns, mechanism.actuators, mechanism.gravity, sent, sequence)
        table = inverse_table(model, asked, rows, seen_by)
    if asked is wanted:
        full = np.where((open_ & finite_rows(table.pose))[:, None], table.pose, full)
        failed = [""] * len(full)   # these were for the machine without its effects
    refused = {n: f or r for n, (f, s, r) in enumerate(zip(
        failed, table.status, table.reason, strict=True)) if f or s != "ok"}

    def refuse(found: Iterable[tuple[int, str]]) -> Bools:
        """Refuse rows that are not yet refused; return those that remain (N,)."""
        for n, reason in found:
            refused.setdefault(n, reason)
        return np.array([n not in refused for n in range(len(full))])

    volume = None if knowledge is None else knowledge.volume
    ranges = measured_ranges(mechanism, volume)
    refuse(far_outside(mechanism, full, ranges))
    good = refuse(in_other_branch(model, pose_motor(full), table.q, ranges))
    believed = registration
    if knowledge is not None and dataset in knowledge.before:
        believed = knowledge.before[dataset]
    before, reached, q_nominal = _uncorrected(model, nominal, registration, believed, full, wanted,
                                              rows)
    good = refuse(_unexplained(model, nominal, registration, full, q_nominal, rows, before, good))
    sigma = pose_sigma(model, before_events, full, table.q, good, knowledge, dataset, rows)
    if knowledge is not None:
        # rows whose uncertainty cannot be computed
        good = refuse((n, UNKNOWN) for n in np.flatnonzero(
            ~(np.isfinite(sigma[0]) & np.isfinite(sigma[1]))).tolist())
    sigma_before = pose_sigma(model, before_events, reached, q_nominal,
                              good & finite_rows(reached), knowledge, dataset, rows)
    result = _after(model, nominal, registration, table.q, full, good, rows)
    frame = frame_variance(model, registration, full, knowledge, dataset)
    q = np.where(good[:, None], table.q, np.nan)
    seen = measured_pose(registration, pose_motor(full))
    return Compensation(q, q_nominal, result[0], seen, full, before[0], result[1], before[1],
                        result[2], *sigma, *sigma_before,
                        tuple(("refused", "ok")[int(g)] for g in good),
                        tuple(refused.get(n, "") for n in range(len(full))),
                        None if knowledge is None or knowledge.base_axes is None else
                        by_kind(mechanism, np.where(good[:, None], frame, np.nan)))


@stage("predicting errors without correction")
def _uncorrected(model: Model, nominal: Model, registration: Registration,
                 believed: Registration, full: Array, wanted: Array, rows: Environment
                 ) -> tuple[tuple[Array, Array], Array, Array]:
    """Errors (N,) of the nominal commands, poses they reach (N, 6), and the commands (N, k).

    Errors of position and rotation, if the model is exact; poses in the base frame.

    The nominal machine is sent to the wanted pose in the frame in which it fits the
    measurements best, ``believed``; coordinates that its closure does not allow stay open.
    """
    asked, _ = wanted_poses(nominal, believed, wanted)
    if nominal.mechanism.dependent:
        asked = named_only(nominal.mechanism, asked)
    table = inverse_table(nominal, asked)
    real = reached_poses(model, table.q, rows)
    return _errors(registration, real.pose, pose_motor(full)), pose_vector(real.pose), table.q


def _unexplained(model: Model, nominal: Model, registration: Registration, full: Array,
                 q_nominal: Array, rows: Environment, before: tuple[Array, Array], good: Bools
                 ) -> Iterator[tuple[int, str]]:
    """Yield rows whose commands differ more from the uncorrected ones than tolerances explain.

    Whatever the fit promises: no machine is that far from its drawing, so some number is wrong.
    Named effects explain what they do; learned ones claim no cause. ``before``:
    errors (N,) of the nominal commands ``q_nominal``; ``good``: rows to examine (N,).
    """
    mechanism = model.mechanism
    bare = replace(mechanism, effects=tuple(e for e in mechanism.effects if e.kind.name == LEARNED))
    if len(bare.effects) < len(mechanism.effects):
        real = reached_poses(Model(bare), q_nominal, rows)
        before = _errors(registration, real.pose, pose_motor(full))
    at = np.flatnonzero(finite_rows(q_nominal) & good)
    if not at.size:
        return
    sigma = tolerance_sigma(nominal, registration, full[at], q_nominal[at])
    units, least = mechanism.units, NOTHING * np.array([mechanism.reach, 1.0])
    # if a row exceeds both, the rotation is reported
    for i, quantity in ((1, "angle"), (0, "length")):
        factor, unit = units.factor(quantity), units.name(quantity)
        for n, off, size in zip(at.tolist(), before[i][at].tolist(), sigma[i].tolist(),
                                strict=True):
            if off > IMPLAUSIBLE * size + least[i]:
                yield n, (
                    f"is {off / factor:.4g} {unit} from the uncorrected command, where the "
                    f"tolerances explain {size / factor:.2g} {unit} (1 sigma): no machine "
                    f"within {IMPLAUSIBLE:.0f} tolerances is that far from its drawing; "
                    "if this one is, give its file larger tolerances (--regardless does not "
                    "override this)")


@stage("predicting errors with correction")
def _after(model: Model, nominal: Model, registration: Registration, q: Array, full: Array,
           good: Bools, rows: Environment) -> tuple[Array, Array, Array]:
    """Corrected pose command of the nominal model (N, 6), and remaining errors (N,) each."""
    command = np.full_like(full, np.nan)
    position, rotation = np.full(q.shape[0], np.nan), np.full(q.shape[0], np.nan)
    if good.any():
        asked = forward(nominal, q[good])
        command[good] = pose_vector(asked.pose)
        real = reached_poses(model, q[good], rows.take(good))
        position[good], rotation[good] = _errors(registration, real.pose, pose_motor(full[good]))
    return command, position, rotation


def _errors(registration: Registration, real: Array, ideal: Array) -> tuple[Array, Array]:
    """Return position and rotation differences (N,) as the instrument would measure them."""
    (a, ra), (b, rb) = predict(registration, real), predict(registration, ideal)
    return np.linalg.norm(a - b, axis=-1), np.linalg.norm(turn_between(ra, rb), axis=-1)

