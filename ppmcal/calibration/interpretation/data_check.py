"""Is this file the machine that I think it is? Findings before anything is measured.

"Closed" means closed within what the file can know: the last printed digit of every number,
and three standard deviations of the tolerances, carried to each limb's closure equation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import (
    RANK_TOLERANCE,
    Fit,
    Problem,
    State,
    Unidentifiable,
    branch_findings,
    column_scale,
    data_rows,
    prior_weights,
    qr_factor,
    unidentifiable,
    whole_rank,
)
from ppmcal.calibration.interpretation.misread import Misreading, mend_of, misreading_sentence
from ppmcal.calibration.interpretation.obvious_mistakes import plain_mistakes
from ppmcal.calibration.interpretation.read_rightly import refusal
from ppmcal.calibration.knowledge import Identifiability, predict_identifiability
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.inverse import home_state, to_joint
from ppmcal.kinematics.needed_columns import remembers
from ppmcal.kinematics.partial_pose import named_only
from ppmcal.kinematics.tables import SINGULAR_HOME, home_singular_value, inverse_table
from ppmcal.kinematics.transmission import transmissions_at
from ppmcal.linalg import Array, finite_rows, ways
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import counted
from ppmcal.wording.progress import stage

DEAD_POINT = 0.02
"""A finding: a limb's transmission at home below this."""
GOOD_TRANSMISSION = 0.5
"""A limb above this is not asked whether its tolerances can bring it to a dead point."""
TRIAL_POSES = 80


@dataclass(frozen=True)
class LimbGap:
    """A limb's gap at home with the file's own q, and what digits and tolerances allow, m."""

    limb: str
    gap: float
    allowed: float

    @property
    def open(self) -> bool:
        """Whether the limb does not close."""
        return abs(self.gap) > self.allowed


@dataclass(frozen=True)
class Transmission:
    """How well a limb's joint moves the platform at home, and how far a dead point is.

    At a dead point (serial singularity) the two roots of the limb's inverse kinematics meet:
    an R-R limb is stretched or folded, a strut stands square to its rail.

    Attributes:
        limb: its name; kind: that of the limb.
        value: a pure number, 0 at a dead point, 1 at best: the sine of the joint's angle from
            it, or, for a prismatic joint, the part of its motion that goes along the strut.
        margin: what the limb has left there before it no longer reaches home, m.
        allowed: by how much digits and tolerances can change that, m.
    """

    limb: str
    kind: str
    value: float
    margin: float
    allowed: float

    @property
    def dead(self) -> bool:
        """Whether the limb is at a dead point, or its tolerances can bring it there."""
        return self.value < DEAD_POINT or self.margin < self.allowed


@dataclass(frozen=True)
class Check:
    """What check found.

    ``findings`` need a look (exit code 1); ``gaps`` per limb, empty where the file gives no
    home q; ``singular_value``: the smallest at home; ``rank`` of ``columns``; ``unseen`` parameters
    to which no measured row is sensitive; ``redundant`` further ones that others explain;
    ``identifiability``: what a fit to the measurements will leave open, None without any;
    ``misreadings``: how the files are to be read instead; ``unidentifiable``: unseen and redundant
    ones as whole sets.
    """

    findings: tuple[str, ...]
    gaps: tuple[LimbGap, ...]
    singular_value: float
    q_home: Array
    rank: int
    columns: int
    unseen: tuple[str, ...]
    redundant: tuple[str, ...]
    identifiability: Identifiability | None = None
    misreadings: tuple[Misreading, ...] = ()
    unidentifiable: tuple[Unidentifiable, ...] = ()


@stage("checking")
def check(mechanism: Mechanism, datasets: Sequence[Dataset] = (),
          plausibility: Sequence[str] = ()) -> Check:
    """Return the findings on a machine and, if given, its measurements.

    Args:
        mechanism: the machine.
        datasets: measurements to see with; else a spread of poses about home, full pose.
        plausibility: findings on units, made at the border.

    Raises:
        BadInput: the home pose cannot be reached.
    """
    state = home_state(mechanism)
    gaps = home_gaps(mechanism)
    value, _ = home_singular_value(mechanism)
    findings = [*mechanism.findings, *(f for d in datasets for f in d.findings), *plausibility]
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    for g in gaps:
        if g.open:
            findings.append(f"limb '{g.limb}' does not close at home: the gap is "
                            f"{g.gap / factor:.4g} {unit}, the file's digits and tolerances "
                            f"allow {g.allowed / factor:.2g} {unit}. Check its points, lengths "
                            "and home.q.")
    findings += _dead_points(mechanism)
    if value < SINGULAR_HOME:
        findings.append(f"the machine is close to a singularity at home: smallest singular value "
                        f"{value:.2g} (a sound machine has 0.1 to 1). Choose another home pose.")
    misreadings: tuple[Misreading, ...] = ()
    if datasets and mechanism.free and value >= SINGULAR_HOME:
        problem = Problem(mechanism, tuple(datasets), mechanism.free)
        refused = refusal(problem)
        misreadings = refused.found if refused else ()
        findings = _not_told(findings, misreadings)
        for m in misreadings:
            what = misreading_sentence(m, mechanism.units)
            findings.append(f"{m.source}: {what}{'' if what.endswith('?') else '.'} "
                            f"{mend_of([m])}.")
        if refused and not misreadings:
            findings.append(f"{refused.what}. {refused.mend}.")
    listed = (*misreadings, *(m for d in datasets
                              for m in plain_mistakes(d, mechanism, misreadings)))
    rank, columns = 0, 0
    unseen: tuple[str, ...] = ()
    redundant: tuple[str, ...] = ()
    sets: tuple[Unidentifiable, ...] = ()
    used: tuple[Dataset, ...] = ()
    if mechanism.free and value >= SINGULAR_HOME:
        used = tuple(datasets) or (trial_dataset(mechanism),)
    if any(len(d) for d in used) and not misreadings:
        rank, columns, unseen, redundant, lost, sets = visibility(mechanism, used)
        # of poses about home some are beyond where a learned term is known
        if lost and (datasets or not any(e.kind.known for e in mechanism.effects)):
            findings.append(f"{counted(lost, 'row')} without a pose at the joint values: check q, "
                            "its unit and the home pose.")
    if datasets and columns:
        problem = Problem(mechanism, tuple(datasets), mechanism.free)
        findings += branch_findings(problem, problem.start())
    ahead = (
        predict_identifiability(Problem(mechanism, tuple(datasets), mechanism.free), "prior")
        if (datasets and columns)
        else None
    )
    return Check(tuple(findings), gaps, value, state.q, rank, columns, unseen, redundant, ahead,
                 listed, sets)


def _not_told(findings: Sequence[str], misreadings: Sequence[Misreading]) -> list[str]:
    """Return findings without those on a column that is told to be outside its limits."""
    told = tuple(f"{m.source}: column {c}:" for m in misreadings for x in m.mistakes
                 if x.kind == "outside-limits" for c in x.columns)
    return [f for f in findings if not f.startswith(told)]


def home_gaps(mechanism: Mechanism) -> tuple[LimbGap, ...]:
    """Return each limb's gap at home with the q that the file gives."""
    if not np.isfinite(mechanism.home_q).all():
        return ()
    model = Model(mechanism)
    everything = tuple(range(len(mechanism.parameters)))
    closure = model.closure(mechanism.home_q, everything)
    gap = closure.lengths(mechanism.home[None])[0]
    allowed = _allowed(closure)
    out, row = [], 0
    for limb in mechanism.limbs:
        rows = slice(row, row + limb.kind.surface.equations)
        row = rows.stop
        worst = int(np.argmax(np.abs(gap[rows]) - allowed[rows]))
        out.append(LimbGap(limb.name, float(gap[rows][worst]), float(allowed[rows][worst])))
    return tuple(out)


def transmissions(mechanism: Mechanism) -> tuple[Transmission, ...]:
    """Return how well each limb's joint moves the platform at home.

    Raises:
        BadInput: the home pose cannot be reached.
    """
    model, pose, state = Model(mechanism), mechanism.home[None], home_state(mechanism)
    values, roots = transmissions_at(model, pose, state.q[None])
    everything = tuple(range(len(mechanism.parameters)))
    out, row = [], 0
    for i, limb in enumerate(mechanism.limbs):
        pair, value = roots[0, i], float(values[0, i])
        half = float(pair[1] - pair[0]) / 2.0
        margin, allowed = np.inf, 0.0
        if value < GOOD_TRANSMISSION and half > 0.0:
            # the double root, on the side that this limb is nearer to
            meet = float(pair[0]) + half + (np.pi if limb.kind.actuator != "length"
                                            and np.cos(half) < 0.0 else 0.0)
            q = state.q.copy()
            q[limb.actuator] = to_joint(model, i, np.array([meet]))[0]
            closure = model.closure(q, everything)
            margin = abs(float(closure.lengths(pose)[0, row]))
            allowed = float(_allowed(closure)[row])
        out.append(Transmission(limb.name, limb.kind.name, value, margin, allowed))
        row += limb.kind.surface.equations
    return tuple(out)


def _dead_points(mechanism: Mechanism) -> list[str]:
    """Return which limbs are at a dead point at home, or so near that tolerances bring them."""
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    out = []
    for t in transmissions(mechanism):
        if not t.dead:
            continue
        near = "" if t.value < DEAD_POINT else (
            f" within its tolerances: it is {t.margin / factor:.2g} {unit} short of one, digits "
            f"and tolerances allow {t.allowed / factor:.2g} {unit}")
        out.append(f"limb '{t.limb}' ({t.kind}) is at a dead point at home{near} (serial "
                   "singularity: stretched, folded or square to its rail, where its two inverse "
                   f"solutions meet): transmission {t.value:.2g} (0 at the dead point, 1 at best). "
                   "Choose a home pose away from the limb's end of reach, or check its points and "
                   "lengths.")
    return out


def _allowed(closure: Closure) -> Array:
    """Return what last digits and tolerances can do to each closure equation at home (d,), m.

    ``closure`` must have been asked for every parameter.
    """
    mechanism, pose = closure.model.mechanism, closure.model.mechanism.home[None]
    slopes = closure.error_matrix(pose, tuple(range(len(mechanism.parameters))))[0]
    digits = np.array([_digit(mechanism, p.quantity, p.value) for p in mechanism.parameters])
    tau = np.array([p.tolerance if p.tolerance is not None and np.isfinite(p.tolerance)
                    and not p.fixed else 0.0 for p in mechanism.parameters])
    joint_digits = np.array([_digit(mechanism, q, v) for q, v in
                             zip(mechanism.actuator_quantity, mechanism.home_q, strict=True)])
    pose_digits = np.array([_digit(mechanism, "length" if c < 3 else "angle",
                                   mechanism.home_pose[c]) for c in mechanism.dof])
    return np.asarray(np.abs(slopes) @ digits + np.abs(closure.joint_matrix(pose)[0]) @ joint_digits
                      + np.abs(closure.pose_matrix(pose)[0]) @ pose_digits
                      + 3.0 * np.sqrt(slopes**2 @ tau**2) + 1e-9 * mechanism.reach)


def _digit(mechanism: Mechanism, quantity: str, value: float) -> float:
    """Half the last printed digit; a plain 0 is exact by intent (an origin, an axis)."""
    return 0.0 if value == 0.0 else float(mechanism.digits.get(quantity, 0.0))


def trial_dataset(mechanism: Mechanism) -> Dataset:
    """Return a spread of poses about home, known frame, full pose: what could be seen at all."""
    rng = np.random.default_rng(0)
    half_range = np.where(np.arange(6) < 3, 0.08 * mechanism.reach, 0.15)
    poses = np.tile(mechanism.home_pose, (TRIAL_POSES, 1))
    own = list(mechanism.dof)
    poses[:, own] += rng.uniform(-1.0, 1.0, (TRIAL_POSES, len(own))) * half_range[own]
    if len(mechanism.actuators) < mechanism.equations:
        poses = named_only(mechanism, poses)
    bare = replace(mechanism, effects=(), limits=np.tile([-np.inf, np.inf],
                                                         (len(mechanism.actuators), 1)))
    table = inverse_table(Model(bare), poses)
    q = table.q[np.array([s == "ok" for s in table.status])]
    data = Dataset.of_poses("poses about home", q, np.zeros((q.shape[0], 6)),
                            (1e-3 * mechanism.length_scale, 1e-3), fitted=False)
    columns = _trial_environment(mechanism, len(data), rng)
    if remembers(mechanism):
        # what remembers the way wants the directions of that way
        columns |= {f"dir_{a}": np.nan_to_num(way, nan=1.0) for a, way in
                    zip(mechanism.actuators, ways(q).T, strict=True)}
    return replace(data, columns=columns)


def _trial_environment(mechanism: Mechanism, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return every column that effects may depend on, all of them varied."""
    columns = {"temperature": rng.uniform(288.15, 298.15, n),
               "time": np.sort(rng.uniform(0.0, 3600.0, n)),
               "payload": rng.uniform(0.0, 20.0, n)}
    columns |= {f: rng.uniform(-50.0, 50.0, n) for f in ("fx", "fy", "fz")}
    columns |= {m: rng.uniform(-50.0, 50.0, n) * mechanism.length_scale for m in ("mx", "my", "mz")}
    for a in mechanism.actuators:
        columns[f"dir_{a}"] = rng.choice([-1.0, 1.0], n)
        columns[f"vel_{a}"] = rng.uniform(-0.1, 0.1, n)
    return columns


@stage("what the measurements see")
def visibility(mechanism: Mechanism, datasets: Sequence[Dataset]
               ) -> tuple[int, int, tuple[str, ...], tuple[str, ...], int,
                          tuple[Unidentifiable, ...]]:
    """Return rank, columns, unseen and redundant parameters, rows without a pose, and whole sets.

    Judged at the nominal values; "unseen" columns are zero, "redundant" ones are explained
    by the others (open frames and targets included).
    """
    problem = Problem(mechanism, tuple(datasets), mechanism.free)
    state: State = problem.start()
    keep = [finite_rows(p) for p in state.poses]
    lost = sum(int((~k).sum()) for k in keep)
    reduced = qr_factor(problem, state, keep)
    count = len(problem.free)
    scale, names = column_scale(problem), problem.columns
    triangle, _ = data_rows(Fit(problem, state, reduced, prior_weights(problem, "prior"), scale,
                                tuple(keep), 0, False))
    rank, kept, dropped = whole_rank(triangle, count, scale, names=names)
    norms = np.linalg.norm(triangle[:, :count] * scale[:count], axis=0)
    blind = norms <= RANK_TOLERANCE * max(float(norms.max(initial=0.0)), 1e-300)
    return (len(kept), len(names), tuple(names[c] for c in range(count) if blind[c]),
            tuple(names[c] for c in dropped if c >= count or not blind[c]), lost,
            unidentifiable(rank, names))
