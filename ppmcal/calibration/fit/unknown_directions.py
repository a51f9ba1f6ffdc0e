"""Files of a campaign without recorded directions of approach, beside files with them.

In such rows the direction is +1 or -1, unknown: effects of the direction are 0 on average, so only
the other rows determine their size, and they scatter by that size, which is noise of the joints.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset, Environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import abbreviate_list

ON_AVERAGE = 0.0
"""Stands for a direction that may be +1 or -1."""


def with_unknown_directions(mechanism: Mechanism, datasets: Sequence[Dataset],
                            rows: Sequence[Environment]) -> tuple[Dataset, ...]:
    """Return data sets whose unrecorded directions are 0 where other files record them.

    Args:
        mechanism: names the joints.
        datasets: of one campaign.
        rows: their environments.

    Returns:
        The data sets, with a finding on the last one without directions: the number of rows in
        which their effects show. Unchanged if all files record a joint's direction, or none does.
    """
    has = np.array([np.isfinite(r.approach).any(axis=0) for r in rows])
    lacks = ~has & has.any(axis=0)
    without = [i for i, own in enumerate(lacks) if own.any()]
    if not without:
        return tuple(datasets)
    out = list(datasets)
    for i in without:
        out[i] = replace(out[i], visited=np.where(lacks[i], ON_AVERAGE, rows[i].approach))
    told = replace(out[without[-1]], findings=(
        *out[without[-1]].findings, _words(mechanism, datasets, without, lacks)))
    out[without[-1]] = told
    return tuple(out)


def direction_sigma(mechanism: Mechanism, rows: Environment) -> Array:
    """Return how far effects of unknown directions move each joint (k,), unit of q.

    One standard deviation, at the effects' present values: plus or minus, equally likely.
    """
    square = np.zeros(len(mechanism.actuators))
    for effect in mechanism.effects:
        if effect.kind.needs == ("dir",) and "width" in effect.parameters:
            blind = np.all(rows.approach == ON_AVERAGE, axis=0) & np.array(effect.on)
            width = mechanism.parameters[effect.parameters["width"]].value
            square += np.where(blind, (0.5 * width) ** 2, 0.0)
    return np.asarray(np.sqrt(square) / mechanism.joint_ratios) if square.any() else square


def _words(mechanism: Mechanism, datasets: Sequence[Dataset], without: Sequence[int],
           lacks: Bools) -> Note:
    """Return a note on how many rows test effects of the direction, and which files lack it."""
    own = [f"dir_{a}" for i, a in enumerate(mechanism.actuators) if lacks[:, i].any()]
    with_ = [d for i, d in enumerate(datasets) if i not in without]
    by_axis = [c for c in ("dir_x", "dir_y", "dir_z") if any(c in d.columns for d in with_)]
    columns = by_axis or own
    total = sum(len(d) for d in datasets)
    known = total - sum(len(datasets[i]) for i in without)
    are = "is" if len(columns) == 1 else "are"
    files = " and ".join(datasets[i].name for i in without)
    return Note(f"effects of the direction of approach are tested on {known} of {total} rows: "
                f"{abbreviate_list(columns)} {are} not recorded in {files}", topic="approach")
