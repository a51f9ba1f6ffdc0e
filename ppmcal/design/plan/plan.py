"""The whole plan: candidates, choice, predicted accuracy, and a path through the poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.fit import Problem, analyse, observability, secondary, with_gauge
from ppmcal.calibration.knowledge import Scale, predict_identifiability
from ppmcal.design.plan import information as accuracy
from ppmcal.design.plan.candidate_poses import Candidates, Region, draw, evenly, listed, region_of
from ppmcal.design.plan.d_optimal import Design, Rules, exchange, greedy, log_det, pruned
from ppmcal.design.plan.information import CandidateInformation, Curve, offer, task_rows
from ppmcal.design.plan.path import route
from ppmcal.design.plan.refine import refined
from ppmcal.design.plan.result import Plan
from ppmcal.design.plan.settings import PlanSettings, offered, refuse, with_kinds
from ppmcal.design.virtual_instrument import Instrument
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.tables import SINGULAR_HOME, home_singular_value
from ppmcal.linalg import Array, Ints
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording.progress import start_stage

CANDIDATES = 400
TASKS = 50
RANDOM = 20
STARTS = 3
"""Designs that the exchange starts from: the greedy one, and random ones."""
MOST = 150
"""Without --count, more measurements than this are not considered."""
MOST_REFINED = 120
"""Larger plans keep the poses as they were drawn: among so many, little is left to gain."""
SPARE = 2


@dataclass(frozen=True, eq=False)
class PlanOptions:
    """How to plan: ``count`` of measurements or None, ``seed``, what else to show."""

    count: int | None = None
    seed: int = 0
    asked: PlanSettings = field(default_factory=PlanSettings)
    candidates: int = CANDIDATES


def plan(mechanism: Mechanism, instrument: Instrument, options: PlanOptions | None = None,
         given: tuple[Array, str] | None = None, tasks: tuple[Array, str] | None = None,
         wanted: float | None = None) -> Plan:
    """Return which poses to measure.

    Args:
        mechanism: as in its file; the plan is made for its nominal values, with its tolerances.
        instrument: what measures.
        options: how.
        given: the user's candidates (N, 6) and their file; default: drawn in the region.
        tasks: poses (N, 6) at which the machine has to be exact, and their file.
        wanted: standard deviation of the position there, m.

    Raises:
        BadInput: nothing to identify, no usable pose, a kind that cannot be planned for.
        NoResult: no pose can be measured, or too few to determine what has no tolerance.
    """
    options = options or PlanOptions()
    nominal = mechanism.nominal()
    if home_singular_value(nominal)[0] < SINGULAR_HOME:
        raise NoResult("the machine is close to a singularity at home, against which the distance "
                       "from singularities is measured", f"{mechanism.source}: home",
                       "Choose another home pose")
    if not mechanism.free:
        raise BadInput("no parameter is free: there is nothing to measure for", mechanism.source,
                       "Give tolerances, or name what may change under `free`")
    if instrument.kind.touches and given is None:
        raise BadInput("touches happen where the flat is, which only you know", "--instrument",
                       "Give --candidates: poses at which the machine touches the flat")
    refuse(mechanism, options.asked)
    start_stage("drawing candidates")
    # who has no instrument goes where ropes are tight
    inside = instrument.kind.inside
    region = None if given else region_of(nominal, inside)
    pool = listed(nominal, *given) if given else draw(nominal, region_of(nominal, inside),
                                                      options.candidates, options.seed)
    if inside:
        # held as `identify` holds it: the frame so defined is that of all figures
        mechanism = with_gauge(mechanism, [instrument.dataset(pool.q, pool.pose, {}, nominal)])
    with_effects = with_kinds(mechanism, options.asked, pool.q)
    pose, columns = offered(with_effects, options.asked, pool.q, pool.pose, options.seed)
    start_stage("information of each candidate")
    space = _PoseSpace(nominal, region if not columns else None, instrument, pool,
                       offer(with_effects, instrument, pool, pose, columns), columns)
    aims = _aims(space, options, tasks)
    start_stage("choosing")
    return _planned(space, options, aims, wanted)


@dataclass(frozen=True, eq=False)
class _PoseSpace:
    """What can be chosen from; ``region`` None where poses are not to be moved."""

    nominal: Mechanism
    region: Region | None
    instrument: Instrument
    pool: Candidates
    whole: CandidateInformation
    columns: Mapping[str, Array]


@dataclass(frozen=True, eq=False)
class _Aims:
    """Where the machine has to be exact: mean J^T J of position and rotation, how many tasks."""

    moments: tuple[Array, Array]
    count: int
    left_out: Mapping[str, int]


def _aims(space: _PoseSpace, options: PlanOptions, tasks: tuple[Array, str] | None) -> _Aims:
    at = listed(space.nominal, *tasks) if tasks else evenly(
        space.nominal, region_of(space.nominal, space.instrument.kind.inside), TASKS,
        options.seed + 1)
    pose, columns = offered(space.whole.problem.mechanism, options.asked, at.q, at.pose,
                            options.seed + 1)
    return _Aims(task_rows(space.whole, space.instrument, at.take(pose), columns), len(at),
                 at.left_out if tasks else {})


def _planned(space: _PoseSpace, options: PlanOptions, aims: _Aims, wanted: float | None) -> Plan:
    rng = np.random.default_rng([options.seed, 3])
    tasks = aims.moments
    # with settings a pose may be measured under several of them
    rules = Rules(bool(space.columns), None)
    count, least, pays = _size(space, options, rules, tasks)
    space, chosen = _chosen(space, count, rules, tasks[0], rng)
    whole, pool = space.whole, space.pool
    order = pruned(whole, greedy(whole, 2 * count, rules))
    nested = accuracy.curve(whole, order, tasks)
    wide = np.flatnonzero(pool.even[whole.pose])
    strangers = [_drawn(whole, wide, len(order), rng) for _ in range(RANDOM)]
    way = route(space.nominal, pool.q[whole.pose[list(chosen)]], np.ptp(pool.q, axis=0),
                _blocks(space.columns, chosen))
    rows = np.array(chosen, dtype=np.int64)[way.order]
    reached, about = _reached(whole, chosen, nested, tasks, wanted)
    notes = list[Note]()
    seen, better = secondary("the comparison with random poses", lambda: _against(
        whole, chosen, [r[:count] for r in strangers]), ({}, np.nan), notes)
    return Plan(
        whole.problem.mechanism, space.instrument, pool, _open_ended(space.nominal), whole, rows,
        {n: c[rows] for n, c in space.columns.items()},
        Design.of(whole, rows.tolist()).losses(), way, chosen, nested,
        _mean([accuracy.curve(whole, r, tasks) for r in strangers]),
        _best(whole, order, chosen, rules, rng, tasks, least, notes), least, pays,
        accuracy.limit(whole, tasks), reached, about, seen, better, aims.count, aims.left_out,
        space.region is not None and count <= MOST_REFINED, _unused(space, options.asked),
        tuple(notes), _scale(space, rows) if space.instrument.kind.inside else None)


def _scale(space: _PoseSpace, rows: Ints) -> Scale | None:
    """Return how well joint values of the plan show the machine's size."""
    mechanism, pose = space.whole.problem.mechanism, space.whole.pose[rows]
    data = space.instrument.dataset(space.pool.q[pose], space.pool.pose[pose],
                                    {n: c[rows] for n, c in space.columns.items()}, mechanism)
    return predict_identifiability(Problem(mechanism, (data,), mechanism.free), "prior").scale


def _size(space: _PoseSpace, options: PlanOptions, rules: Rules, tasks: tuple[Array, Array]
          ) -> tuple[int, int, int]:
    """Return how many rows to choose, the fewest that do, and from where on more hardly pay."""
    longest = 2 * options.count if options.count else MOST
    longest_plan = greedy(space.whole, longest, rules)
    nested = accuracy.curve(space.whole, pruned(space.whole, longest_plan), tasks)
    least = _least(nested, space.nominal)
    pays = accuracy.still_pays(nested.position)
    count = options.count or _count(space.whole, least, pays)
    if count < least:
        raise BadInput(f"{count} measurements cannot determine what has no tolerance: it takes "
                       f"at least {least}", "--count", "Ask for more, or give tolerances")
    return count, least, pays


def _against(whole: CandidateInformation, chosen: Sequence[int], strangers: Sequence[Sequence[int]]
             ) -> tuple[dict[str, dict[str, float]], float]:
    """Return observability of the plan and of random designs, and the ratio of information."""
    wanted = max(1, int((~whole.nuisance).sum()))
    better = log_det(whole, chosen) - float(np.mean([log_det(whole, r) for r in strangers]))
    return ({"planned": _observed(whole, [chosen]), "random": _observed(whole, strangers)},
            float(np.exp(better / wanted)))


def _chosen(space: _PoseSpace, count: int, rules: Rules, aim: Array, rng: np.random.Generator
            ) -> tuple[_PoseSpace, tuple[int, ...]]:
    """Return the choice, from a space that has its refined poses too."""
    chosen = _exchanged(space.whole, greedy(space.whole, count, rules),
                        rules.sized(space.whole, count), rng)
    if space.region is None or count > MOST_REFINED:
        return space, chosen
    pool, whole, columns, chosen = refined(space.nominal, space.region, space.instrument,
                                           space.whole, space.pool, space.columns, chosen, aim, rng)
    return replace(space, pool=pool, whole=whole, columns=columns), chosen


def _least(nested: Curve, nominal: Mechanism) -> int:
    """Return the fewest rows that determine everything."""
    enough = np.flatnonzero(np.isfinite(nested.position))
    if not enough.size:
        raise NoResult("even all measurements considered do not determine what has no tolerance",
                       nominal.source, "Ask for more with --count, or give tolerances")
    return int(enough[0]) + 1


def _count(whole: CandidateInformation, least: int, pays: int) -> int:
    """Return how many measurements to take where nobody says."""
    wanted = int((~whole.nuisance).sum())
    numbers = whole.jacobian.shape[1]
    return max(least, int(-(-wanted // numbers)) + SPARE, pays or MOST // 2)


def _exchanged(
    whole: CandidateInformation, start: Sequence[int], rules: Rules, rng: np.random.Generator
) -> tuple[int, ...]:
    """Return the best of exchanges from the greedy design and from random ones."""
    starts = [tuple(start)]
    everything = np.arange(len(whole))
    starts += [tuple(_drawn(whole, everything, len(start), rng)) for _ in range(STARTS - 1)]
    ends = [exchange(whole, s, rules, rng) for s in starts]
    return max(ends, key=lambda rows: log_det(whole, rows))


def _drawn(
    whole: CandidateInformation, among: Ints, count: int, rng: np.random.Generator
) -> list[int]:
    """Return random rows, of different poses as long as there are enough."""
    mixed = rng.permutation(among)
    first = np.sort(np.unique(whole.pose[mixed], return_index=True)[1])
    again = np.setdiff1d(np.arange(mixed.size), first)
    order = np.concatenate([mixed[first], mixed[again]])
    return [int(row) for row in (np.resize(order, count) if count > order.size
                                 else order[:count])]


def _best(whole: CandidateInformation, order: Sequence[int], chosen: Sequence[int], rules: Rules,
          rng: np.random.Generator, tasks: tuple[Array, Array], least: int, notes: list[Note]
          ) -> tuple[tuple[int, float, float], ...]:
    """Return accuracy of exchanged designs: the plan's size, half and twice of it.

    Designs of the other sizes are for comparison: one that fails is left out, and noted.
    """
    count = len(chosen)
    sizes = sorted({max(least, count // 2), count, min(2 * count, len(order))})
    out = []
    for size in sizes:
        rows = chosen if size == count else secondary(
            f"a plan of {size} measurements", partial(exchange, whole, order[:size],
                                                      rules.sized(whole, size), rng, 2), (), notes)
        if not rows:
            continue
        position, rotation = accuracy.spreads(
            whole.information(np.array(rows, dtype=np.int64))[None], tasks)
        out.append((size, float(position[0]), float(rotation[0])))
    return tuple(out)


def _blocks(columns: Mapping[str, Array], chosen: Sequence[int]) -> Ints:
    """Return a label per row (n,): temperatures one after the other, payloads to and fro."""
    rows = list(chosen)
    label = np.zeros(len(rows), dtype=np.int64)
    for name in ("temperature", "payload"):
        if name in columns:
            rank = np.unique(columns[name][rows], return_inverse=True)[1]
            size = int(rank.max()) + 1
            label = label * size + np.where(label % 2 == 1, size - 1 - rank, rank)
    return label


def _reached(
    whole: CandidateInformation,
    chosen: Sequence[int],
    nested: Curve,
    tasks: tuple[Array, Array],
    wanted: float | None,
) -> tuple[int | None, bool]:
    if wanted is None:
        return None, False
    found = accuracy.reaching(nested.position, wanted)
    if found is not None:
        return found, False
    if accuracy.limit(whole, tasks)[0] >= wanted:
        return None, False
    return accuracy.extrapolated(whole, chosen, tasks, wanted), True


def _mean(curves: Sequence[Curve]) -> Curve:
    return Curve(np.mean([c.position for c in curves], axis=0),
                 np.mean([c.rotation for c in curves], axis=0))


def _observed(whole: CandidateInformation, designs: Sequence[Sequence[int]]) -> dict[str, float]:
    """Return the observability indices of the data alone, mean over designs."""
    geometry = int((~whole.nuisance).sum())
    found = []
    for rows in designs:
        stacked = whole.jacobian[list(rows)].reshape(-1, whole.prior.size)
        triangle = linalg.triangle(stacked)
        rank = analyse(triangle, geometry, np.ones(geometry))
        found.append(observability(rank.singular, len(rank.kept), len(rows)))
    return {name: float(np.mean([f[name] for f in found])) for name in found[0]}


def _unused(space: _PoseSpace, asked: PlanSettings) -> tuple[str, ...]:
    return tuple(n for n, ends in (("payload", asked.payload), ("temperature", asked.temperature),
                                   ("tension", asked.tension))
                 if ends is not None and not any(c.partition("_")[0] == n for c in space.columns))


def _open_ended(nominal: Mechanism) -> tuple[str, ...]:
    """Return the actuators that no limits bound."""
    return tuple(a for a, ends in zip(nominal.actuators, nominal.limits, strict=True)
                 if not np.isfinite(ends).all())
