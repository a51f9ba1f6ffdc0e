"""Misreadings of one target of a body with several, whose columns carry its name.

By itself, a target's frame is open: exchanged axes look like a mirrored axis in a turned frame, and
two reversed axes like nothing. Beside targets that are read rightly, the frame is held as theirs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ppmcal.calibration.fit import Fit, Problem
from ppmcal.calibration.interpretation.interpretation_error import (
    FileFault,
    Interpretation,
    lines_for,
)
from ppmcal.calibration.interpretation.limits import MOST, TELLING
from ppmcal.calibration.interpretation.score import Look, score
from ppmcal.errors import PpmcalError
from ppmcal.model.dataset import Dataset


def left_out_whole(fit: Fit) -> frozenset[int]:
    """Return the data sets from which a fit left out most of the usable rows."""
    return frozenset(i for i, (d, keep) in enumerate(zip(fit.problem.datasets, fit.keep,
                                                         strict=True))
                     if d.usable.any() and (~keep[d.usable]).mean() > MOST)


def targets_read(problem: Problem, found: Mapping[int, Interpretation],
                 astray: frozenset[int], read: Callable[[Problem], Interpretation | None]
                 ) -> tuple[Interpretation, ...]:
    """Return misreadings, with those of one body's targets merged.

    Args:
        problem: machine and data.
        found: misreadings of single data sets, by number.
        astray: data sets that, like those found, do not fit beside the others.
        read: finds how the single data set of a problem, with its frame held, should be read.
    """
    bodies: dict[str, list[int]] = {}
    for i, d in enumerate(problem.datasets):
        bodies.setdefault(d.body or f"{d.name} alone", []).append(i)
    out = list[Interpretation]()
    for own in bodies.values():
        mine = {i: found[i] for i in own if i in found}
        wrong = [i for i in own if i in found or i in astray]
        if len(own) == 1 or not (wrong or _disagree(problem, own)):
            out += mine.values()
            continue
        beside = _least(problem, own, wrong, mine, read)
        # of two targets that are each in order alone, either may be the reversed one
        either = frozenset(beside) - mine.keys() if len(own) == 2 else frozenset()
        out += _told(problem, own, mine | beside, either)
    return tuple(out)


def _disagree(problem: Problem, own: Sequence[int]) -> bool:
    """Whether targets fit far worse together, in one frame, than each alone."""
    data = [problem.datasets[i] for i in own]
    alone = [score(problem.alone(d), np.inf).total for d in data]
    first = data[0].alone()
    whole = [first, *(replace(d, frame=replace(d.frame, same_as=first.name)) for d in data[1:])]
    together = score(problem.afresh(datasets=tuple(whole)), np.inf).total
    return together > TELLING * max(alone)


def _least(problem: Problem, own: Sequence[int], wrong: Sequence[int],
           found: Mapping[int, Interpretation], read: Callable[[Problem], Interpretation | None]
           ) -> dict[int, Interpretation]:
    """Return how to read targets beside the one whose frame requires the fewest changes."""
    data, pairs = problem.datasets, list[tuple[Dataset, Sequence[int]]]()
    if not wrong:
        pairs = [(data[i], [j for j in own if j != i]) for i in own]
    elif len(wrong) < len(own):
        pairs = [(data[next(i for i in own if i not in wrong)], wrong)]
    else:
        pairs = [(right, wrong) for i in wrong
                 if i in found and (right := found[i].right) is not None]
    ways = [_beside(problem, others, start, read) for start, others in pairs]
    return min((w for w in ways if w), default={}, key=lambda w: (
        len({*wrong} - w.keys()), sum(len(m.mistakes) for m in w.values())))


def _beside(problem: Problem, wrong: Sequence[int], start: Dataset,
            read: Callable[[Problem], Interpretation | None]) -> dict[int, Interpretation]:
    """Return how to read data sets with their frame held as in one that is read rightly.

    Empty if that one cannot be fitted, or its frame is not open.
    """
    frame, out = start.alone().frame, dict[int, Interpretation]()
    if not frame.fitted:
        return out
    with suppress(PpmcalError):
        state = Look.at(problem.alone(start)).fitted()
        held = replace(frame, fitted=False, value=state.registrations[0].frame_pose)
        for i in wrong:
            found = read(problem.alone(replace(problem.datasets[i], frame=held)))
            if found is not None:
                out[i] = found
    return out


def _told(problem: Problem, own: Sequence[int], found: Mapping[int, Interpretation],
          either: frozenset[int]) -> Iterator[Interpretation]:
    """Yield the misreading of a body's targets (by number), if any is found.

    ``either``: those that may be interchanged with the other one of two.
    """
    wrong = [i for i in own if i in found]
    if not wrong:
        return
    first = found[wrong[0]]
    alike = len(wrong) == len(own) and len({
        tuple(m.text for m in found[i].mistakes) for i in own}) == 1
    long = not problem.datasets[own[0]].wide
    if alike and long:
        yield first
        return
    named = first.mistakes if alike else tuple(
        replace(m, text=f"target {problem.datasets[i].mark}"
                + " (or the other one in its place)" * (i in either) + f": {m.text}"
                + _in_a_long_file(found[i]) * long,
                rows=tuple(problem.datasets[i].rows.tolist()) if long else m.rows,
                columns=(problem.datasets[i].mark,) if m.kind == "target" else m.columns)
        for i in wrong for m in map(_unlike_others, found[i].mistakes))
    yield replace(first, mistakes=named, sigma=first.sigma if alike else {}, alternatives=(),
                  block=None if long else merged([found[i] for i in wrong]),
                  headers={} if long else {h: new for i in wrong
                                           for h, new in found[i].headers.items()})


def _unlike_others(mistake: FileFault) -> FileFault:
    """Return the mistake of one target: a mirror image would concern the others too."""
    if mistake.kind != "mirrored":
        return mistake
    return replace(mistake, kind="sign", text="left-handed: one of its axes has the other sign")


def _in_a_long_file(found: Interpretation) -> str:
    """Return what the sidecar of a separate file for that target would say."""
    told = lines_for(found.block, found.headers)
    return f" ({told})" if told else ""


def merged(found: Sequence[Interpretation]) -> dict[str, object] | None:
    """Return one block ``read`` of a wide file for several of its targets."""
    out: dict[str, object] = {}
    for key, value in (pair for m in found for pair in (m.block or {}).items()):
        old = out.get(key)
        out[key] = {**old, **value} if isinstance(old, dict) and isinstance(value, dict) else value
    return out or None
