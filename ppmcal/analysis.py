"""From a fit to statements: estimates with intervals, rank, noise check, residuals.

Everything here is read off the fit's small triangle and one pass over the rows; nothing
is fitted again, except the frames of the "before" figures and the held-out part.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from ppmcal import algebra as cga
from ppmcal.dataset import Dataset
from ppmcal.forward import forward
from ppmcal.identify import (
    Fit,
    SOLVE_TOLERANCE,
    Options,
    identify,
    parameter_scale,
    posterior,
    prediction_covariance,
    prior_square,
)
from ppmcal.mechanism import Mechanism, Model, Registration
from ppmcal.observation import coordinates
from ppmcal.problem import Problem, State
from ppmcal.rank import RANK_TOLERANCE, Rank, analyse, observability

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]

Z95 = 1.959963984540054
FAILED_NOISE = 1e-3
"""The noise check fails below this p-value."""


@dataclass(frozen=True)
class Estimate:
    """One parameter after the fit, SI. ``status``: identified, fixed or redundant."""

    name: str
    quantity: str
    per_unit: bool
    nominal: float
    value: float
    sigma: float | None
    sigma_data: float | None
    tolerance: float | None
    status: str

    @property
    def error(self) -> float:
        """The identified error: value - nominal."""
        return self.value - self.nominal

    @property
    def interval(self) -> tuple[float, float] | None:
        """The 95 % interval of the value, prior included."""
        if self.sigma is None:
            return None
        return self.value - Z95 * self.sigma, self.value + Z95 * self.sigma


@dataclass(frozen=True)
class Dependence:
    """A redundant quantity: one unit of ``name`` acts like these amounts of the others, SI."""

    name: str
    depends_on: Mapping[str, float]


@dataclass(frozen=True)
class Noise:
    """Residuals against the stated noise.

    ``sigma_ratio``: residual over stated noise; ``chi2_p``: chance of a larger chi-squared;
    ``repeat_ratio``: scatter of repeats over stated noise, None without repeats.
    """

    sigma_ratio: float
    chi2: float
    degrees: float
    chi2_p: float
    repeat_ratio: float | None
    repeat_degrees: int

    @property
    def failed(self) -> bool:
        """Whether the residuals are larger than the stated noise can explain."""
        return self.chi2_p < FAILED_NOISE and self.sigma_ratio > 1.0


@dataclass(frozen=True)
class Residuals:
    """Errors row by row, by data set; nan where not measured. SI.

    ``vector`` (N, m) by measured coordinate, ``sigma`` (N, m) their stated standard
    deviations, ``position`` and ``rotation`` norms (N,), ``closure`` (N, d) limb lengths
    at the measured poses, nan where the pose was not fully measured.
    """

    vector: tuple[Array, ...]
    sigma: tuple[Array, ...]
    position: tuple[Array, ...]
    rotation: tuple[Array, ...]
    closure: tuple[Array, ...]

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


@dataclass(frozen=True)
class Identification:
    """Everything that identify reports."""

    fit: Fit
    mechanism: Mechanism
    estimates: tuple[Estimate, ...]
    rank: int
    redundant: tuple[Dependence, ...]
    noise: Noise
    observability: Mapping[str, float]
    columns: tuple[str, ...]
    covariance: Array
    before: Residuals
    before_registrations: Mapping[str, Registration]
    after: Residuals
    holdout: Mapping[str, Mapping[str, float]]
    holdout_note: str
    findings: tuple[str, ...]


def residuals(problem: Problem, state: State) -> Residuals:
    """Return the errors of all rows at a state."""
    parts: list[list[Array]] = [[], [], [], [], []]
    motion = problem.mechanism.motion
    for i, data in enumerate(problem.datasets):
        chosen = coordinates(data, motion)
        places = sum(1 for c in chosen if c < 3)
        vector = np.full((len(data), len(chosen)), np.nan)
        sigma = np.full_like(vector, np.nan)
        one = replace(problem, datasets=(data,))
        for rows in one.rows(State(state.g, (state.stations[i],), (state.poses[i],)), False):
            vector[rows.index] = np.where(rows.observed, rows.raw, np.nan)
            covariance = np.linalg.inv(np.swapaxes(rows.whitener, -1, -2) @ rows.whitener)
            sigma[rows.index] = np.sqrt(np.diagonal(covariance, axis1=-2, axis2=-1))
        parts[0].append(vector)
        parts[1].append(sigma)
        parts[2].append(_norm(vector[:, :places]))
        parts[3].append(_norm(vector[:, places:]))
        parts[4].append(closure_lengths(problem, state, i))
    return Residuals(*(tuple(p) for p in parts))


def _norm(vector: Array) -> Array:
    """Norm over the measured components, nan where none is."""
    seen = np.isfinite(vector)
    norm = np.sqrt(np.sum(np.where(seen, vector, 0.0) ** 2, axis=1))
    return np.where(seen.any(axis=1), norm, np.nan)


def closure_lengths(problem: Problem, state: State, index: int) -> Array:
    """Return the limb conditions at the measured poses, as lengths (N, d); nan if unknown."""
    data, station = problem.datasets[index], state.stations[index]
    out = np.full((len(data), problem.mechanism.conditions), np.nan)
    position, rotation = data.position.copy(), data.rotation.copy()
    motion = problem.mechanism.motion
    if motion == "planar":
        position[:, 2], rotation[:, :2] = 0.0, 0.0
    if motion == "translational":
        rotation = np.zeros_like(rotation)
    whole = (np.isfinite(position).all(axis=1) & np.isfinite(rotation).all(axis=1)
             & np.isfinite(data.q).all(axis=1))
    if (data.kind == "pose" or motion == "translational") and whole.any():
        seen = cga.motor_from_rotation_vector(rotation[whole], position[whole])
        if motion == "translational":
            turn = cga.rotation_vector(station.frame)
            seen = cga.motor_from_rotation_vector(np.broadcast_to(turn, position[whole].shape),
                                                  position[whole])
        body = cga.motor_from_rotation_vector(station.target_rotation, station.target)
        if motion == "translational":
            body = cga.translator(station.target)
        pose = cga.compose(cga.compose(cga.reverse(station.frame), seen), cga.reverse(body))
        joints = problem.joints(index, state)[whole]
        out[whole] = Model(problem.mechanism, state.g).closure(joints).lengths(pose)
    return out


def rank_of(fit: Fit) -> tuple[Rank, int, tuple[Dependence, ...]]:
    """Return the geometry's rank, the rank of all columns, and the redundant ones.

    The total counts open frames and targets, which add none where the geometry can
    imitate them (theory.md, section 5).
    """
    count = len(fit.problem.free)
    rank = analyse(fit.reduced.triangle, count, fit.scale[:count])
    scaled = fit.reduced.triangle * fit.scale
    nuisance = Rank((), (), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0))
    if scaled.shape[1] > count:
        flipped = fit.reduced.triangle[:, count:]
        nuisance = analyse(flipped, flipped.shape[1], fit.scale[count:])
    kept = [*rank.kept, *(count + c for c in nuisance.kept)]
    dropped = [*rank.dropped, *(count + c for c in nuisance.dropped)]
    redundant = []
    norms = np.linalg.norm(scaled, axis=0)
    for d in dropped:
        used = [k for k in kept if k != d]
        solution = np.linalg.lstsq(scaled[:, used], scaled[:, d], rcond=RANK_TOLERANCE)[0]
        weight = np.abs(solution) * norms[used]
        depends = {fit.problem.columns[k]: float(v * fit.scale[k] / fit.scale[d])
                   for k, v, w in zip(used, solution, weight, strict=True)
                   if w > 1e-6 * max(float(weight.max(initial=0.0)), 1e-300)
                   and norms[d] > RANK_TOLERANCE * norms.max()}
        redundant.append(Dependence(fit.problem.columns[d], depends))
    return rank, len(kept), tuple(redundant)


def estimates(fit: Fit, rank: Rank, inflation: float) -> tuple[Estimate, ...]:
    """Return all parameters of the machine with their uncertainties."""
    variance = np.diagonal(posterior(fit)) * inflation**2
    size = len(rank.kept)
    root = np.linalg.inv(rank.factor) if size else np.zeros((0, 0))
    data_sigma = {rank.kept[j]: float(np.linalg.norm(root[j])) for j in range(size)}
    column = {p: c for c, p in enumerate(fit.problem.free)}
    out = []
    for p, parameter in enumerate(fit.problem.mechanism.parameters):
        c = column.get(p)
        sigma, from_data, status = parameter.sigma, None, "fixed"
        if c is not None:
            sigma = float(np.sqrt(variance[c])) if np.isfinite(variance[c]) else None
            status = "identified" if c in data_sigma else "redundant"
            if c in data_sigma:
                from_data = data_sigma[c] * float(fit.scale[c]) * inflation
        out.append(Estimate(parameter.name, parameter.quantity, parameter.per_unit,
                            parameter.nominal, float(fit.state.g[p]), sigma, from_data,
                            parameter.tolerance, status))
    return tuple(out)


def noise_check(fit: Fit) -> Noise:
    """Return chi-squared of data and prior, the noise ratio, and the scatter of repeats."""
    priors = int(np.sum(fit.prior > 0.0))
    matrix = np.concatenate([fit.reduced.triangle * fit.scale, np.diag(fit.prior * fit.scale)])
    s = np.linalg.svd(matrix, compute_uv=False)
    seen = int(np.sum(s > SOLVE_TOLERANCE * s.max(initial=1e-300)))
    covariance = prediction_covariance(fit)
    effective = float(np.sum((fit.reduced.triangle @ covariance) * fit.reduced.triangle))
    degrees = fit.reduced.count + priors - seen
    chi2 = fit.reduced.square + prior_square(fit.problem, fit.state, fit.prior)
    free = max(fit.reduced.count - effective, 1e-9)
    ratio = float(np.sqrt(fit.reduced.square / free))
    repeat, repeat_degrees = _repeats(fit)
    p = float(chdtrc(degrees, chi2)) if degrees > 0 else float("nan")
    return Noise(ratio, chi2, degrees, p, repeat, repeat_degrees)


def _repeats(fit: Fit) -> tuple[float | None, int]:
    """Scatter within repeats of a pose over the stated noise, and its degrees of freedom."""
    square, degrees = 0.0, 0
    white: list[tuple[int, Array, Array, Bools]] = []
    for rows in fit.problem.rows(fit.state, False, fit.keep):
        groups = fit.problem.datasets[rows.dataset].groups[rows.index]
        white.append((rows.dataset, groups, rows.residual, rows.observed))
    for i in range(len(fit.problem.datasets)):
        parts = [(g, r, o) for d, g, r, o in white if d == i]
        if not parts:
            continue
        groups = np.concatenate([g for g, _, _ in parts])
        r, seen = (np.concatenate([p[j] for p in parts]) for j in (1, 2))
        _, label = np.unique(groups, return_inverse=True)
        count = np.zeros((label.max() + 1, r.shape[1]))
        total = np.zeros_like(count)
        np.add.at(count, label, seen.astype(float))
        np.add.at(total, label, np.where(seen, r, 0.0))
        away = np.where(seen, r - (total / np.maximum(count, 1.0))[label], 0.0)
        square += float(np.sum(away**2))
        degrees += int(np.sum(np.maximum(count - 1.0, 0.0)))
    return (float(np.sqrt(square / degrees)), degrees) if degrees else (None, 0)


def registered(problem: Problem, state: State) -> dict[str, Registration]:
    """Return frame and target of every data set, SI."""
    out = {}
    for data, s in zip(problem.datasets, state.stations, strict=True):
        frame = np.concatenate([cga.translation(s.frame), cga.rotation_vector(s.frame)])
        out[data.name] = Registration(frame, s.target, s.target_rotation)
    return out


def with_estimates(fit: Fit, found: Sequence[Estimate]) -> Mechanism:
    """Return the machine with the fitted values, sigmas and registrations."""
    mechanism = fit.problem.mechanism
    parameters = tuple(replace(p, value=e.value, sigma=e.sigma)
                       for p, e in zip(mechanism.parameters, found, strict=True))
    return replace(mechanism, parameters=parameters,
                   home_q=np.full_like(mechanism.home_q, np.nan),
                   registrations={**mechanism.registrations,
                                  **registered(fit.problem, fit.state)})


def register_only(problem: Problem, state: State | None = None) -> Fit:
    """Fit only open frames and targets, geometry as it is."""
    bare = replace(problem, free=())
    return identify(bare, Options(method="flat"), start=state)


def split(datasets: Sequence[Dataset], fraction: float, seed: int) -> list[Bools]:
    """Return which rows to hold out: whole commanded poses, seeded, by data set (N,)."""
    rng = np.random.default_rng(seed)
    out = []
    for data in datasets:
        labels = np.unique(data.groups)
        chosen = rng.permutation(labels)[:int(round(fraction * labels.size))]
        out.append(np.isin(data.groups, chosen))
    return out


def held_out(problem: Problem, options: Options, fraction: float, seed: int,
             keep: Sequence[Bools]) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures on poses that a fit of the others had not seen, and how it was done.

    Rows not in ``keep`` (outliers of the fit to everything) do not count in the figures.
    """
    out = split(problem.datasets, fraction, seed)
    rest = sum(int((~o).sum()) * len(coordinates(d, problem.mechanism.motion))
               for o, d in zip(out, problem.datasets, strict=True))
    if sum(int(o.sum()) for o in out) == 0 or rest < 1.2 * len(problem.columns):
        return {}, "too few poses to hold any out"
    part = replace(problem, datasets=tuple(d.take(~o) for d, o in
                                           zip(problem.datasets, out, strict=True)))
    fit = identify(part, options)
    fresh = replace(problem, datasets=tuple(d.take(o) for d, o in
                                            zip(problem.datasets, out, strict=True)))
    state = fresh_state(fresh, fit.state)
    rows = [np.isfinite(p).all(axis=1) & k[o] for p, k, o in
            zip(state.poses, keep, out, strict=True)]
    figures = residuals(fresh, state).figures(rows)
    return figures, (f"{fraction:.0%} of the poses (seed {seed}) kept out of a fit of the others; "
                     "the final fit uses all")


def fresh_state(problem: Problem, fitted: State) -> State:
    """Return a state with fitted parameters and stations, poses solved for other rows."""


    poses = tuple(forward(Model(problem.mechanism, fitted.g), d.q + s.homing).pose
                  for d, s in zip(problem.datasets, fitted.stations, strict=True))
    return State(fitted.g, fitted.stations, poses)


def report(fit: Fit, options: Options, holdout: float, seed: int,
           other: Sequence[Dataset] = ()) -> Identification:
    """Return everything that there is to say about a fit.

    ``holdout`` is the fraction of poses to hold out (0: none); ``other`` data sets take
    their place, an unknown frame or target of theirs being registered on them alone.
    """
    noise = noise_check(fit)
    inflation = max(1.0, noise.sigma_ratio) if noise.failed else 1.0
    rank, total, redundant = rank_of(fit)
    found = estimates(fit, rank, inflation)
    mechanism = with_estimates(fit, found)
    before = register_only(fit.problem)
    if other:
        held, note = _on_other(fit, other)
    else:
        held, note = held_out(
            fit.problem, options, holdout, seed, fit.keep) if holdout > 0 else (
            {}, "nothing held out")
    index = observability(rank.singular, len(rank.kept), sum(int(k.sum()) for k in fit.keep))
    return Identification(
        fit, mechanism, found, total, redundant, noise, index, fit.problem.columns,
        prediction_covariance(fit) * inflation**2, residuals(fit.problem, before.state),
        registered(fit.problem, before.state), residuals(fit.problem, fit.state), held, note, _findings(fit, noise, inflation))


def _on_other(fit: Fit, other: Sequence[Dataset]) -> tuple[dict[str, dict[str, float]], str]:
    names = {d.name: s for d, s in zip(fit.problem.datasets, fit.state.stations, strict=True)}
    known = tuple(_with_known(d, names) for d in other)
    problem = Problem(fit.problem.mechanism.with_values(fit.state.g), known, ())
    registered_fit = register_only(problem)
    figures = residuals(problem, registered_fit.state).figures(
        [np.isfinite(p).all(axis=1) for p in registered_fit.state.poses])
    anew = [d.name for d in known if d.frame.fitted]
    how = f"; frame registered anew on {', '.join(anew)}" if anew else ""
    return figures, f"on {', '.join(d.name for d in other)}, which the fit had not seen{how}"


def _with_known(data: Dataset, stations: Mapping[str, object]) -> Dataset:
    """Give a held-out data set the frame of the fitted one that it names."""
    if data.frame.same_as is None or data.frame.same_as not in stations:
        return data
    s = stations[data.frame.same_as]
    frame = np.concatenate([cga.translation(s.frame), cga.rotation_vector(s.frame)])
    return replace(data, frame=replace(data.frame, fitted=False, same_as=None, value=frame),
                   target=replace(data.target, fitted=False, value=s.target),
                   target_rotation=replace(data.target_rotation, fitted=False,
                                           value=s.target_rotation))


def _findings(fit: Fit, noise: Noise, inflation: float) -> tuple[str, ...]:
    out = [f for d in fit.problem.datasets for f in d.findings]
    for data, reasons in zip(fit.problem.datasets, fit.reasons, strict=True):
        if reasons:
            out.append(f"{data.name}: {len(reasons)} of {len(data)} rows left out, "
                       "see residuals.csv for each reason")
    if noise.failed:
        out.append(f"the residuals are {noise.sigma_ratio:.2f} times the stated noise "
                   f"(p = {noise.chi2_p:.2g}): something is missing in the model, or sigma is too "
                   f"small; all uncertainties are scaled by {inflation:.2f}")
    if not fit.converged:
        out.append(f"the fit had not converged after {fit.iterations} iterations")
    return tuple(out)


__all__ = ["Estimate", "Identification", "Noise", "Residuals", "held_out", "noise_check",
           "parameter_scale", "rank_of", "register_only", "report", "residuals", "split"]
