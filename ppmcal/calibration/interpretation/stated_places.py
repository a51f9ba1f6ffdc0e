"""Points that sidecars state and the data put elsewhere: a tool, the ball of a telescoping bar.

A file of single numbers has no other reading of its columns that would show this: each point that
is stated is opened instead, and one that explains the error with a geometry within its tolerances
was not where it is said to be. Files that state the same point share its mistake.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations

import numpy as np

from ppmcal.calibration.fit import (
    Fit,
    Problem,
    State,
    against_tolerances,
    identify,
    noise_check,
)
from ppmcal.calibration.interpretation.interpretation_error import (
    HINTS,
    FileFault,
    Interpretation,
)
from ppmcal.calibration.interpretation.limits import AS_GOOD, LANDS, explains
from ppmcal.calibration.interpretation.score import Look, Score, score
from ppmcal.errors import PpmcalError
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.notes import Note

KINDS = {"target": "the measured point", "frame": "the measuring frame", "point": "the fixed point"}
"""What is stated, by its kind of mistake."""
NEAR = 0.05
"""A point that is within this part of its way to another's place is there."""
Place = tuple[int, str]
"""A data set, and which of its keys is opened."""


def stated_places(problem: Problem, as_read: Score) -> tuple[Interpretation, ...]:
    """Return the points that are not where sidecars put them; empty if that explains nothing.

    Of candidates that explain the data as well, one with the fewest points elsewhere.
    """
    good, most = list[tuple[Score, tuple[Place, ...], Problem]](), np.inf
    for parts, places in _candidates(problem):
        if parts > most:
            break
        for opened in _opened(problem, places):
            # an open target starts where it is stated, so that only a fit tells
            found = score(opened, np.inf if any(k == "target" for _, k in places) else LANDS)
            if np.isfinite(found.noise) and explains(as_read.total, found.total):
                good.append((found, places, opened))
                most = parts
                break
    if not good:
        return ()
    found, places, opened = min(good, key=lambda g: g[0].total)
    others = tuple(_faults(problem, other, where) for as_good, other, where in good
                   if as_good.total <= AS_GOOD * found.total and other != places)
    told = _faults(problem, places, opened)
    return tuple(Interpretation(problem.datasets[i].source, (fault,), noise_after=found.noise,
                                alternatives=tuple(f for f in others if n == 0))
                 for n, ((i, _), fault) in enumerate(zip(places, told, strict=True)))


def _candidates(problem: Problem) -> Iterator[tuple[int, tuple[Place, ...]]]:
    """Yield the points that may be elsewhere together, those with the fewest first."""
    stated = [(i, key) for i, data in enumerate(problem.datasets) for key in ("frame", "target")
              if _tells(problem, data, key)]
    shared = [tuple(places) for places in _alike(problem, stated) if len(places) > 1]
    yield from ((1, places) for places in (*shared, *((place,) for place in stated)))
    frames = [place for place in stated if place[1] == "frame"]
    yield from ((2, pair) for pair in combinations(frames, 2))    # as in exchanged files


def _tells(problem: Problem, data: Dataset, key: str) -> bool:
    """Whether a data set of single numbers states this point, and could tell it."""
    own: Unknown = getattr(data, key)
    if not (data.kind.scalar and data.kind.of_poses) or own.fitted or own.same_as:
        return False
    motion, between = problem.mechanism.motion, data.to_q is not None
    parts = (data.kind.frame_parts(motion, between) if key == "frame" else
             data.kind.target_parts(motion, between))
    return bool(parts) and (key == "frame" or motion.turns)


def _opened(problem: Problem, places: tuple[Place, ...]) -> Iterator[Problem]:
    """Yield the problem with places open, started as stated, then with the sign of a target's."""
    stated = [getattr(problem.datasets[i], key).value for i, key in places]
    targets = all(key == "target" for _, key in places)
    turned = [np.where(np.arange(3) == axis, -1.0, 1.0) for axis in range(3)
              if targets and all(value[axis] for value in stated)]
    for sign in (np.ones(1), *turned):
        datasets = list(problem.datasets)
        for (i, key), value in zip(places, stated, strict=True):
            own = replace(getattr(datasets[i], key), fitted=True, value=value * sign)
            datasets[i] = replace(datasets[i], **{key: own})
        yield problem.afresh(datasets=tuple(datasets))


def _faults(problem: Problem, places: tuple[Place, ...], opened: Problem) -> tuple[FileFault, ...]:
    """Return what is not where it is said to be, in words, and where it comes out."""
    state = Look.at(opened).fitted()
    return tuple(FileFault(_kind(problem, group[0]), (), _where(problem, group, state))
                 for group in _alike(problem, places) for _ in group)


def _alike(problem: Problem, places: Sequence[Place]) -> list[list[Place]]:
    """Return places in groups of those that are stated to be the same."""
    out: dict[tuple[str, bytes], list[Place]] = {}
    for i, key in places:
        value = getattr(problem.datasets[i], key).value
        out.setdefault((key, np.round(value, 9).tobytes()), []).append((i, key))
    return list(out.values())


def _kind(problem: Problem, place: Place) -> str:
    index, key = place
    return "point" if key == "frame" and problem.datasets[index].kind.along_line else key


def _where(problem: Problem, group: Sequence[Place], state: State) -> str:
    """Return where one point comes out at a fit with it open, and whose point that is, in words.

    ``group``: the data sets that state this point; of what each finds, the mean.
    """
    (index, key), kind = group[0], _kind(problem, group[0])
    data, ends = problem.datasets[index], [state.registrations[i] for i, _ in group]
    text = f"{KINDS[kind]} is not where the sidecar puts it"
    if kind == "frame":
        return text
    was = _point(data, key, getattr(data, key).value)
    now = np.mean([_point(data, key, at.target if key == "target" else at.frame_pose)
                   for at in ends], axis=0)
    text += f": it comes out at {_words(now, data)}, not at {_words(was, data)}"
    for other in problem.datasets if kind == "point" and len(group) == 1 else ():
        there = _point(other, key, other.frame.value)
        if other is not data and other.kind is data.kind and not other.frame.fitted and (
                np.linalg.norm(now - there) < NEAR * np.linalg.norm(was - there)):
            return f"{text}, which is where the point of {other.source} is: exchanged files?"
    return text


def _point(data: Dataset, key: str, value: Array) -> Array:
    """Return a target, or the point that distances are from, base axes (3,)."""
    return -value[:3] if key == "frame" and data.kind.along_line else value[:3]


def _words(point: Array, data: Dataset) -> str:
    factor, unit = data.units.factor("length"), data.units.length
    return f"({', '.join(f'{v:.4g}' for v in point / factor + 0.0)}) {unit}"


def place_hints(fit: Fit) -> list[Note]:
    """Return which stated point explains a geometry beyond its tolerances; empty if none does."""
    if not against_tolerances(noise_check(fit), fit).tight:
        return []
    problem, good = fit.problem, list[tuple[float, tuple[Place, ...], Fit]]()
    for parts, places in _candidates(problem):
        with suppress(PpmcalError):
            other = identify(next(_opened(problem, places))) if parts == 1 else None
            if other is not None and other.converged:
                noise = against_tolerances(noise_check(other), other)
                if not (noise.tight or noise.failed):
                    good.append((noise.prior_chi2, places, other))
    if not good:
        return []
    _, places, other = min(good, key=lambda g: g[0])
    what = _where(problem, places, other.state)
    names = ", ".join(problem.datasets[i].source for i, _ in places)
    return [Note(f"perhaps {what} ({names}): with that open the geometry is within its tolerances. "
                 f"{HINTS[_kind(problem, places[0])]}", topic="registration")]
