"""How well a fit predicts what it has not seen."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.arrays import Bools, known
from ppmcal.fit import Fit, Options
from ppmcal.identify import identify
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.registration import Station
from ppmcal.model.dataset import Dataset
from ppmcal.observation import coordinates
from ppmcal.problem import Problem, State
from ppmcal.residuals import residuals
from ppmcal.variance import with_noise


def register_only(problem: Problem, state: State | None = None) -> Fit:
    """Fit only open frames and targets, geometry as it is."""
    bare = replace(problem, free=(), earlier=None)
    return identify(bare, Options(method="flat"), start=state)


def split(datasets: Sequence[Dataset], fraction: float, seed: int) -> list[Bools]:
    """Return which rows to hold out: whole commanded poses, seeded, by data set (N,)."""
    rng = np.random.default_rng(seed)
    out = []
    for data in datasets:
        labels = np.unique(data.groups)
        chosen = rng.permutation(labels)[:round(fraction * labels.size)]
        out.append(np.isin(data.groups, chosen))
    return out


def held_out(problem: Problem, options: Options, fraction: float, seed: int,
             keep: Sequence[Bools], noise: float = 1.0
             ) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures on poses that a fit of the others had not seen, and how it was done.

    Rows not in ``keep`` (outliers of the fit to everything) do not count in the figures;
    ``noise``: factor on the stated one, as in the fit to everything.
    """
    out = split(problem.datasets, fraction, seed)
    rest = sum(int((~o).sum()) * len(coordinates(d, problem.mechanism.motion))
               for o, d in zip(out, problem.datasets, strict=True))
    if sum(int(o.sum()) for o in out) == 0 or rest < 1.2 * len(problem.columns):
        return {}, "too few poses to hold any out"
    part = replace(problem, datasets=tuple(d.take(~o) for d, o in
                                           zip(problem.datasets, out, strict=True)))
    fit = with_noise(identify(part, options), noise, options)
    fresh = replace(problem, datasets=tuple(d.take(o) for d, o in
                                            zip(problem.datasets, out, strict=True)))
    state = fresh_state(fresh, fit.state)
    rows = [known(p) & k[o] for p, k, o in
            zip(state.poses, keep, out, strict=True)]
    figures = residuals(fresh, state).figures(rows)
    return figures, (f"{fraction:.0%} of the poses (seed {seed}) kept out of a fit of the others; "
                     "the final fit uses all")


def fresh_state(problem: Problem, fitted: State) -> State:
    """Return a state with fitted parameters and stations, poses solved for other rows."""
    model = Model(problem.mechanism, fitted.g)
    poses = tuple(problem.reached(i, model, s.homing) for i, s in enumerate(fitted.stations))
    return State(fitted.g, fitted.stations, poses)


def on_other(fit: Fit, other: Sequence[Dataset]) -> tuple[dict[str, dict[str, float]], str]:
    """Return the figures on other data sets, and how they were registered."""
    names = {d.name: s for d, s in zip(fit.problem.datasets, fit.state.stations, strict=True)}
    fresh = tuple(_with_known(d, names) for d in other)
    problem = Problem(fit.problem.mechanism.with_values(fit.state.g), fresh, ())
    registered_fit = register_only(problem)
    figures = residuals(problem, registered_fit.state).figures(
        [known(p) for p in registered_fit.state.poses])
    anew = [d.name for d in fresh if d.frame.fitted]
    how = f"; frame registered anew on {', '.join(anew)}" if anew else ""
    return figures, f"on {', '.join(d.name for d in other)}, which the fit had not seen{how}"


def _with_known(data: Dataset, stations: Mapping[str, Station]) -> Dataset:
    """Give a held-out data set the frame of the fitted one that it names."""
    if data.frame.same_as is None or data.frame.same_as not in stations:
        return data
    s = stations[data.frame.same_as]
    frame = replace(data.frame, fitted=False, same_as=None, value=pose_vector(s.frame))
    return replace(data, frame=frame,
                   target=replace(data.target, fitted=False, value=s.target),
                   target_rotation=replace(data.target_rotation, fitted=False,
                                           value=s.target_rotation))
