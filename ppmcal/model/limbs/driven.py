"""Chains split at their drive: a constant part, a motion by u along one twist, a constant part.

    chain(g, u) = before exp(u twist) after,

so that one number per row determines the chain's end. Every chain whose steps declare their drive
(:attr:`chain.ChainStep.drive`) has this form, unless it uses u elsewhere.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import Chain, ErrorTwists, U, Values


@dataclass(frozen=True)
class DrivenChain:
    """One chain of L limbs at constant slots.

    Attributes:
        before, after: motors (L, 8) on both sides of the drive.
        drive: twist (L, 6) per unit of u, in the axes before it; 0 without a drive.
        still: slot -> twist (L, 6) in the chain's root axes, for slots before the drive.
        carried: slot -> twist (L, 6) in the axes of the chain's end, for slots after it.
    """

    before: Array
    drive: Array
    after: Array
    still: dict[str, Array]
    carried: dict[str, Array]


class _DiffersByRow(Exception):
    """A slot other than u has a value for each row."""


class _WithoutDrive(dict[str, Any]):
    """Values of a limb without u: a step that needs it raises KeyError."""

    def get(self, key: str, default: Any = None) -> Any:
        if key == U:
            raise KeyError(U)
        return super().get(key, default)


def cut_at_drive(chain: Chain, values: Values, wanted: Collection[str], limbs: int
                 ) -> DrivenChain | None:
    """Return a chain in its two parts, None if it does not have this form.

    Args:
        chain: of the kind.
        values: slots (1, L) and directions (1, L, 3), SI; slots (N, L) do not have this form.
        wanted: slots whose twists are needed, ``u`` among them.
        limbs: L.
    """
    held = _WithoutDrive({name: v for name, v in values.items() if name != U})
    drives = [i for i, step in enumerate(chain.steps) if step.drive]
    if len(drives) > 1:
        return None
    place = drives[0] if drives else len(chain.steps)
    try:
        before, still = Chain(chain.steps[:place]).evaluate(held, wanted)
        after, carried = Chain(chain.steps[place + 1:]).evaluate(held, wanted)
        twist = chain.steps[place].twists(held)[0][1] if drives else np.zeros(6)
        one = [_each(part, limbs) for part in (before, twist, after)]
        first = _by_slot(still, limbs)
        if drives:
            first[U] = cga.adjoint_twist(one[0], one[1])
        last = _by_slot(carried, limbs, cga.reverse(one[2]))
    except (KeyError, _DiffersByRow):
        return None
    return DrivenChain(one[0], one[1], one[2], first, last)


def _each(part: Array, limbs: int) -> Array:
    """Return values for all limbs (L, ...) without the row axis."""
    part = np.asarray(part, dtype=float)
    if part.ndim == 1:
        return np.broadcast_to(part, (limbs, *part.shape))
    if part.shape[0] != 1:
        raise _DiffersByRow
    return np.broadcast_to(part[0], (limbs, part.shape[-1]))


def _by_slot(groups: Collection[ErrorTwists], limbs: int, move: Array | None = None
             ) -> dict[str, Array]:
    """Return the twists (L, 6) by slot, in root axes or transformed by motors (L, 8)."""
    out: dict[str, Array] = {}
    for group in groups:
        twists = group.twists()
        twists = np.stack([_each(twists[..., k, :], limbs) for k in range(len(group.names))])
        if move is not None:
            twists = cga.adjoint_twist(move, twists)
        out.update(zip(group.names, twists, strict=True))
    return out
