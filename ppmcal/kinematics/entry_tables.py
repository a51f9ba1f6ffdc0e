"""Entries of the columns of a Jacobian: one twist per slot and equation.

A parameter that feeds several slots, or one slot of several limbs, has several entries; those of
one column that belong to the same equation and the same part of a chain are merged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ppmcal.kinematics.closure import Closure
from ppmcal.kinematics.limb_tables import EntryTables
from ppmcal.linalg import Array, Ints
from ppmcal.model.limbs.chain import U
from ppmcal.model.limbs.driven import DrivenChain

SIGNS = (-1.0, -1.0, 1.0)
"""A twist before the contact subtracts from c, one on the platform's side adds to it."""
STAGES = 6
"""Base, middle and platform chain, each before and after its drive."""


def entry_tables(closure: Closure, chains: Sequence[Sequence[DrivenChain]],
                 place: Mapping[int, int], homing: int | None) -> EntryTables | None:
    """Return the entries of the columns of parameters and joints.

    Args:
        closure: built for the parameters.
        chains: of each group of limbs, split at the drive.
        place: parameter -> column.
        homing: column of the first joint's offset, if those are wanted.

    None if a drive ratio differs from row to row and is needed.
    """
    keys: list[tuple[int, int, int, int]] = []
    twists: list[Array] = []
    model = closure.model
    for group, own in zip(closure.groups, chains, strict=True):
        known = _twists(own)
        ratio = np.asarray(group.values.get("ratio", np.ones((1, 1))))
        if homing is not None and ratio.shape[0] != 1:
            return None
        for at, i in enumerate(group.limbs):
            limb, names, columns = model.mechanism.limbs[i], closure.slots[i], closure.columns[i]
            weights = limb.slots.jacobian(model.parameters, names, columns)
            asked = [(names[s], place[columns[c]], weights[s, c])
                     for s, c in zip(*np.nonzero(weights), strict=True)]
            if homing is not None and limb.driven:
                asked.append((U, homing + limb.actuator, ratio[0, at % ratio.shape[1]]))
            for name, column, weight in asked:
                joint = limb.actuator if name == "ratio" else -1
                for stage, twist in known.get(U if name in ("offset", "ratio") else name, ()):
                    keys += [(e, stage, column, joint) for e in group.rows[at].tolist()]
                    twists += [weight * twist[at]] * group.rows.shape[1]
    return _sorted(np.array(keys, dtype=np.int64).reshape(-1, 4),
                   np.array(twists, dtype=float).reshape(-1, 6), model.mechanism.equations)


def _twists(chains: Sequence[DrivenChain]) -> dict[str, list[tuple[int, Array]]]:
    """Return the stages to which each slot belongs, with its twists there (L, 6)."""
    out: dict[str, list[tuple[int, Array]]] = {}
    for k, chain in enumerate(chains):
        for behind, part in enumerate((chain.still, chain.carried)):
            for name, twist in part.items():
                out.setdefault(name, []).append((2 * k + behind, SIGNS[k] * twist))
    return out


def _sorted(keys: Ints, twists: Array, equations: int) -> EntryTables:
    """Return sorted entries of (equation, stage, column, joint) (S, 4), equal ones summed."""
    keys, same = np.unique(keys, axis=0, return_inverse=True)
    twist = np.zeros((len(keys), 6))
    np.add.at(twist, same.reshape(-1), twists)
    equation, stage, column, joint = np.ascontiguousarray(keys.T)
    bounds = np.searchsorted(STAGES * equation + stage, np.arange(STAGES * equations + 1))
    first = bounds[STAGES * np.arange(equations)[:, None] + np.arange(STAGES + 1)]
    order = np.lexsort((column, equation))
    place = np.empty_like(order)
    place[order] = np.arange(order.size)
    equation, column = equation[order], column[order]
    again = np.ones(order.size, dtype=np.int64)
    again[np.unique(column, return_index=True)[1]] = 0
    new = (np.diff(column) != 1) | (np.diff(equation) != 0) | (np.diff(again) != 0)
    begins = np.flatnonzero(np.concatenate([[True], new])[:order.size])
    lengths = np.diff(np.append(begins, order.size))
    runs = np.stack([equation[begins], begins, column[begins], lengths, again[begins]], axis=-1)
    return EntryTables(first, twist, joint, place, column, runs)
