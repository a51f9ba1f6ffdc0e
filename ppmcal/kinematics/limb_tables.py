"""The tables that the compiled path reads: limbs, and the entries of a Jacobian's columns."""

from __future__ import annotations

from typing import NamedTuple

from ppmcal.linalg import Array, Ints


class LimbTables(NamedTuple):
    """L limbs and their d equations.

    ``ends`` (L, 3, 3, 12): a chain ends at ends[0] + f ends[1] + g ends[2], a rotation row by row
    and a translation, with (f, g) by ``drive`` (L, 3): nothing, (u, 0) or (cos u, sin u).
    ``first`` (L + 1,): first equation of each limb; ``limb``, ``form``, ``axis``, ``other`` (d,) of
    each equation; ``dof`` (d,): coordinates of the pose; ``wheel`` (L,): radii of pulleys, m.
    """

    ends: Array
    drive: Ints
    first: Ints
    limb: Ints
    form: Ints
    axis: Ints
    other: Ints
    dof: Ints
    wheel: Array


class EntryTables(NamedTuple):
    """S entries, in the order of equation and stage.

    A stage is the part of a chain on one side of its drive. ``first`` (d, 7): where an equation's
    entries begin by stage, and where they end; ``twist`` (S, 6); ``joint`` (S,): the joint whose
    value multiplies the entry, or -1; ``place`` (S,): its place in the order of equation
    and column; ``column`` (S,) in that order; ``runs`` (r, 5): runs of entries in that order with
    consecutive columns: equation, first entry, first column, length, whether to add to the
    present value.
    """

    first: Ints
    twist: Array
    joint: Ints
    place: Ints
    column: Ints
    runs: Ints
