"""How well frozen machines predict measurements that no fit has seen.

Geometry and effects stay fixed; only the registration is fitted, on each data set alone: the
frame, and target, body rotation or a shift of each joint's zero where the file leaves them open,
where requested, or where the data need it. All machines are judged by the same rows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import compress

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import (
    FAILURES,
    Fit,
    FitOptions,
    Problem,
    gross_errors,
    identify,
    is_open,
    labels,
    odds_of_opening,
    opened,
    secondary,
    shown,
    significant_improvement,
    squares_by_noise_of,
    surely,
    values_taken,
    white_squares,
)
from ppmcal.calibration.validation.error_intervals import RmsDraws, quantile_interval, rms_interval
from ppmcal.calibration.validation.residual_vectors import Residuals, register_only, residuals
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.registration import carried_back, measured_pose
from ppmcal.linalg import Array, Bools, Ints, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import REGISTERED
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.notes import Note
from ppmcal.wording import actuator_list

FEWEST = 3
OPEN_ENDS = dict.fromkeys(("rms_low", "rms_high", "p95_low", "p95_high"), float("nan"))
"""Unknown intervals of errors."""


@dataclass(frozen=True)
class FrozenModel:
    """A machine to judge, with its label: ``without leg_thermal``, say."""

    label: str
    mechanism: Mechanism


@dataclass(frozen=True, eq=False)
class ModelError:
    """Errors of one machine on one data set, SI, in the rows by which all machines can be judged.

    Attributes:
        label: of the machine.
        position, rotation: rms, p95 and max of the measured errors, m and rad, with the 95 %
            intervals of the first two (``rms_low``, ...; nan: open); empty: not measured.
        noise: rms over the noise of the data set as stated.
        closure: for joint values alone, the same for closure errors of limbs, m: rms over the
            limbs of a row; ``limbs``: rms of each limb.
        squares: squared error of each row, m^2 (rad^2 for rotation alone), (R,).
        closer: rms of the reference machine less this one's, m or rad, and its simultaneous 95 %
            interval; 0 for the reference. Positive: this machine predicts better.
    """

    label: str
    position: Mapping[str, float]
    rotation: Mapping[str, float]
    noise: float
    squares: Array
    closer: float = 0.0
    interval: tuple[float, float] = (0.0, 0.0)
    closure: Mapping[str, float] = field(default_factory=dict)
    limbs: Mapping[str, float] = field(default_factory=dict)

    @property
    def size(self) -> Mapping[str, float]:
        """The figures for comparing machines."""
        return self.position or self.rotation or self.closure

    @property
    def sure(self) -> int:
        """1 if it surely predicts better than the reference, -1 if worse, else 0."""
        return int(self.interval[0] > 0.0) - int(self.interval[1] < 0.0)


@dataclass(frozen=True, eq=False)
class Validated:
    """One data set, predicted by every machine.

    Attributes:
        name, source: of the data set.
        rows: number of rows by which every machine was judged, and of all rows.
        fitted: what the registration fitted, of :data:`REGISTERED`.
        demanded: those that neither file nor user opened.
        errors: by machine, the reference first.
        elsewhere: number of judged rows that the reference machine closes in another assembly
            mode, near the measurement.
        left_out: rows mistyped according to every machine, which count nowhere; numbers in the CSV.
    """

    name: str
    source: str
    rows: tuple[int, int]
    fitted: tuple[str, ...]
    demanded: tuple[str, ...]
    errors: tuple[ModelError, ...]
    elsewhere: int = 0
    left_out: tuple[int, ...] = ()


def with_and_without(mechanism: Mechanism) -> list[FrozenModel]:
    """Return a machine without events, then without each effect, and without any.

    Events happened in one row of one campaign; no other day has them.
    """
    lasting = [e for e in mechanism.effects if not e.kind.onset]
    out = [FrozenModel("model", replace(mechanism, effects=tuple(lasting)))]
    labels = _labels(lasting, mechanism.actuators)
    if len(lasting) > 1:
        out += [FrozenModel(f"without {label}", replace(
            mechanism, effects=tuple(e for e in lasting if e is not effect)))
            for label, effect in zip(labels, lasting, strict=True)]
    if lasting:
        what = labels[0] if len(lasting) == 1 else "all effects"
        out.append(FrozenModel(f"without {what}", replace(mechanism, effects=())))
    return out


def _labels(effects: Sequence[Effect], actuators: Sequence[str]) -> list[str]:
    """Return labels of effects: kind, actuators if not on all, a number if repeated."""
    names = []
    for effect in effects:
        some = [] if all(effect.on) or not effect.kind.per_actuator else list(
            compress(actuators, effect.on))
        place = actuator_list(some, len(actuators))
        names.append(f"{effect.kind.label} on {place}" if place else effect.kind.label)
    return [f"{n} {1 + names[:i].count(n)}" if names.count(n) > 1 else n
            for i, n in enumerate(names)]


def validated(models: Sequence[FrozenModel], datasets: Sequence[Dataset],
              register: Sequence[str] | None = None, seed: int = 0, notes: list[Note] | None = None
              ) -> tuple[Validated, ...]:
    """Return how well machines predict data sets.

    Args:
        models: the machines; the first is the reference.
        datasets: measurements that no fit of theirs has seen.
        register: what to fit of :data:`REGISTERED`; None: what the files leave open, and what the
            data need beyond that for all machines.
        seed: of the bootstrap.
        notes: receives which of the other machines are left out because they could not be
            judged; None: none may be.

    Raises:
        BadInput: fewer than three rows that every machine, or the first, can predict.
    """
    return tuple(_with_the_others(models, data, register, seed, notes) for data in datasets)


def _with_the_others(models: Sequence[FrozenModel], data: Dataset, register: Sequence[str] | None,
                     seed: int, notes: list[Note] | None) -> Validated:
    """Return a data set as predicted by the first machine, and by those others that can."""
    said = list[Note]()
    try:
        found = _validated(models, data, register, seed, said)
    except FAILURES:
        if notes is None:
            raise
        # all are judged by the same rows, so any may be the reason: try each with the first
        able = [m for m in models[1:] if secondary(
            f"{m.label}, as a prediction of {data.name}",
            partial(_validated, (models[0], m), data, register, seed, []), None, notes) is not None]
        return _validated((models[0], *able), data, register, seed, notes)
    if notes is not None:
        notes += said
    return found


def _validated(models: Sequence[FrozenModel], data: Dataset, register: Sequence[str] | None,
               seed: int, notes: list[Note]) -> Validated:
    asked = tuple(w for w in REGISTERED if is_open(data, w)) if register is None else tuple(
        w for w in REGISTERED if w in register)
    whole, data = data, opened(data, asked, register is not None)
    data = secondary("rows with mistyped values", partial(_typed_right, models, data), data, notes)
    demanded, known = secondary("what else the registration has to fit", partial(
        _demanded, models, data), ((), dict[int, Fit]()), notes) if register is None else ((), {})
    data = opened(data, demanded)
    fits = [known.get(i) or _registered(m.mechanism, data) for i, m in enumerate(models)]
    rows = np.all([finite_rows(f.state.poses[0]) for f in fits], axis=0)
    if rows.sum() < FEWEST:
        raise BadInput(f"only {int(rows.sum())} of {len(whole)} rows can be predicted by every "
                       "machine", data.source, "Check that these are measurements of this machine")
    found = [residuals(f.problem, f.state) for f in fits]
    errors = tuple(_error(m.label, r, rows, f, notes)
                   for m, r, f in zip(models, found, fits, strict=True))
    compared = secondary("how much closer each machine is", lambda: _compared(
        errors, data.groups[rows], seed), (errors[0], *(replace(
            e, closer=np.nan, interval=(np.nan, np.nan)) for e in errors[1:])), notes)
    elsewhere = secondary("rows in another assembly mode", lambda: int(
        (in_other_assembly(fits[0]) & rows).sum()), 0, notes)
    return Validated(data.name, data.source, (int(rows.sum()), len(whole)),
                     (*asked, *(("offset",) if data.offset.fitted else ()), *demanded),
                     demanded, compared, elsewhere,
                     tuple(np.setdiff1d(whole.rows, data.rows).tolist()))


def _typed_right(models: Sequence[FrozenModel], data: Dataset) -> Dataset:
    """Return a data set without rows that are mistyped according to every machine."""
    typed = np.ones(len(data), dtype=bool)
    for model in models:
        if not typed.any():
            break
        fit = register_only(Problem(model.mechanism, (data,), ()))
        there = finite_rows(fit.state.poses[0])
        typed &= gross_errors(fit.problem, fit.state, [there])[0]
    return data.take(~typed) if typed.any() else data


def _registered(mechanism: Mechanism, data: Dataset) -> Fit:
    """Return the registration to all rows with equal weights, the same for all machines."""
    return identify(Problem(mechanism, (data,), ()), FitOptions(method="flat", robust=False))


def _demanded(models: Sequence[FrozenModel], data: Dataset
              ) -> tuple[tuple[str, ...], dict[int, Fit]]:
    """Return what the data need fitted beyond what the file leaves open, found one by one.

    Also the registrations by model, as far as they were made.

    It has to lower the error of every machine: if only one needs it, that machine is at fault.
    """
    found: list[str] = []
    feasible = [w for w in data.kind.opened if not is_open(data, w)]
    now: dict[int, Fit] = {}
    while feasible:
        least = np.full(len(feasible), np.inf)
        for i, model in enumerate(models):    # what the first does not need, not all need
            fit = now.setdefault(i, _registered(model.mechanism, opened(data, found)))
            least = np.minimum(least, odds_of_opening(
                fit.problem, fit.state, [finite_rows(fit.state.poses[0])], fit.prior,
                [(0, w) for w in feasible]))
            if not surely(least.max()):
                return tuple(found), now
        best = feasible[int(np.argmax(least))]
        wider = {}
        for i, model in enumerate(models):
            wider[i] = _registered(model.mechanism, opened(data, [*found, best]))
            if not _worth(now[i], wider[i]):
                return tuple(found), now
        found.append(best)
        feasible.remove(best)
        now = wider
    return tuple(found), now


def _worth(before: Fit, after: Fit) -> bool:
    """Return whether the error falls by enough to matter.

    Both errors are weighted by the noise at the wider registration, which minimises it:
    each with its own noise, a wider one could seem to fit worse.
    """
    rows = [finite_rows(p) & finite_rows(q) for p, q in
            zip(before.state.poses, after.state.poses, strict=True)]
    wide = after.problem, after.state
    narrow = squares_by_noise_of((before.problem, before.state), wide, rows)
    return significant_improvement(narrow, white_squares(*wide, rows)[0]) > 0.0


def _error(label: str, found: Residuals, rows: Bools, fit: Fit, notes: list[Note]) -> ModelError:
    if fit.problem.datasets[0].kind.blind:
        return _closure_error(label, found, rows, fit, notes)
    figures = found.figures([rows])
    position = np.nan_to_num(found.position[0][rows])
    squares = position**2
    if "position" not in figures and "rotation" in figures:
        squares = np.nan_to_num(found.rotation[0][rows]) ** 2
    white = found.vector[0][rows] / found.sigma[0][rows]
    noise = float(np.sqrt(np.nanmean(white**2))) if np.isfinite(white).any() else np.nan
    kept = 1.0 - values_taken(fit) / max(int(np.isfinite(white).sum()), 1)
    groups = fit.problem.datasets[0].groups[rows]
    sizes = [figures.get(kind, {}) | secondary(
        f"the intervals of {label}'s errors of {kind}",
        partial(_intervals, errors[0][rows], groups, kept),
        OPEN_ENDS if kind in figures else {}, notes)
             for kind, errors in (("position", found.position), ("rotation", found.rotation))]
    return ModelError(label, sizes[0], sizes[1], noise, squares)


def _closure_error(label: str, found: Residuals, rows: Bools, fit: Fit, notes: list[Note]
                   ) -> ModelError:
    """Return the closure errors of limbs: joint values alone show nothing else."""
    mechanism, gaps = fit.problem.mechanism, found.closure[0][rows]
    squares = np.nanmean(gaps**2, axis=1)
    errors = np.sqrt(squares)
    sizes = {"rms": float(np.sqrt(squares.mean())), "p95": float(np.quantile(errors, 0.95)),
             "max": float(errors.max())} | secondary(
        f"the intervals of {label}'s errors of closure",
        partial(_intervals, errors, fit.problem.datasets[0].groups[rows], 1.0), OPEN_ENDS, notes)
    # the pose that fits the limbs best absorbs part of their noise
    left = mechanism.surplus / mechanism.equations
    white = np.nanmean((gaps / found.sigma[0][rows]) ** 2)
    each = dict(zip(labels(fit.problem.datasets[0], mechanism),
                    np.sqrt(np.nanmean(gaps**2, axis=0)).tolist(), strict=True))
    return ModelError(label, {}, {}, float(np.sqrt(white / left)), squares, closure=sizes,
                      limbs={name.removeprefix("gap_"): size for name, size in each.items()})


def _intervals(errors: Array, groups: Ints, kept: float) -> dict[str, float]:
    """Return the 95 % intervals of rms and 95 % point of errors (R,), nan where not measured."""
    there = np.isfinite(errors)
    if not there.any():
        return {}
    errors, groups = errors[there], groups[there]
    low, high = rms_interval(errors**2, groups, kept)
    ends = quantile_interval(errors, groups, 0.95)
    return {"rms_low": low, "rms_high": high, "p95_low": ends[0], "p95_high": ends[1]}


def _compared(errors: Sequence[ModelError], groups: Ints, seed: int) -> tuple[ModelError, ...]:
    """Return the errors with how much closer each machine is than the first, drawn by pose.

    The intervals are simultaneous: among many machines, noise alone would make one better.
    """
    draws, others = RmsDraws(groups, seed), len(errors) - 1
    many = draws.rms(errors[0].squares)
    rms = [float(np.sqrt(e.squares.mean())) for e in errors]
    return (errors[0], *(
        replace(e, closer=rms[0] - own,
                interval=draws.interval(many - draws.rms(e.squares), others))
        for e, own in zip(errors[1:], rms[1:], strict=True)))


# --- rows that were measured in another assembly mode than home's: no error of the model ----------
#
# At the same joint values a parallel machine closes in several ways. A row measured in another mode
# lies far from the predicted pose, by about the machine's own size, and the closure has a solution
# near the measurement.

FAR = 0.1
"""Relative to the platform's size; assembly modes closer than this are about to meet."""
NEARER = 0.1
"""The other pose is off the measurement by less than this part of what home's is off: a mistyped
value is equally far from all modes."""


def in_other_assembly(fit: Fit) -> Bools:
    """Return which rows (N,) of a fit's first data set close in another mode, near their values.

    None for heights and distances between two positions, which hardly locate the platform.
    """
    data, state = fit.problem.datasets[0], fit.state
    mechanism = fit.problem.mechanism.with_values(state.g)
    q, pose = fit.problem.ends(0, state)[0]
    out = np.zeros(len(data), dtype=bool)
    if data.kind.scalar or not data.kind.of_poses:
        return out
    # the platform's pose by the measurement, else as predicted
    seen = shown(data)
    start = carried_back(mechanism, state.registrations[0], np.where(
        np.isfinite(seen), seen, measured_pose(state.registrations[0], pose)))
    size = mechanism.length_scale
    rows = np.flatnonzero(finite_rows(q) & finite_rows(start)
                          & (_apart(start, pose, size) > FAR * size))
    if rows.size:
        model = Model(mechanism)
        other, closed, _ = newton(model.closure(q[rows]), start[rows])
        off = _apart(start[rows], pose[rows], size)
        out[rows] = (closed & (_apart(start[rows], other, size) < NEARER * off)
                     & (_apart(other, pose[rows], size) > FAR * size))
    return out


def _apart(one: Array, two: Array, size: float) -> Array:
    """Return the distances (N,) of poses (N, 8), m; rotations times the platform's size."""
    place = np.linalg.norm(cga.translation(one) - cga.translation(two), axis=-1)
    turn = cga.rotation_vector(cga.compose(cga.reverse(one), two))
    return np.asarray(place + size * np.linalg.norm(turn, axis=-1))
