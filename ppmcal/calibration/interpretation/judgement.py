"""Whether files were read as they were meant: every way to read one is scored, and judged once.

A way is a reading of its columns, a registration that the sidecar gives and that is opened, or a
mechanism file with diameters for radii. The ways that come nearest are scored as the file is that
stands; the one that changes least of those that do as well is what was meant, where it explains
more of what is wrong than it leaves. Before the fit that is asked of a file which the tolerances
do not explain; after it, of one that leaves more than noise, or that bends the geometry. What no
way explains is the file of another machine, or of none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ppmcal.calibration.fit import Problem, toleranced
from ppmcal.calibration.interpretation.candidates import pose_readings
from ppmcal.calibration.interpretation.limits import (
    ALLOWED,
    AS_GOOD,
    FAR,
    LANDS,
    LITTLE,
    TELLING,
    WORST,
)
from ppmcal.calibration.interpretation.misread import Misreading, Mistake
from ppmcal.calibration.interpretation.readings import FileReading, readable
from ppmcal.calibration.interpretation.score import (
    Look,
    Score,
    first_order_scores,
    right_parts,
    score,
)
from ppmcal.calibration.interpretation.search import SHIFTS, search_readings
from ppmcal.errors import PpmcalError
from ppmcal.model.scaled_points import other_radii

TRIED = 8
"""Readings that are scored, of those near the nominal machine, and half as many near a fit."""
NEAR_BEST = 2.5
"""Their median miss is within this factor of the least."""
REGISTERED = {
    "frame": "the measuring frame is not where the sidecar has it",
    "target": "the measured point is not where the sidecar has it",
    "target_rotation": "the measured body is turned otherwise than the sidecar says"}
"""What a sidecar may give and be wrong about, in words, by its key."""


@dataclass(frozen=True, eq=False)
class Way:
    """One way in which a file may have been meant, with the problem that it makes.

    ``parts``: how many things are otherwise than they are read; ``reading``: of the columns.
    """

    what: tuple[Mistake, ...]
    parts: float
    problem: Problem
    reading: FileReading | None = None


# --- the ways -------------------------------------------------------------------------------------

def _ways(alone: Problem, as_read: Score) -> list[Way]:
    """Return the ways that are worth a score, those that change least first."""
    data, mechanism = alone.datasets[0], alone.mechanism
    readings = dict.fromkeys([*_near_nominal(alone), *(
        _near_fit(alone) if as_read.nominal <= LANDS else ())])
    out = [Way(r.mistakes(data), r.parts, replace(alone, datasets=(r.of(data),)), r)
           for r in readings]
    if _beyond_tolerances(alone, as_read):
        out += _registrations(alone)
    for machine, ends, words in other_radii(mechanism):
        text = f"{mechanism.source}: {words.format(reason='the measurements say')}"
        out.append(Way((Mistake("radius", tuple(f"{e}.point" for e in ends), text),), 1.2,
                       replace(alone, mechanism=machine, free=machine.free)))
    return sorted(out, key=lambda w: w.parts)


def _near_nominal(alone: Problem) -> list[FileReading]:
    """Return the readings that come nearest to the nominal machine."""
    found = [f for f in search_readings(alone.mechanism, alone.datasets[0]) if f[1].parts]
    near = [f for f in found if f[0] <= NEAR_BEST * found[0][0]]
    near = sorted(near, key=lambda f: (f[1].parts, f[0]))[:TRIED]
    return [reading for _, reading in (*near, *found[:1])]


def _near_fit(alone: Problem) -> list[FileReading]:
    """Return readings of measured columns that tolerances hide from a look at the nominal machine.

    Euler angles of small turns; a row more or less on a dense path.
    """
    try:
        look = Look.at(alone)
    except PpmcalError:
        return []
    data = alone.datasets[0]
    edge = max(SHIFTS)
    rows = np.flatnonzero(np.isin(data.rows, look.problem.datasets[0].rows[look.sound[0]]))
    rows = rows[(rows >= edge) & (rows < len(data) - edge)]
    if len(rows) < 2 * edge:
        return []
    plain = FileReading.as_declared(alone.mechanism, data)
    readings = [*pose_readings(plain, data), *(replace(plain, shift=s) for s in SHIFTS)]
    scores = first_order_scores(toleranced(alone), rows, readings)
    order = sorted(range(1, len(readings)), key=lambda i: (scores[i], readings[i].parts))
    return [readings[i] for i in order[:TRIED // 2]]


def _beyond_tolerances(alone: Problem, as_read: Score) -> bool:
    """Whether no tolerance explains a file; those of what the machine's file holds count too."""
    return as_read.geometry > FAR or (as_read.nominal > LANDS and score(
        toleranced(alone, fixed=True), 0.0).total > ALLOWED)


def _registrations(alone: Problem) -> Iterator[Way]:
    """Yield the problem with what the sidecar gives of its registration open instead."""
    data = alone.datasets[0]
    turns = alone.mechanism.motion != "translational"    # else its platform never does
    given = [key for key in REGISTERED if not getattr(data, key).fitted and (
        key == "frame" or turns) and (key != "target_rotation" or data.kind == "pose")]
    for keys in dict.fromkeys([*((key,) for key in given), tuple(given)]) if given else ():
        opened = replace(data, **{k: replace(getattr(data, k), fitted=True) for k in keys})
        yield Way(tuple(Mistake(k.replace("_", "-"), (), REGISTERED[k]) for k in keys),
                  len(keys) + 0.1, replace(alone, datasets=(opened,)))


# --- the judgement --------------------------------------------------------------------------------

def find_misreading(problem: Problem, index: int) -> Misreading | None:
    """Return how one data set is to be read, None where it stands, or where nothing explains it."""
    data = problem.datasets[index]
    if not readable(data):
        return None
    alone = problem.alone(data)
    as_read = score(alone)
    # what is read wrongly is wrong in all rows, also in those that have a pose
    if as_read.total <= TELLING or (np.isinf(as_read.total) and as_read.nominal <= LANDS):
        return None
    good = _better(alone, as_read)
    if not good:
        return None
    way, best, alternatives = _chosen(good)
    # something is there beside: is it not that alone, and in some of the rows?
    if best.total > TELLING and (any(True for _ in right_parts(alone))
                                 or not _explains(score(alone, np.inf), best)):
        return None
    block, sigma = None, dict[str, float]()
    if way.reading is not None:
        block, sigma = way.reading.block(data), way.reading.sigma(data, best.left)
    told = (as_read.miss, best.miss) if as_read.nominal > LANDS else (as_read.left, best.left)
    if np.isinf(as_read.total):
        told = (np.nan, np.nan), told[1]
    return Misreading(data.source, way.what, block, *_telling(*told), best.noise, sigma,
                      alternatives)


def _better(alone: Problem, as_read: Score) -> list[tuple[Way, Score]]:
    """Return the ways that explain what is wrong; behind one that comes to the noise none is asked.

    Those would change more.
    """
    out: list[tuple[Way, Score]] = []
    enough = np.inf
    lands = min(LANDS, max(TELLING, as_read.nominal))
    for way in _ways(alone, as_read):
        if way.parts > enough:
            break
        found = score(way.problem, lands)
        fitted = np.isfinite(found.noise + found.total)
        if fitted and _explains(as_read, found) and _tells(way.problem, found):
            out.append((way, found))
            if found.total <= AS_GOOD:
                enough = min(enough, way.parts)
    return out


def _chosen(good: Sequence[tuple[Way, Score]]
            ) -> tuple[Way, Score, tuple[tuple[Mistake, ...], ...]]:
    """Return the way that changes least of those as good as the best, its score, and alternatives.

    These are of another kind and change no more. What leaves the same to round-off is the same
    file but for a turn of its frame: the first of the list stands for all.
    """
    least = min(s.total for _, s in good)
    near = [g for g in good if g[1].total <= AS_GOOD * least]
    distinct: list[tuple[Way, Score]] = []
    for way, found in near:
        if way.parts <= min(w.parts for w, _ in near) and not any(
                np.isclose(found.nominal, s.nominal, rtol=1e-6) for _, s in distinct):
            distinct.append((way, found))
    best = min(distinct, key=lambda g: g[1].total)
    kinds: dict[frozenset[str], tuple[Mistake, ...]] = {}
    for way, _ in (best, *distinct):
        kinds.setdefault(frozenset(m.kind for m in way.what), way.what)
    return *best, tuple(kinds.values())[1:]


def _explains(as_read: Score, found: Score) -> bool:
    """Whether a way explains more of what is wrong than it leaves, and enough to be sure."""
    return as_read.total >= TELLING * found.total and min(as_read.total, WORST) >= found.total**2


def _tells(alone: Problem, found: Score) -> bool:
    """Whether what is left is little beside how far the measurements go."""
    data = alone.datasets[0]
    for values, left in zip((data.position, data.rotation), found.left, strict=True):
        known = values[:, np.isfinite(values).any(axis=0)]
        if known.size and np.isfinite(left):
            away = np.linalg.norm(known - np.nanmedian(known, axis=0), axis=1)
            if left <= LITTLE * float(np.nanmedian(away)):
                return True
    return not np.isfinite(found.left).any()


def _telling(before: tuple[float, float], after: tuple[float, float]) -> tuple[str, float, float]:
    """Return the quantity whose miss falls most, of positions and rotations, before and after."""
    falls = [b / max(a, 1e-300) for b, a in zip(before, after, strict=True)]
    turned = falls[1] > 2.0 * falls[0] or not np.isfinite(after[0])
    return "angle" if turned else "length", before[turned], after[turned]
