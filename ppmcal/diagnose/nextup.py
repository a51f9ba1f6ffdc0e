"""What to measure next: poses and settings that tell rivals apart.

T-optimal design (Atkinson-Fedorov): rival b is fitted, geometry and all, to what effect a
predicts; the row where they still differ most is measured next. Both directions count,
the worse one decides.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.arrays import known
from ppmcal.closure import Model
from ppmcal.dataset import Dataset
from ppmcal.diagnose.candidates import library
from ppmcal.diagnose.forms import Form
from ppmcal.diagnose.stage import Stage, without
from ppmcal.diagnose.system import build
from ppmcal.kinematics import inverse_table
from ppmcal.problem import State
from ppmcal.targets import pose_motor, pose_vector

Array = NDArray[np.float64]
POSES = 150
WIDER = 0.25
"""Poses are drawn from the measured range, wider by this part on each side."""
MOST_ROWS = 120
ENOUGH = 2.0 * np.log(1000.0)
"""Rivals count as told apart at odds of 1000 to 1: twice the log-likelihood ratio."""
REMEDY = {
    "sensor_scale": "measure a known distance (a scale bar) with the same instrument",
    "leg_thermal": "record temperature_<sensor> of legs and of the base apart",
    "base_thermal": "record temperature_<sensor> of legs and of the base apart",
    "platform_thermal": "record temperature_<sensor> of the platform apart",
    "drift": "go back to one reference pose at intervals, at changing temperature",
    "gain": "measure one joint's travel directly, or a known distance",
}


@dataclass(frozen=True, eq=False)
class Proposal:
    """Measurements worth taking, or what to record instead.

    ``q`` (R, k) joints, ``pose`` (R, 6) platform poses in the base frame, ``columns``:
    settings in SI by name (R,); ``odds_before`` and ``odds_after`` for the rival of the
    lower likelihood being found out; ``reason`` in words.
    """

    reason: str
    q: Array
    pose: Array
    columns: Mapping[str, Array] = field(default_factory=dict)
    odds_before: float = 1.0
    odds_after: float = 1.0

    @property
    def rows(self) -> int:
        """Number of measurements proposed."""
        return int(self.q.shape[0])


def nothing(reason: str, joints: int) -> Proposal:
    """Return an empty proposal."""
    return Proposal(reason, np.zeros((0, joints)), np.zeros((0, 6)))


def propose(stage: Stage, one: int, two: int, seed: int) -> Proposal:
    """Return measurements that tell two forms of the stage's library apart."""
    mechanism = stage.system.problem.mechanism
    a, b = stage.forms[one], stage.forms[two]
    rng = np.random.default_rng(seed)
    data = _possible(stage, rng)
    if data is None:
        return nothing("no further pose is within reach", len(mechanism.actuators))
    old = _blocks(stage, stage.system.residual.shape[0], one, two, None)
    new = _blocks(stage, len(data), one, two, data)
    if new is None or old is None:
        return nothing(_remedy(a, b), len(mechanism.actuators))
    value_a, value_b = stage.search.gram.fit(a.columns)[0], stage.search.gram.fit(b.columns)[0]
    picked, path = _pick(old, new, value_a, value_b)
    before = float(np.exp(min(path[0] / 2.0, 300.0)))
    after = float(np.exp(min(path[-1] / 2.0, 300.0)))
    label = f"{a.label} and {b.label}"
    none: tuple[Array, Array, dict[str, Array]] = (
        np.zeros((0, data.q.shape[1])), np.zeros((0, 6)), {})
    if not picked and path[-1] >= ENOUGH:
        return Proposal(f"these rows favour {a.label} over {b.label}, but only by the small part "
                        f"that geometry does not imitate: {_remedy(a, b)}", *none, before, after)
    if path[-1] < ENOUGH:
        many = (f"{len(picked)} further measurements" if picked else "further measurements alone")
        return Proposal(f"{many} would not tell {label} apart: {_remedy(a, b)}", *none, before,
                        after)
    rows = np.array(picked, dtype=np.int64)
    needed = {n: c[rows] for n, c in data.columns.items()}
    pose = pose_vector(pose_motor(np.nan_to_num(np.concatenate(
        [data.position, data.rotation], axis=1)[rows])))
    return Proposal(f"{len(picked)} measurements tell {label} apart", data.q[rows], pose, needed,
                    before, after)


def _remedy(a: Form, b: Form) -> str:
    hints = [REMEDY[f.kind] for f in (a, b) if f.kind in REMEDY]
    return hints[0] if hints else "record what the two depend on separately"


def _possible(stage: Stage, rng: np.random.Generator) -> Dataset | None:
    """Return poses within and around the measured range, each under several settings."""
    problem = stage.system.problem
    seen = pose_vector(np.concatenate([p.response.pose for p in stage.system.parts]))
    low, high = seen.min(axis=0), seen.max(axis=0)
    wide = WIDER * (high - low)
    wanted = rng.uniform(low - wide, high + wide, (POSES, 6))
    short = problem.mechanism.conditions - len(problem.mechanism.actuators)
    if short:
        wanted = seen[rng.integers(len(seen), size=POSES)]
    bare = Model(replace(problem.mechanism, effects=()), stage.system.state.g)
    table = inverse_table(bare, wanted)
    good = np.array([s == "ok" for s in table.status])
    if not good.any():
        return None
    q, pose = table.q[good], table.pose[good]
    columns = _settings(stage, len(q), rng)
    repeat = len(next(iter(columns.values()))) // len(q) if columns else 1
    q, pose = np.tile(q, (repeat, 1)), np.tile(pose, (repeat, 1))
    flat = np.array([False, False, True, True, True, False]) & (
        problem.mechanism.motion == "planar")
    first = problem.datasets[0]
    sigma = (float(np.nanmedian(first.sigma_position)), float(np.nanmedian(first.sigma_rotation)))
    data = Dataset.of_poses(first.name, q, np.where(flat, np.nan, pose), sigma, fitted=False)
    return replace(data, columns=columns, kind=first.kind, frame=first.frame,
                   target=first.target, target_rotation=first.target_rotation)


def _settings(stage: Stage, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return settings at the ends of what was recorded, four of them for each of n poses."""
    data = stage.system.problem.datasets[0]
    out: dict[str, Array] = {}
    signs = np.array([1.0, -1.0, 1.0, -1.0])
    levels = np.array([1.0, 1.0, -1.0, -1.0])
    for name in sorted(data.columns):  # dir_ before vel_
        values = data.columns[name]
        seen = values[np.isfinite(values)]
        if not seen.size:
            continue
        if name.startswith("dir_"):
            pattern = rng.choice([-1.0, 1.0], size=n)
            out[name] = np.concatenate([s * pattern for s in signs])
        elif name.startswith("vel_"):
            speed = np.abs(seen)
            way = out.get(f"dir_{name.removeprefix('vel_')}", np.repeat(signs, n))
            out[name] = way * np.repeat(np.where(levels > 0, speed.max(), speed.min()), n)
        elif name == "time":
            out[name] = np.concatenate([np.full(n, seen.max() + 60.0 * (i + 1) * n)
                                        for i in range(4)])
        else:
            ends = (seen.min(), seen.max())
            out[name] = np.concatenate([
                np.full(n, ends[1] if (level > 0) != (name == "temperature" and sign < 0)
                        else ends[0]) for sign, level in zip(signs, levels, strict=True)])
    return out


Blocks = tuple[Array, Array, Array]


def _blocks(stage: Stage, rows: int, one: int, two: int, data: Dataset | None) -> Blocks | None:
    """Return geometry (R, m, c), and the columns of both forms, of old or possible rows."""
    a, b = stage.forms[one], stage.forms[two]
    if data is None:
        shape = (rows, stage.system.residual.shape[1], -1)
        total = stage.columns.shape[1]
        if max(*a.columns, *b.columns) >= total:
            return None
        geometry = stage.noise.apply(stage.system.jacobian, stage.system)
        return (geometry.reshape(shape), stage.columns[:, a.columns].reshape(shape),
                stage.columns[:, b.columns].reshape(shape))
    problem = replace(stage.system.problem, datasets=(data,),
                      pivots=(stage.system.problem.opens[0].about,), given=None)
    start = State(stage.system.state.g, stage.system.state.stations[:1],
                  (pose_motor(np.nan_to_num(np.concatenate([data.position, data.rotation],
                                                           axis=1))),))
    state = problem.solve(start)
    keep = [known(state.poses[0])]
    if not keep[0].all():
        return None
    system = without(build(problem, state, keep), stage.added)
    found = library(system, tuple({a.kind, b.kind}))

    def columns(form: Form) -> Array | None:
        match = [f for f in found.forms if (f.kind, f.on, f.shared, f.slot) == (
            form.kind, form.on, form.shared, form.slot)]
        match.sort(key=lambda f: sum(abs(v - form.constants.get(n, v))
                                     for n, v in f.constants.items()))
        return found.columns[..., match[0].columns] if match else None

    left, right = columns(a), columns(b)
    return None if left is None or right is None else (system.jacobian, left, right)


def _pick(old: Blocks, new: Blocks, value_a: Array, value_b: Array
          ) -> tuple[list[int], list[float]]:
    """Return chosen rows and twice the log-likelihood ratio after each (worse direction)."""
    ways = [(_reduced(old[0], old[rival], old[truth] @ value),
             np.concatenate([new[0], new[rival]], axis=-1), new[truth] @ value)
            for truth, rival, value in ((1, 2, value_a), (2, 1, value_b))]
    picked: list[int] = []
    figures, differences = _apart(ways, picked)
    path = [min(figures)]
    while len(picked) < MOST_ROWS and path[-1] < ENOUGH:
        gain = differences[int(np.argmin(figures))]
        gain[picked] = -1.0
        best = int(np.argmax(gain))
        if gain[best] <= 1e-12:
            break
        picked.append(best)
        figures, differences = _apart(ways, picked)
        path.append(min(figures))
    return picked, path


def _reduced(geometry: Array, rival: Array, goal: Array) -> Array:
    """Return old rows as one triangle [geometry, rival, goal]."""
    whole = np.concatenate([geometry, rival, goal[..., None]], axis=-1)
    return np.asarray(np.linalg.qr(whole.reshape(-1, whole.shape[-1]), mode="r"))


def _apart(ways: list[tuple[Array, Array, Array]], picked: list[int]
           ) -> tuple[list[float], list[Array]]:
    """Return, both ways, what the rival cannot imitate, in all and row by row."""
    figures, rows = [], []
    for old, columns, goal in ways:
        matrix = np.concatenate([old[:, :-1], columns[picked].reshape(-1, columns.shape[-1])])
        right = np.concatenate([old[:, -1], goal[picked].reshape(-1)])
        solution = np.linalg.lstsq(matrix, right, rcond=1e-10)[0]
        figures.append(float(np.sum((right - matrix @ solution) ** 2)))
        rows.append(np.sum((goal - columns @ solution) ** 2, axis=1))
    return figures, rows
