"""What to measure next: poses and settings that separate rivals.

T-optimal design (Atkinson-Fedorov): rival b, with all geometry, is fitted to the predictions of
effect a; the row where they still differ most is measured next. Both directions count, the worse
one decides.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import State, WeakCampaign
from ppmcal.diagnosis.candidates import library
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.linear_system import build
from ppmcal.diagnosis.linearisation import Linearisation, without
from ppmcal.inference.priors import SURE_ODDS, SURE_SIGMAS
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import environment_of
from ppmcal.kinematics.partial_pose import pose_motor, pose_vector
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import WRENCH, Dataset
from ppmcal.wording import pluralize, shorten_label

POSES = 150
WIDER = 0.25
"""Poses are drawn from the measured range, wider by this part on each side."""
FEWEST_ROWS, MOST_ROWS = 4, 120
"""Limits of a proposal: a single row could be an outlier, and would be treated as one."""
SETTLED = 2.0 * np.log(SURE_ODDS)
"""Odds at which rivals count as separated, as twice the log-likelihood ratio."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """Measurements worth taking, or what to record instead.

    ``q`` (R, k) joints, ``pose`` (R, 6) platform poses in the base frame, ``columns``: settings in
    SI by name (R,); ``odds_before`` and ``odds_after``: between the rivals, now and after these
    rows (reached with a probability of 95 %, given noise); ``reason`` in words.
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


MATTER = {"load": ("payload", "tension_", *WRENCH), "temperature": ("temperature",),
          "time": ("time",)}
"""Possible influences, and prefixes of the columns that record them."""
ALL_RECORDED = ("measure the same poses again in another order: errors that repeat depend on the "
                "pose, others on time or on the path")


def record_more(datasets: Sequence[Dataset]) -> str:
    """Return the advice to record further possible influences; if all are, what else to do."""
    missing = [what for what, begins in MATTER.items() if any(
        not any(c.startswith(begins) for c in d.columns) for d in datasets)]
    return (f"record further possible influences ({', '.join(missing)})" if missing
            else ALL_RECORDED)


def with_poses(proposal: Proposal, campaign: WeakCampaign | None) -> Proposal:
    """Return a proposal with the poses that a weak campaign lacks, if it has none itself."""
    if campaign is None or proposal.rows:
        return proposal
    missing = campaign.missing
    what = "touch" if campaign.touches else "pose"
    many = f"{len(missing.q)} {what}{'es' if what == 'touch' else 's'}"
    return Proposal(f"{many} to determine the geometry, before effects can be separated from it",
                    missing.q, missing.pose)


def propose(stage: Linearisation, a: Hypothesis, b: Hypothesis, odds: float, seed: int) -> Proposal:
    """Return measurements that separate two hypotheses; ``odds`` favour ``a``."""
    mechanism = stage.system.problem.mechanism
    rng = np.random.default_rng(seed)
    data = possible_rows(stage, rng)
    if data is None:
        return nothing("no further pose is within reach", len(mechanism.actuators))
    old = _old_blocks(stage, a, b)
    new = _new_blocks(stage, a, b, data)
    if new is None:
        return nothing(_remedy(a, b), len(mechanism.actuators))
    value_a, value_b = stage.sizes(a.columns), stage.sizes(b.columns)
    start = 2.0 * abs(float(np.log(odds)))
    goal = wanted(start)
    picked, gain = _pick(old, new, value_a, value_b, goal)
    unlucky = gain - 2.0 * SURE_SIGMAS * np.sqrt(gain)
    after = float(np.exp(np.clip((unlucky - start) / 2.0, 0.0, 300.0)))
    label = " and ".join(shorten_label(f.label, len(mechanism.actuators)) for f in (a, b))
    if gain < goal:
        many = (pluralize(len(picked), "further measurement") if picked
                else "further measurements alone")
        return Proposal(f"{many} would not separate {label}: {_remedy(a, b)}",
                        np.zeros((0, data.q.shape[1])), np.zeros((0, 6)), {}, odds, after)
    rows = np.array(picked, dtype=np.int64)
    needed = {n: c[rows] for n, c in data.columns.items()}
    if "time" in needed:
        seen = stage.system.problem.datasets[_template(stage)].columns["time"]
        needed["time"] = after_last(seen[np.isfinite(seen)], len(rows))
    pose = pose_vector(pose_motor(np.nan_to_num(np.concatenate(
        [data.position, data.rotation], axis=1)[rows])))
    reason = f"{pluralize(len(picked), 'measurement')} that would separate {label}"
    measured = np.concatenate([d.q for d in stage.system.problem.datasets])
    # neither has been observed out there: expect them to separate, but not by how much
    if np.any((data.q[rows] < measured.min(axis=0)) | (data.q[rows] > measured.max(axis=0))):
        after = min(after, SURE_ODDS)
        reason += (", some of them outside the measured range, where the model has not been "
                   "verified")
    elif "time" in needed and any(f.effect is not None and "time" in f.effect.needs
                                  for f in (a, b)):
        after = min(after, SURE_ODDS)
        reason += ", after the last row, if both effects persist until then"
    return Proposal(reason, data.q[rows], pose, needed, odds, after)


def wanted(start: float) -> float:
    """Return the separation D of two rivals that new rows must reach to settle them.

    Twice the log-likelihood ratio of new rows is D with a standard deviation of 2 sqrt(D); it must
    outweigh that of the old rows, ``start``, which may favour the wrong rival, and then reach
    :data:`SETTLED`.
    """
    return float((SURE_SIGMAS + np.sqrt(SURE_SIGMAS**2 + SETTLED + start)) ** 2)


def _remedy(a: Hypothesis, b: Hypothesis) -> str:
    hints = [f.effect.remedy for f in (a, b) if f.effect is not None and f.effect.remedy]
    return hints[0] if hints else "record their inputs separately"


def possible_rows(stage: Linearisation, rng: np.random.Generator) -> Dataset | None:
    """Return poses within and around the measured range, each under several settings.

    No nearer to a singularity than measured poses, except for the margin by which the range widens.
    """
    problem = stage.system.problem
    first = problem.datasets[_template(stage)]
    if first.to_q is not None:
        return None
    seen = pose_vector(np.concatenate([p.response.pose for p in stage.system.parts]))
    low, high = seen.min(axis=0), seen.max(axis=0)
    wide = WIDER * (high - low)
    tried = rng.uniform(low - wide, high + wide, (POSES, 6))
    short = problem.mechanism.dependent
    if short:
        tried = seen[rng.integers(len(seen), size=POSES)]
    bare = Model(replace(problem.mechanism, effects=()), stage.system.state.g)
    table = inverse_table(bare, tried)
    good = np.array([s == "ok" for s in table.status])
    nearest = inverse_table(bare, seen[::max(1, len(seen) // POSES)]).singular_value
    good &= table.singular_value >= (1.0 - WIDER) * np.nanmin(nearest, initial=np.inf)
    if not good.any():
        return None
    q, pose = table.q[good], table.pose[good]
    columns = _settings(stage, len(q), rng)
    repeat = len(next(iter(columns.values()))) // len(q) if columns else 1
    q, pose = np.tile(q, (repeat, 1)), np.tile(pose, (repeat, 1))
    flat = np.array([False, False, True, True, True, False]) & (
        problem.mechanism.motion.planar)
    place, turn, number = (float(np.median(s[np.isfinite(s)])) if np.isfinite(s).any() else 1.0
                           for s in (first.sigma_position, first.sigma_rotation,
                                     first.sigma_value))
    data = Dataset.of_poses(first.name, q, np.where(flat, np.nan, pose), (place, turn), False)
    # for a height or a distance only the slopes count here, whatever the value
    value = np.full(len(q), np.nan if not first.kind.scalar else float(
        np.median(first.value[np.isfinite(first.value)])))
    return replace(data, columns=columns, kind=first.kind, frame=first.frame, value=value,
                   sigma_value=np.full(len(q), number), target=first.target,
                   target_rotation=first.target_rotation, offset=first.offset,
                   extra=first.extra)


def _template(stage: Linearisation) -> int:
    """Return the data set that new rows resemble: not distances between two platform positions."""
    single = [i for i, d in enumerate(stage.system.problem.datasets) if d.to_q is None]
    return single[0] if single else 0


def _settings(stage: Linearisation, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return settings at the ends of the recorded ranges, four for each of n poses."""
    data = stage.system.problem.datasets[_template(stage)]
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
            # times of the next few rows: later ones show more drift, but are no more certain
            out[name] = np.repeat(after_last(seen, 4), n)
        else:
            ends = (seen.min(), seen.max())
            out[name] = np.concatenate([
                np.full(n, ends[1] if (level > 0) != (name == "temperature" and sign < 0)
                        else ends[0]) for sign, level in zip(signs, levels, strict=True)])
    return out


def after_last(time: Array, count: int) -> Array:
    """Return the times of further rows (count,), s: after the last, at the campaign's pace.

    ``time``: of the measured rows (N,).
    """
    steps = np.diff(np.sort(time))
    steps = steps[steps > 0.0]
    pace = float(np.median(steps)) if steps.size else 1.0
    return np.asarray(time.max() + pace * np.arange(1, count + 1))


Blocks = tuple[Array, Array, Array]


def _old_blocks(stage: Linearisation, a: Hypothesis, b: Hypothesis) -> Blocks:
    """Return geometry (N, m, c) and the columns of both hypotheses, in the measured rows."""
    shape = (*stage.system.residual.shape, -1)
    geometry = stage.noise.apply(stage.system.jacobian, stage.system)
    return (geometry.reshape(shape), stage.some(a.columns).reshape(shape),
            stage.some(b.columns).reshape(shape))


def _new_blocks(stage: Linearisation, a: Hypothesis, b: Hypothesis, data: Dataset) -> Blocks | None:
    """Return the same in possible rows; None if a pose or a hypothesis does not exist there."""
    i = _template(stage)
    # proposed rows have no history
    rows = replace(environment_of(stage.system.problem.mechanism, data), history=None, place=None)
    problem = replace(stage.system.problem, datasets=(data,),
                      pivots=(stage.system.problem.opens[i].about,), given=(rows,))
    start = State(stage.system.state.g, (stage.system.state.registrations[i],),
                  (pose_motor(np.nan_to_num(np.concatenate([data.position, data.rotation],
                                                           axis=1))),))
    state = problem.solve(start)
    keep = [finite_rows(state.poses[0])]
    if not keep[0].all():
        return None
    system = without(build(problem, state, keep), stage.added)
    found = library(system, tuple({a.kind, b.kind}), [problem.free[c] for c in stage.added])

    each = []
    for h in (a, b):
        match = [f for f in found.hypotheses if (f.family, f.on, f.shared, f.names) == (
            h.family, h.on, h.shared, h.names)]
        if not match:
            return None
        each.append(found.some(min(match, key=h.apart).columns))
    # frames and targets of other data sets are free too, but do not affect the new rows
    here, there = ([n for c, n in enumerate(p.columns) if c not in set(stage.added)]
                   for p in (problem, stage.system.problem))
    geometry = np.zeros((*system.residual.shape, len(there)))
    geometry[..., [there.index(n) for n in here]] = system.jacobian
    return geometry, each[0], each[1]


def _pick(old: Blocks, new: Blocks, value_a: Array, value_b: Array, goal: float
          ) -> tuple[list[int], float]:
    """Return chosen rows, and the separation that they give (worse direction)."""
    ways = [(_reduced(old[0], old[rival], old[truth] @ value),
             np.concatenate([new[0], new[rival]], axis=-1), new[truth] @ value)
            for truth, rival, value in ((1, 2, value_a), (2, 1, value_b))]
    picked: list[int] = []
    start, differences = _apart(ways, picked)
    figures = start
    while len(picked) < FEWEST_ROWS or (
            len(picked) < MOST_ROWS and _least(figures, start) < goal):
        best = _next_row(differences[int(np.argmin(np.subtract(figures, start)))], picked)
        if best is None:
            break
        picked.append(best)
        figures, differences = _apart(ways, picked)
    return picked, _least(figures, start)


def _least(figures: list[float], start: list[float]) -> float:
    return max(float(np.min(np.subtract(figures, start))), 0.0)


def _next_row(gain: Array, picked: list[int]) -> int | None:
    gain[picked] = -1.0
    best = int(np.argmax(gain))
    return best if gain[best] > 1e-12 else None


def _reduced(geometry: Array, rival: Array, goal: Array) -> Array:
    """Return old rows [geometry, rival, goal] reduced to one triangle."""
    whole = np.concatenate([geometry, rival, goal[..., None]], axis=-1)
    return linalg.triangle(whole.reshape(-1, whole.shape[-1]))


def _apart(ways: list[tuple[Array, Array, Array]], picked: list[int]
           ) -> tuple[list[float], list[Array]]:
    """Return, both ways, the squares that the rival cannot reproduce, in total and by row."""
    figures, rows = [], []
    for old, columns, goal in ways:
        matrix = np.concatenate([old[:, :-1], columns[picked].reshape(-1, columns.shape[-1])])
        right = np.concatenate([old[:, -1], goal[picked].reshape(-1)])
        solution = linalg.lstsq(matrix, right, rcond=1e-10)[0]
        figures.append(float(np.sum((right - matrix @ solution) ** 2)))
        rows.append(np.sum((goal - columns @ solution) ** 2, axis=1))
    return figures, rows
