"""Which reading is right: the likeliest ones, each with a short fit of few rows.

A reading is accepted where the gap falls by a large factor and lands where tolerances and noise
explain it. Of readings that do as well, the one that changes least is it: a symmetric machine in
an unknown frame may be renumbered in several ways that cannot be told apart, nor need be.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace

import numpy as np

from ppmcal.calibration.fit import Problem, toleranced
from ppmcal.calibration.interpretation.mistakes import Mistake, mistakes, other_sigma, read_block
from ppmcal.calibration.interpretation.reading_search import Scored, search_readings
from ppmcal.errors import PpmcalError
from ppmcal.kinematics.pose_readings import FileReading
from ppmcal.model.instruments import SCALARS
from ppmcal.model.scaled_points import other_radii

AMONG_BEST = 2.5
"""Readings whose median miss is within this of the least are fitted,"""
TRIED = 8
"""at most so many of them, those that change least first."""
AS_GOOD = 1.5
"""Readings that leave within this of the least are as good as it."""
NOISE = "times the noise"
"""In the place of a quantity: residuals over the noise, no length or angle."""
FALLS = 4.0
"""A reading has to lower the gap by this factor."""
LANDS = 5.0
"""And to leave no more than so many times what noise and tolerances explain,"""
WITHIN = 2.0
"""A machine off by its tolerances leaves no more than so many times what they and noise explain."""
LEFT = 0.05
"""and no more than this part of how far the measurements go."""


@dataclass(frozen=True)
class Trial:
    """What a reading leaves: see :class:`ppmcal.calibration.interpretation.misreading.Misfit`.

    ``left``: median misses of positions and rotations after the short fit.
    """

    times: float
    position: float
    rotation: float
    after: float
    left: tuple[float, float] = (np.nan, np.nan)


@dataclass(frozen=True)
class Misreading:
    """A file that was read wrongly, and how it is to be read.

    Attributes:
        source: the CSV.
        mistakes: what is wrong in it; ``block``: the sidecar's ``read`` that mends it, None
            where only the user can.
        before, after: median miss, m or rad (``quantity``), with the nominal machine.
        noise_after: what a short fit leaves, times the noise.
        sigma: entries of the sidecar's ``instrument.sigma`` that are in the columns' unit too.
    """

    source: str
    mistakes: tuple[Mistake, ...]
    block: dict[str, object] | None
    quantity: str
    before: float
    after: float
    noise_after: float
    sigma: Mapping[str, float] = field(default_factory=dict)


Judge = Callable[[Problem, float], Trial]


def find_misreading(problem: Problem, index: int, as_read: Trial, judge: Judge
                    ) -> Misreading | None:
    """Return how one data set is to be read, None where no other reading explains it.

    Args:
        problem: machine and data.
        index: of the data set.
        as_read: what the file leaves as it is read now, without a fit.
        judge: gives what a problem leaves, from few rows.
    """
    data, mechanism = problem.datasets[index], problem.mechanism
    if data.kind in SCALARS or data.commanded is not None:
        return None
    alone = problem.alone(data)
    good: list[Found] = []
    for ways in (_other_readings(alone), _registrations(alone, judge), other_machines(alone)):
        good = [g for g in _judged(ways, judge) if g[2].times * FALLS <= as_read.times]
        if good:
            break
    else:
        return None
    least = min(t.after for _, _, t in good)
    reading, what, best = min(
        (g for g in good if g[2].after <= AS_GOOD * max(least, 1.0)), key=_cost)
    block = None if reading is None else read_block(reading, mechanism, data)
    sigma = {} if reading is None else other_sigma(reading, data, best.left)
    return Misreading(data.source, what, block, *telling(
        (as_read.position, as_read.rotation), (best.position, best.rotation)), best.after, sigma)


def telling(before: tuple[float, float], after: tuple[float, float]) -> tuple[str, float, float]:
    """Return the quantity whose miss falls most, of positions and rotations, before and after."""
    falls = [b / max(a, 1e-300) for b, a in zip(before, after, strict=True)]
    turned = falls[1] > 2.0 * falls[0] or not np.isfinite(after[0])
    return "angle" if turned else "length", before[turned], after[turned]


Found = tuple[FileReading | None, tuple[Mistake, ...], Trial]
Way = tuple[FileReading | None, tuple[Mistake, ...], Problem]


def _cost(found: Found) -> tuple[float, float]:
    reading, what, trial = found
    return (reading.parts if reading is not None else len(what)), trial.after


def _likely(found: Sequence[Scored]) -> list[FileReading]:
    """Return the readings that a fit shall decide between, those that change least first."""
    other = [s for s in found if s.reading.parts]
    if not other:
        return []
    near = [s for s in other if s.score <= AMONG_BEST * other[0].score]
    near = sorted(near, key=lambda s: (s.reading.parts, s.score))[:TRIED]
    best = other[0]
    return [s.reading for s in (near if best in near else [*near, best])]


def _other_readings(alone: Problem) -> Iterator[Way]:
    mechanism, data = alone.mechanism, alone.datasets[0]
    for reading in _likely(search_readings(mechanism, data)):
        other = replace(alone, datasets=(reading.of(data, mechanism),))
        yield reading, mistakes(reading, mechanism, data), other


def _judged(ways: Iterable[Way], judge: Judge) -> list[Found]:
    """Return the readings that land where tolerances and noise explain it.

    A reading that comes to the noise ends the search: those behind it change more.
    """
    out: list[Found] = []
    for reading, what, problem in ways:
        try:
            found = judge(problem, LANDS)
        except PpmcalError:
            continue
        if found.times <= LANDS and _tells(problem, found):
            out.append((reading, what, found))
            if found.after <= AS_GOOD:
                break
    return out


def _tells(alone: Problem, found: Trial) -> bool:
    """Whether what is left is little beside how far the measurements go.

    In a unit that makes everything small, noise and tolerances explain anything.
    """
    data = alone.datasets[0]
    for values, left in zip((data.position, data.rotation), found.left, strict=True):
        known = values[:, np.isfinite(values).any(axis=0)]
        if known.size and np.isfinite(left):
            away = np.linalg.norm(known - np.nanmedian(known, axis=0), axis=1)
            if left <= LEFT * float(np.nanmedian(away)):
                return True
    return not np.isfinite(found.left).any()


REGISTERED = {"frame": ("frame", "the measuring frame is not where the sidecar has it"),
              "target": ("target", "the measured point is not where the sidecar has it"),
              "target_rotation": ("target-rotation", "the measured body is turned otherwise than "
                                  "the sidecar says")}
"""What a sidecar may give and be wrong about: kind of mistake and text, by its key."""


def other_registrations(problem: Problem, index: int) -> Iterator[Way]:
    """Yield the problem with what a sidecar gives of one data set's registration open instead."""
    data = problem.datasets[index]
    motion = problem.mechanism.motion
    given = [key for key in REGISTERED if not getattr(data, key).fitted]
    if motion == "translational":
        given = [key for key in given if key == "frame"]    # the platform never turns
    if data.kind != "pose":
        given = [key for key in given if key != "target_rotation"]
    some = [(key,) for key in given]
    for keys in [*some, tuple(given)] if len(given) > 1 else some:
        other = replace(data, **{key: replace(getattr(data, key), fitted=True) for key in keys})
        datasets = tuple(other if i == index else d for i, d in enumerate(problem.datasets))
        yield None, tuple(Mistake(*_registered(key)) for key in keys), replace(
            problem, datasets=datasets, pivots=None, given=None, earlier=None)


def _registrations(alone: Problem, judge: Judge) -> Iterator[Way]:
    """Yield :func:`other_registrations` of a file that tolerances do not explain as it is read."""
    with suppress(PpmcalError):
        if judge(toleranced(alone, fixed=True), 0.0).times <= WITHIN:
            return
    yield from other_registrations(alone, 0)


def _registered(key: str) -> tuple[str, tuple[str, ...], str]:
    kind, text = REGISTERED[key]
    return kind, (), text


def other_machines(alone: Problem) -> Iterator[Way]:
    """Yield machines whose file gives a diameter for a radius, or the reverse."""
    for machine, ends, words in other_radii(alone.mechanism):
        text = f"{alone.mechanism.source}: {words.format(reason='the measurements say')}"
        what = (Mistake("radius", tuple(f"{e}.point" for e in ends), text),)
        yield None, what, replace(alone, mechanism=machine, free=machine.free)
