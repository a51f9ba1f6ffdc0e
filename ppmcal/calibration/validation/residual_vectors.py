"""Errors row by row, of all rows and of poses, files and sessions held out of a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    State,
    coordinates,
    identify,
    noise,
    opened,
    values_per_row,
    with_noise,
)
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import shifted
from ppmcal.kinematics.forward import moved
from ppmcal.kinematics.least_squares_closure import with_gaps
from ppmcal.kinematics.registration import carried_back
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.registration import Registration
from ppmcal.model.sessions import one_session, pose_labels, session_masks
from ppmcal.wording.progress import stage

LEFT_OUT = "left out of the fit to everything"


@dataclass(frozen=True)
class Residuals:
    """Errors row by row, by data set; nan where not measured. SI.

    ``vector`` (N, m) by measured coordinate, ``sigma`` (N, m) their standard deviations as
    stated, from instrument and joints, ``position`` and ``rotation`` norms (N,), ``closure`` (N, d)
    limb lengths at the measured poses, nan where the pose was not fully measured.
    """

    vector: tuple[Array, ...]
    sigma: tuple[Array, ...]
    position: tuple[Array, ...]
    rotation: tuple[Array, ...]
    closure: tuple[Array, ...]

    def counted(self, rows: Sequence[Bools]) -> dict[str, dict[str, float]]:
        """Return :meth:`figures`, each with the ``count`` of rows behind it."""
        found = self.figures(rows)
        for name, parts in (("position", self.position), ("rotation", self.rotation),
                            ("closure", self.closure)):
            if name in found:
                found[name]["count"] = sum(int(np.isfinite(p[k]).any(axis=tuple(
                    range(1, p.ndim))).sum()) for p, k in zip(parts, rows, strict=True))
        return found

    def figures(self, rows: Sequence[Bools]) -> dict[str, dict[str, float]]:
        """Return mean, rms, p95 and max of each kind of error over the given rows."""
        out = {}
        for name, parts in (("position", self.position), ("rotation", self.rotation)):
            values = np.concatenate([p[k] for p, k in zip(parts, rows, strict=True)])
            values = values[np.isfinite(values)]
            if values.size:
                out[name] = {"mean": float(values.mean()),
                             "rms": float(np.sqrt(np.mean(values**2))),
                             "p95": float(np.quantile(values, 0.95)),
                             "max": float(values.max())}
        gaps = np.concatenate([c[k].ravel() for c, k in zip(self.closure, rows, strict=True)])
        gaps = gaps[np.isfinite(gaps)]
        if gaps.size:
            out["closure"] = {"rms": float(np.sqrt(np.mean(gaps**2))),
                              "max": float(np.abs(gaps).max())}
        return out


def residuals(problem: Problem, state: State) -> Residuals:
    """Return the errors of all rows at a state, regardless of weights."""
    problem = problem.weighted(None)
    parts: list[list[Array]] = [[], [], [], [], []]
    motion = problem.mechanism.motion
    for i, data in enumerate(problem.datasets):
        if data.kind.blind:
            gaps, noise_of_gaps = _gaps(problem, state, i)
            nothing = np.full(len(data), np.nan)
            for part, own in zip(parts, (gaps, noise_of_gaps, nothing, nothing, gaps), strict=True):
                part.append(own)
            continue
        chosen = coordinates(data, motion)
        places = sum(1 for c in chosen if c < 3)
        vector = np.full((len(data), len(chosen)), np.nan)
        of_joints = problem.noisy_closure[i]
        sigma = np.full_like(vector, np.nan) if of_joints else noise(data, motion)
        for rows in problem.rows_of(i, state, False):
            vector[rows.index] = rows.measured
            if of_joints:
                covariance = linalg.inv(np.swapaxes(rows.whitener, -1, -2) @ rows.whitener)
                own = np.diagonal(covariance, axis1=-2, axis2=-1)[:, :len(chosen)]
                sigma[rows.index] = np.sqrt(own)
        parts[0].append(vector)
        parts[1].append(sigma)
        parts[2].append(_norm(vector[:, :places]))
        parts[3].append(_norm(vector[:, places:]))
        parts[4].append(closure_lengths(problem, state, i))
    return Residuals(*(tuple(p) for p in parts))


def _norm(vector: Array) -> Array:
    """Norm over the measured components, nan where none is measured."""
    seen = np.isfinite(vector)
    norm = np.sqrt(np.sum(np.where(seen, vector, 0.0) ** 2, axis=1))
    return np.where(seen.any(axis=1), norm, np.nan)


def _gaps(problem: Problem, state: State, index: int) -> tuple[Array, Array]:
    """Return the closure errors of limbs at the pose that minimises them, m (N, m).

    Also their standard deviations by the noise of joints and gaps.
    """
    out = np.full((2, len(problem.datasets[index]), problem.mechanism.equations), np.nan)
    for rows in problem.rows_of(index, state, False):
        here = rows.response
        assert here is not None     # for rows of joints alone the joints have noise
        moves = here.closure.joint_matrix(here.pose, here.lines) * problem.sigma_joints[index]
        out[0, rows.index] = here.closure.lengths(here.pose)
        out[1, rows.index] = np.linalg.norm(with_gaps(moves, problem.sigma_gaps[index]), axis=-1)
    return out[0], out[1]


def closure_lengths(problem: Problem, state: State, index: int) -> Array:
    """Return the misclosure of the limbs at the measured poses, m (N, m); nan if unknown."""
    data, registration = problem.datasets[index], state.registrations[index]
    out = np.full((len(data), problem.mechanism.equations), np.nan)
    position, rotation = data.position.copy(), data.rotation.copy()
    motion = problem.mechanism.motion
    if motion.planar:
        position[:, 2], rotation[:, :2] = 0.0, 0.0
    if not motion.turns:
        rotation = np.zeros_like(rotation)
    whole = finite_rows(position) & finite_rows(rotation) & finite_rows(data.q)
    if not data.kind.sees_rotation and motion.turns:
        return out
    joints = problem.joints(index, state)
    for rows, environment in problem.chunks(index):
        mine = whole[rows]
        if not mine.any():
            continue
        measured = np.concatenate([position[rows][mine], rotation[rows][mine]], axis=1)
        pose, q = carried_back(problem.mechanism, registration, measured), joints[rows][mine]
        model = shifted(Model(problem.mechanism, state.g), environment.take(mine), q, pose)
        if model.shift is not None and model.shift.pose is not None:
            pose = moved(pose, -model.shift.pose)
        out[rows][mine] = model.closure(q).lengths(pose)
    return out


@stage("registering the nominal machine")
def register_only(problem: Problem, robust: bool = True) -> Fit:
    """Fit only open frames and targets, with fixed geometry; ``robust``: set aside gross errors."""
    bare = replace(problem, free=(), earlier=None)
    # with known poses, any start is close enough for frames and targets
    return identify(bare, FitOptions(method="flat", robust=robust), at_minimum=True)


def split(datasets: Sequence[Dataset], fraction: float, seed: int) -> list[Bools]:
    """Return which rows to hold out: whole commanded poses, seeded, by data set (N,).

    A pose shared by several files of one campaign is held out of all of them.
    """
    rng = np.random.default_rng(seed)
    out, known, held = list[Bools](), np.zeros(0, np.int64), np.zeros(0, np.int64)
    for own in pose_labels(datasets):
        # a pose shared with an earlier file is held out there or nowhere
        labels = np.setdiff1d(own, known)
        known = np.union1d(known, labels)
        held = np.union1d(held, rng.permutation(labels)[:round(fraction * labels.size)])
        out.append(np.isin(own, held))
    return out


@stage("predicting held-out poses")
def held_out(whole: Fit, options: FitOptions, fraction: float, seed: int, noise: float = 1.0
             ) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures on poses held out of a fit of the others, and how this was done.

    Rows that are not in the fit to everything, ``whole``, count in neither fit nor figures;
    ``noise``: factor on the stated noise, as in that fit.
    """
    problem, keep = whole.problem, whole.keep
    out = split(problem.datasets, fraction, seed)
    rest = sum(int((~o).sum()) * values_per_row(d, problem.mechanism)
               for o, d in zip(out, problem.datasets, strict=True))
    if sum(int(o.sum()) for o in out) == 0 or rest < 1.2 * len(problem.columns):
        return {}, "too few poses to hold any out"
    part = replace(problem, datasets=tuple(
        (d if k.all() else d.without(~k, LEFT_OUT)).take(~o)
        for d, k, o in zip(problem.datasets, keep, out, strict=True)))
    fit = with_noise(_without(whole, part, out, options), noise, options)
    fresh = replace(problem, datasets=tuple(d.take(o) for d, o in
                                            zip(problem.datasets, out, strict=True)))
    state = fresh_state(fresh, fit.state)
    rows = [finite_rows(p) & k[o] for p, k, o in
            zip(state.poses, keep, out, strict=True)]
    figures = residuals(fresh, state).counted(rows)
    return figures, (f"{fraction:.0%} of the poses (seed {seed}) kept out of a fit of the others; "
                     "the final fit uses all")


def _without(whole: Fit, part: Problem, out: Sequence[Bools], options: FitOptions) -> Fit:
    """Fit all rows except those ``out`` (N,), by data set.

    The minimum is near that of all rows. But without a prior, parameters that the rest cannot see
    would stay where the held-out rows put them, so then the fit starts from scratch.
    """
    if options.method not in ("prior", "gcv"):
        return identify(part, options)
    start = replace(whole.state, poses=tuple(
        p[~o] for p, o in zip(whole.state.poses, out, strict=True)))
    return identify(part, options, start=start, near=True, at_minimum=True)


def fresh_state(problem: Problem, fitted: State) -> State:
    """Return a state with fitted parameters and registrations, poses solved for other rows."""
    model = Model(problem.mechanism, fitted.g)
    poses = tuple(problem.reached(i, model, s.homing) for i, s in enumerate(fitted.registrations))
    return State(fitted.g, fitted.registrations, poses)


@stage("predicting other measurements")
def on_other(fit: Fit, other: Sequence[Dataset]) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures on other data sets, and how they were registered."""
    errors, rows = on_other_rows(fit, other)
    known = {d.name for d in fit.problem.datasets}
    anew = [d.name for d in other if d.frame.fitted and d.frame.same_as not in known]
    how = f"; frame registered anew on {', '.join(anew)}" if anew else ""
    return errors.counted(rows), (
        f"on {', '.join(d.name for d in other)}, which the fit had not seen{how}")


def on_other_rows(fit: Fit, other: Sequence[Dataset]) -> tuple[Residuals, list[Bools]]:
    """Return the errors of other data sets with fixed geometry, and where they are known.

    Unknown frames, targets and zeros of theirs are registered on them alone.
    """
    names = {d.name: s for d, s in zip(fit.problem.datasets, fit.state.registrations, strict=True)}
    fresh = [_with_known(d, names) for d in other]
    fresh[0] = opened(fresh[0], ())    # in a fit the first file has the machine's zeros
    problem = Problem(fit.problem.mechanism.with_values(fit.state.g), tuple(fresh), ())
    state = register_only(problem).state
    return residuals(problem, state), [finite_rows(p) for p in state.poses]


def _with_known(data: Dataset, registrations: Mapping[str, Registration]) -> Dataset:
    """Give a held-out data set the frame of the fitted one that it refers to."""
    if data.frame.same_as is None or data.frame.same_as not in registrations:
        return data
    s = registrations[data.frame.same_as]
    frame = replace(data.frame, fitted=False, same_as=None, value=s.frame_pose)
    return replace(data, frame=frame,
                   target=replace(data.target, fitted=False, value=s.target),
                   target_rotation=replace(data.target_rotation, fitted=False,
                                           value=s.target_rotation))


@stage("predicting each session")
def sessions_left_out(problem: Problem, options: FitOptions, keep: Sequence[Bools], noise: float
                      ) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures of every session as predicted by a fit of the others, and how.

    Frame and target of a session that is a whole file are registered again, and so are its zeros
    if no other session determines them.

    Args:
        problem: machine and all data.
        options: of the fits.
        keep: rows in use, by data set.
        noise: factor on the stated noise, as in the fit to everything.

    Raises:
        BadInput: there is only one session.
        NoResult: a fit of the others does not converge.
    """
    masks = session_masks(problem.datasets)
    if len(masks) < 2:
        raise one_session()
    found: list[tuple[Residuals, list[Bools]]] = []
    for rest, own in other_sessions(problem.datasets, keep):
        fit = with_noise(identify(replace(problem, datasets=rest), options), noise, options)
        found.append(on_other_rows(fit, own))
    whole = Residuals(*(tuple(x for r, _ in found for x in getattr(r, name)) for name in (
        "vector", "sigma", "position", "rotation", "closure")))
    return whole.counted([k for _, rows in found for k in rows]), (
        f"{len(masks)} sessions ({', '.join(label for label, _ in masks)}), each predicted by a "
        "fit of the others; the final fit uses all")


def other_sessions(datasets: Sequence[Dataset], keep: Sequence[Bools],
                   judged: Sequence[Bools] | None = None
                   ) -> Iterator[tuple[tuple[Dataset, ...], list[Dataset]]]:
    """Yield for each session the data of all others, and its own; nothing for a single session.

    Args:
        datasets: the campaign.
        keep: rows in use (N,), by data set.
        judged: rows by which predictions of a session are judged; None: the same.
    """
    used, own = (tuple(d.without(~k, LEFT_OUT) for d, k in zip(datasets, rows, strict=True))
                 for rows in (keep, keep if judged is None else judged))
    masks = session_masks(datasets)
    for _, mask in masks if len(masks) > 1 else ():
        rest = tuple(_known_alone(d.take(~m), mask, datasets)
                     for d, m in zip(used, mask, strict=True) if not m.all())
        yield rest, _taken(own, mask, any(d.homing == "shared" for d in rest))


def _taken(datasets: Sequence[Dataset], mask: Sequence[Bools], homed: bool) -> list[Dataset]:
    """Return the usable rows of a session; a part of a file keeps the frame of the others.

    ``homed``: whether others determine the joint zeros; else they are fitted, like the frame.
    """
    out = []
    for data, m in zip(datasets, mask, strict=True):
        usable = m & data.usable
        if usable.any():
            part = data.take(usable)
            if not m.all():
                part = replace(part, frame=replace(part.frame, same_as=data.name))
            elif not homed:
                part = replace(part, homing="per-file")
            out.append(part)
    return out


def _known_alone(data: Dataset, mask: Sequence[Bools], datasets: Sequence[Dataset]) -> Dataset:
    """Return a data set with its own frame if it shared that of a session left out."""
    gone = {d.name for d, m in zip(datasets, mask, strict=True) if m.all()}
    return data.alone() if data.frame.same_as in gone else data
