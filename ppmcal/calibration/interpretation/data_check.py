"""Does this file describe the intended machine? Findings before anything is measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ppmcal.calibration.fit import (
    RANK_TOLERANCE,
    Fit,
    Problem,
    Unidentifiable,
    branch_findings,
    data_rows,
    unfitted,
    unidentifiable,
    whole_rank,
)
from ppmcal.calibration.interpretation.interpretation_error import (
    Interpretation,
    by_sentence,
    hint_of,
    sources_of,
)
from ppmcal.calibration.interpretation.obvious_mistakes import plain_mistakes
from ppmcal.calibration.interpretation.read_rightly import refusal
from ppmcal.calibration.interpretation.ropes_at_home import slack_at_home
from ppmcal.calibration.interpretation.stated_places import place_hints
from ppmcal.calibration.knowledge import Identifiability, identifiability, tilt_sentences
from ppmcal.calibration.validation import before, beyond_tolerances
from ppmcal.kinematics.closed_at_home import (
    DEAD_POINT,
    LimbGap,
    condition_gaps,
    home_gaps,
    transmissions,
)
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.needed_columns import remembers
from ppmcal.kinematics.partial_pose import named_only
from ppmcal.kinematics.singular_structure import singular_structure
from ppmcal.kinematics.tables import SINGULAR_HOME, home_singular_value, inverse_table
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.history import ways
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note, about, of_column
from ppmcal.wording import pluralize
from ppmcal.wording.progress import stage

TRIAL_POSES = 80


@dataclass(frozen=True)
class Check:
    """Result of check.

    ``findings`` need attention (exit code 1); ``gaps`` per limb, empty if the file has no
    home q; ``singular_value``: the smallest at home; ``rank`` of ``columns``; ``unseen`` parameters
    to which no measured row is sensitive; ``redundant`` further ones that others explain;
    ``identifiability``: what a fit to the measurements would leave open, None without any;
    ``misreadings``: how the files should be read instead; ``unidentifiable``: unseen and redundant
    parameters as whole sets; ``misses``: errors of the nominal machine, SI, as identify has them
    before the fit.
    """

    findings: tuple[Note, ...]
    gaps: tuple[LimbGap, ...]
    singular_value: float
    q_home: Array
    rank: int = 0
    columns: int = 0
    unseen: tuple[str, ...] = ()
    redundant: tuple[str, ...] = ()
    identifiability: Identifiability | None = None
    misreadings: tuple[Interpretation, ...] = ()
    unidentifiable: tuple[Unidentifiable, ...] = ()
    misses: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


@stage("checking")
def check(mechanism: Mechanism, datasets: Sequence[Dataset] = (),
          plausibility: Sequence[Note] = ()) -> Check:
    """Return the findings on a machine and, if given, its measurements.

    Args:
        mechanism: the machine.
        datasets: measurements to judge by; else a spread of full poses about home.
        plausibility: findings on units, made when the files were read.

    Raises:
        BadInput: the home pose cannot be reached.
    """
    q_home, gaps = home_state(mechanism).q, home_gaps(mechanism)
    value, _ = home_singular_value(mechanism)
    findings = [*mechanism.findings, *(f for d in datasets for f in d.findings), *plausibility,
                *_open_limbs(mechanism, gaps or condition_gaps(mechanism)),
                *_dead_points(mechanism), *slack_at_home(mechanism)]
    if value < SINGULAR_HOME:
        cause = singular_structure(mechanism)
        findings.append(Note("the machine is close to a singularity at home: smallest singular "
                             f"value {value:.2g} (a sound machine has 0.1 to "
                             f"1){': ' * bool(cause)}{cause}. Choose another home "
                             f"pose{', or correct the points' * bool(cause)}.", topic="home"))
    judged = bool(mechanism.free) and value >= SINGULAR_HOME
    misreadings: tuple[Interpretation, ...] = ()
    if datasets and judged:
        refused, fit = refusal(Problem(mechanism, tuple(datasets), mechanism.free))
        misreadings = refused.found if refused else ()
        findings = [*_not_told(findings, misreadings), *_told(misreadings, mechanism)]
        if refused and not misreadings:
            said = " ".join(f"{part}." for part in (refused.what, refused.hint) if part)
            findings.append(Note(said, topic="interpretation"))
        elif fit is not None:
            findings += [*beyond_tolerances(fit), *place_hints(fit)]
    out = Check((), gaps, value, q_home, misreadings=(*misreadings, *(
        m for d in datasets for m in plain_mistakes(d, mechanism, misreadings))))
    used = tuple(datasets) or ((trial_dataset(mechanism),) if judged else ())
    if judged and any(len(d) for d in used) and not misreadings:
        start = unfitted(Problem(mechanism, used, mechanism.free))
        out = replace(out, **visibility(start))
        lost = sum(int((~k).sum()) for k in start.keep)
        # some poses about home may be outside the range of a learned term
        if lost and (datasets or not any(e.kind.known for e in mechanism.effects)):
            findings.append(
                Note(f"{pluralize(lost, 'row')} without a pose at the joint values: check q, its "
                     "unit and the home pose.", topic="poses"))
        if datasets and out.columns:
            findings += branch_findings(start.problem, start.state)
            out = replace(out, identifiability=identifiability(start), misses=before(
                start.problem, start.keep).residuals.figures(start.keep))
            findings += tilt_sentences(start, fitted=False)
    return replace(out, findings=tuple(findings))


def _open_limbs(mechanism: Mechanism, gaps: Sequence[LimbGap]) -> Iterator[Note]:
    """Yield the limbs that do not close at home."""
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    home = "home.q" if np.isfinite(mechanism.home_q).all() else "the home pose"
    for g in gaps:
        if g.open:
            yield Note(f"limb '{g.limb}' does not close at home: the gap is {g.gap / factor:.4g} "
                       f"{unit}, the file's digits and tolerances allow {g.allowed / factor:.2g} "
                       f"{unit}. Check its points, lengths and {home}.", topic="home")


def _told(misreadings: Sequence[Interpretation], mechanism: Mechanism) -> Iterator[Note]:
    """Yield what is read wrongly, and how to read it."""
    for what, own in by_sentence(misreadings, mechanism.units).items():
        yield Note(f"{', '.join(sources_of(own))}: {what}{'' if what.endswith('?') else '.'} "
                   f"{hint_of(own)}.", topic="interpretation")


def _not_told(findings: Sequence[Note], misreadings: Sequence[Interpretation]) -> list[Note]:
    """Return findings without those on a column already reported as outside its limits."""
    told = about(findings, [of_column(m.source, c) for m in misreadings for x in m.mistakes
                            if x.kind == "outside-limits" for c in x.columns])
    return [f for f in findings if f not in told]


def _dead_points(mechanism: Mechanism) -> Iterator[Note]:
    """Yield the limbs that are at a dead point at home, or within tolerances of one."""
    factor, unit = mechanism.units.factor("length"), mechanism.units.length
    for t in transmissions(mechanism):
        if t.dead:
            near = "" if t.value < DEAD_POINT else (
                f" within its tolerances: it is {t.margin / factor:.2g} {unit} short of one, "
                f"digits and tolerances allow {t.allowed / factor:.2g} {unit}")
            yield Note(f"limb '{t.limb}' ({t.kind}) is at a dead point at home{near} (serial "
                       "singularity: stretched, folded or square to its rail, where its two "
                       f"inverse solutions meet): transmission {t.value:.2g} (0 at the dead point, "
                       "1 at best). Choose a home pose away from the limb's end of reach, or check "
                       "its points and lengths.", topic="home")


def trial_dataset(mechanism: Mechanism) -> Dataset:
    """Return a spread of full poses about home in a known frame: all that could be observed."""
    rng = np.random.default_rng(0)
    half_range = np.where(np.arange(6) < 3, 0.08 * mechanism.reach, 0.15)
    poses = np.tile(mechanism.home_pose, (TRIAL_POSES, 1))
    own = list(mechanism.dof)
    poses[:, own] += rng.uniform(-1.0, 1.0, (TRIAL_POSES, len(own))) * half_range[own]
    if mechanism.dependent:
        poses = named_only(mechanism, poses)
    bare = replace(mechanism, effects=(), limits=np.tile([-np.inf, np.inf],
                                                         (len(mechanism.actuators), 1)))
    table = inverse_table(Model(bare), poses)
    good = np.array([s == "ok" for s in table.status])
    q = table.q[good]
    # if surplus limbs contradict each other, the measurements locate the platform
    data = Dataset.of_poses("poses about home", q, poses[good],
                            (1e-3 * mechanism.length_scale, 1e-3), fitted=False)
    columns = _trial_environment(mechanism, len(data), rng)
    if remembers(mechanism):
        # effects that depend on the way need the directions of this way
        columns |= {f"dir_{a}": np.nan_to_num(way, nan=1.0) for a, way in
                    zip(mechanism.actuators, ways(q).T, strict=True)}
    return replace(data, columns=columns)


def _trial_environment(mechanism: Mechanism, n: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return every column that effects may depend on, each of them varied."""
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
def visibility(start: Fit) -> dict[str, Any]:
    """Return the fields of :class:`Check` that predict what a fit from this start will see."""
    count, scale, names = len(start.problem.free), start.scale, start.problem.columns
    triangle, _ = data_rows(start)
    rank, kept, dropped = whole_rank(triangle, count, scale, names=names)
    norms = np.linalg.norm(triangle[:, :count] * scale[:count], axis=0)
    blind = norms <= RANK_TOLERANCE * max(float(norms.max(initial=0.0)), 1e-300)
    return {"rank": len(kept), "columns": len(names),
            "unseen": tuple(names[c] for c in range(count) if blind[c]),
            "redundant": tuple(names[c] for c in dropped if c >= count or not blind[c]),
            "unidentifiable": unidentifiable(rank, names)}
