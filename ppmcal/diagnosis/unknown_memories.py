"""Traces of what was before that fade from row to row: of ways, of warmth, of payload.

A screw that its own moves heat, a stand that follows the hall's warmth hours later.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ppmcal import linalg
from ppmcal.diagnosis.term_candidates import Visible, columns_from, joint_groups
from ppmcal.diagnosis.unknown_courses import COURSE
from ppmcal.diagnosis.unknown_functions import EACH, Made
from ppmcal.diagnosis.unknown_ways import at_rows
from ppmcal.linalg import Array
from ppmcal.model.effects.learned import JOINT

FADES = (2.0, 5.0, 12.0, 30.0)
"""Rows within which a trace fades to a third."""


def of_memories(seen: Visible) -> Iterator[Made]:
    """Yield fading traces acting on joints, on all alike or each its own, and on coordinates.

    Of the ways of each joint and of all, of the temperature and of the payload, where they vary.
    """
    problem = seen.system.problem
    names, coordinates = problem.mechanism.actuators, problem.mechanism.coordinates
    ways = [np.abs(np.diff(d.q, axis=0, prepend=d.q[:1])) for d in problem.datasets]
    stroke = np.maximum(np.ptp(np.concatenate([d.q for d in problem.datasets]), axis=0),
                        np.finfo(float).tiny)
    carried = [np.linalg.norm(e.weight, axis=1) for e in problem.environments]
    for name, before in (
            ("its own moves", ways),
            ("all moves", [np.sum(w / stroke, axis=1, keepdims=True) for w in ways]),
            ("the temperature", [e.temperature[:, None] for e in problem.environments]),
            ("the payload", [load[:, None] for load in carried])):
        every = np.concatenate(before)
        if not (np.isfinite(every).all() and (np.ptp(every, axis=0) > 0.0).all()):
            continue
        traces = at_rows(seen, [_faded(b) for b in before])
        own = [np.broadcast_to(t, (len(t), len(names), len(FADES))) for t in traces]
        label = f"a fading trace of {name} acting on"
        each = [columns_from(seen, JOINT, on, own) for on in joint_groups(problem.mechanism)]
        for joint, columns in zip(names, each, strict=False):
            yield _made(f"{label} {joint}", [columns], joint)
        if len(names) > 1:
            yield _made(f"{label} each joint, each its own", each[:len(names)], EACH)
        if len(each) > len(names):
            yield _made(f"{label} {' '.join(names)}", [each[-1]], " ".join(names), together=True)
        if traces[0].shape[1] == 1:
            for c in coordinates:
                yield _made(f"{label} {c}", [columns_from(
                    seen, c, (), [t[:, 0] for t in traces])], c)


def _faded(before: Array) -> Array:
    """Return traces (N, k, F) of what was in each row (N, k), of one sigma each."""
    out = np.stack([linalg.fading_sum(before - before.mean(axis=0), float(np.exp(-1.0 / rows)))
                    for rows in FADES], axis=-1)
    return np.asarray(out / np.maximum(out.std(axis=0), np.finfo(float).tiny))


def _made(label: str, columns: Sequence[Array], subject: str, together: bool = False) -> Made:
    """Return a cause whose traces all fade as fast, by joint (n, F)."""
    return Made(label, np.concatenate(columns, axis=1), [
        linalg.block_diagonal([np.diag(one)] * len(columns)) for one in np.eye(len(FADES))],
        together or len(columns) > 1, subject=subject, remedy=COURSE)
