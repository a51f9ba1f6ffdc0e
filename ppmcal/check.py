"""Is this file the machine that I think it is? Findings before anything is measured.

"Closed" means closed within what the file can know: the last printed digit of every number,
and three standard deviations of the tolerances, carried to each limb's condition.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ppmcal.arrays import known
from ppmcal.closure import Model
from ppmcal.compensate import named_only
from ppmcal.dataset import Dataset
from ppmcal.inverse import home_state
from ppmcal.kinematics import home_conditioning, inverse_table
from ppmcal.linear import column_scale, reduce_rows
from ppmcal.mechanism import Mechanism
from ppmcal.problem import Problem, State
from ppmcal.rank import RANK_TOLERANCE, analyse
from ppmcal.untold import Untold, foreseen

Array = NDArray[np.float64]

SINGULAR_HOME = 0.02
"""A finding: smallest singular value of A at home below this."""
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
class Check:
    """What check found.

    ``findings`` need a look (exit code 1); ``gaps`` per limb, empty where the file gives no
    home q; ``condition`` at home; ``rank`` of ``columns``; ``unseen`` parameters that no
    measured row feels; ``redundant`` further ones that others explain; ``untold``: what a fit to
    the measurements will leave open, None without any.
    """

    findings: tuple[str, ...]
    gaps: tuple[LimbGap, ...]
    condition: float
    q_home: Array
    rank: int
    columns: int
    unseen: tuple[str, ...]
    redundant: tuple[str, ...]
    untold: Untold | None = None


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
    value, _ = home_conditioning(mechanism)
    findings = [*mechanism.findings, *(f for d in datasets for f in d.findings), *plausibility]
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    for g in gaps:
        if g.open:
            findings.append(f"limb '{g.limb}' does not close at home: the gap is "
                            f"{g.gap / factor:.4g} {unit}, the file's digits and tolerances "
                            f"allow {g.allowed / factor:.2g} {unit}. Check its points, lengths "
                            "and home.q.")
    if value < SINGULAR_HOME:
        findings.append(f"the machine is close to a singularity at home: smallest singular value "
                        f"{value:.2g} (a sound machine has 0.1 to 1). Choose another home pose.")
    rank, columns = 0, 0
    unseen: tuple[str, ...] = ()
    redundant: tuple[str, ...] = ()
    if mechanism.free and value >= SINGULAR_HOME:
        used = tuple(datasets) or (trial_dataset(mechanism),)
        rank, columns, unseen, redundant, lost = visibility(mechanism, used)
        if lost:
            findings.append(f"{lost} rows have no pose at their joint values: check q, its unit "
                            "and the home pose.")
    ahead = foreseen(Problem(mechanism, tuple(datasets), mechanism.free), "prior") if (
        datasets and columns) else None
    return Check(tuple(findings), gaps, value, state.q, rank, columns, unseen, redundant, ahead)


def home_gaps(mechanism: Mechanism) -> tuple[LimbGap, ...]:
    """Return each limb's gap at home with the q that the file gives."""
    if not np.isfinite(mechanism.home_q).all():
        return ()
    model = Model(mechanism)
    everything = tuple(range(len(mechanism.parameters)))
    closure = model.closure(mechanism.home_q, everything)
    pose = mechanism.home[None]
    gap = closure.lengths(pose)[0]
    slopes = closure.error_matrix(pose, everything)[0]
    by_joint = closure.joint_matrix(pose)[0]
    by_pose = closure.pose_matrix(pose)[0]
    digits = np.array([_digit(mechanism, p.quantity, p.value) for p in mechanism.parameters])
    tau = np.array([p.tolerance if p.tolerance is not None and np.isfinite(p.tolerance)
                    and not p.fixed else 0.0 for p in mechanism.parameters])
    joint_digits = np.array([_digit(mechanism, q, v) for q, v in
                             zip(mechanism.actuator_quantity, mechanism.home_q, strict=True)])
    pose_digits = np.array([_digit(mechanism, "length" if c < 3 else "angle",
                                   mechanism.home_pose[c]) for c in mechanism.dof])
    allowed = (np.abs(slopes) @ digits + np.abs(by_joint) @ joint_digits
               + np.abs(by_pose) @ pose_digits
               + 3.0 * np.sqrt(slopes**2 @ tau**2) + 1e-9 * mechanism.reach)
    out, row = [], 0
    for limb in mechanism.limbs:
        rows = slice(row, row + limb.kind.surface.conditions)
        row = rows.stop
        worst = int(np.argmax(np.abs(gap[rows]) - allowed[rows]))
        out.append(LimbGap(limb.name, float(gap[rows][worst]), float(allowed[rows][worst])))
    return tuple(out)


def _digit(mechanism: Mechanism, quantity: str, value: float) -> float:
    """Half the last printed digit; a plain 0 is exact by intent (an origin, an axis)."""
    return 0.0 if value == 0.0 else float(mechanism.digits.get(quantity, 0.0))


def trial_dataset(mechanism: Mechanism) -> Dataset:
    """Return a spread of poses about home, known frame, full pose: what could be seen at all."""
    rng = np.random.default_rng(0)
    spread = np.where(np.arange(6) < 3, 0.08 * mechanism.reach, 0.15)
    poses = np.tile(mechanism.home_pose, (TRIAL_POSES, 1))
    own = list(mechanism.dof)
    poses[:, own] += rng.uniform(-1.0, 1.0, (TRIAL_POSES, len(own))) * spread[own]
    if len(mechanism.actuators) < mechanism.conditions:
        poses = named_only(mechanism, poses)
    table = inverse_table(Model(replace(mechanism, effects=())), poses)
    q = table.q[np.array([s == "ok" for s in table.status])]
    data = Dataset.of_poses("poses about home", q, np.zeros((q.shape[0], 6)),
                            (1e-3 * mechanism.length_scale, 1e-3), fitted=False)
    return replace(data, columns=_trial_conditions(mechanism, len(data), rng))


def _trial_conditions(mechanism: Mechanism, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return every column that effects may depend on, all of them varied."""
    columns = {"temperature": rng.uniform(288.15, 298.15, n), "time": rng.uniform(0.0, 3600.0, n),
               "payload": rng.uniform(0.0, 20.0, n)}
    columns |= {f: rng.uniform(-50.0, 50.0, n) for f in ("fx", "fy", "fz")}
    columns |= {m: rng.uniform(-50.0, 50.0, n) * mechanism.length_scale for m in ("mx", "my", "mz")}
    for a in mechanism.actuators:
        columns[f"dir_{a}"] = rng.choice([-1.0, 1.0], n)
        columns[f"vel_{a}"] = rng.uniform(-0.1, 0.1, n)
    return columns


def visibility(mechanism: Mechanism, datasets: Sequence[Dataset]
               ) -> tuple[int, int, tuple[str, ...], tuple[str, ...], int]:
    """Return rank, columns, unseen and redundant parameters, and rows without a pose.

    Judged at the nominal values; "unseen" columns are zero, "redundant" ones are explained
    by the others (open frames and targets included).
    """
    problem = Problem(mechanism, tuple(datasets), mechanism.free)
    state: State = problem.start()
    keep = [known(p) for p in state.poses]
    lost = sum(int((~k).sum()) for k in keep)
    reduced = reduce_rows(problem, state, keep)
    count = len(problem.free)
    scale = column_scale(problem)
    found = analyse(reduced.triangle, count, scale[:count])
    norms = np.linalg.norm(reduced.triangle[:, :count] * scale[:count], axis=0)
    blind = norms <= RANK_TOLERANCE * max(float(norms.max(initial=0.0)), 1e-300)
    names = problem.columns
    nuisance = reduced.triangle[:, count:]
    more = len(analyse(nuisance, nuisance.shape[1], scale[count:]).kept) if nuisance.size else 0
    return (len(found.kept) + more, len(names),
            tuple(names[c] for c in range(count) if blind[c]),
            tuple(names[c] for c in found.dropped if not blind[c]), lost)
