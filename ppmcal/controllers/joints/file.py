"""LinuxCNC's joint compensation files: lines of ``nominal forward reverse``, and nothing else.

With ``COMP_FILE_TYPE = 0`` a line says where a joint is (forward: in positive travel, reverse: in
negative travel) when commanded to nominal. LinuxCNC adds nominal - forward, interpolated
between the nominals and constant beyond them, to the motor's command. Numbers are in the
joint's own unit. It stops reading at the first line that does not begin with three numbers, a
comment or an empty line included, and takes at most 256 lines, their nominals increasing
(LinuxCNC, src/emc/motion/usrmotintf.cc usrmotLoadComp, command.c EMCMOT_SET_JOINT_COMP).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ppmcal.controllers.text import DECIMAL, Rounded
from ppmcal.errors import BadInput
from ppmcal.linalg import Array

MOST = 256
"""Lines that LinuxCNC takes, EMCMOT_COMP_SIZE."""
LONGEST = 250
"""Characters of a line; LinuxCNC cuts longer ones in two (LINELEN)."""
DIGITS = 9
"""Decimals of what is written."""
Numbers = tuple[float, ...]


@dataclass(frozen=True)
class Triplets(Rounded, digits=DIGITS):
    """One joint's table of P lines, the joint's own unit; ``nominal`` increases."""

    nominal: Numbers
    forward: Numbers
    reverse: Numbers


def format_triplets(table: Triplets) -> str:
    """Return the text of a compensation file.

    Raises:
        BadInput: a table that LinuxCNC would not take as it is.
    """
    rounded = table.rounded()
    rows = list(zip(rounded.nominal, rounded.forward, rounded.reverse, strict=True))
    _check(rows, "table")
    return "".join(" ".join(f"{v:.{DIGITS}f}" for v in row) + "\n" for row in rows)


def parse_triplets(text: str, source: str) -> Triplets:
    """Return the table that ``text`` holds; empty lines may only stand at its end."""
    lines = text.rstrip().split("\n") if text.strip() else []
    rows: list[Numbers] = []
    for n, line in enumerate(lines, 1):
        words = line.split()
        values = [float(w) for w in words if DECIMAL.fullmatch(w)]
        if len(words) != 3 or len(values) != 3 or not all(math.isfinite(v) for v in values):
            shown = line.strip()
            raise BadInput(f"'{shown[:40]}' is not three numbers: LinuxCNC stops reading here"
                           if shown else "the line is empty: LinuxCNC stops reading here",
                           f"{source}: line {n}",
                           "Write `nominal forward reverse`; the file takes no comments")
        if len(line) > LONGEST:
            raise BadInput(f"the line has {len(line)} characters", f"{source}: line {n}",
                           f"LinuxCNC cuts lines: write at most {LONGEST}")
        rows.append(tuple(values))
    _check(rows, source)
    nominal, forward, reverse = zip(*rows, strict=True)
    return Triplets(nominal, forward, reverse)


def correction(table: Triplets, position: Array, way: Array) -> Array:
    """Return what LinuxCNC adds to a joint's command (n,), the table's unit.

    Between two lines it goes on from the lower one with the slope of both, beyond the ends it
    stays; trims and slopes are kept in single precision (motion.h emcmot_comp_entry_t,
    control.c compute_screw_comp).

    Args:
        table: the joint's table.
        position: commanded joint positions (n,).
        way: direction of travel (n,), +1 takes the column forward, -1 reverse.
    """
    nominal = np.array(table.nominal)
    place = np.searchsorted(nominal, position, side="right") - 1
    line = np.maximum(place, 0)
    past = np.where(place < 0, 0.0, position - nominal[line])
    out = np.zeros_like(position)
    for column, chosen in ((table.forward, way > 0.0), (table.reverse, way < 0.0)):
        trim = (nominal - np.array(column)).astype(np.float32)
        slope = np.zeros(len(nominal), dtype=np.float32)
        slope[:-1] = (np.diff(trim) / np.diff(nominal)).astype(np.float32)
        out = np.where(chosen, trim[line] + slope[line].astype(float) * past, out)
    return out


def _check(rows: Sequence[Numbers], source: str) -> None:
    """Refuse what LinuxCNC would leave out."""
    if not rows:
        raise BadInput("holds no table", source, "Write lines of `nominal forward reverse`")
    if len(rows) > MOST:
        raise BadInput(f"has {len(rows)} lines", f"{source}: line {MOST + 1}",
                       f"LinuxCNC takes {MOST}: leave out points")
    for n, (before, row) in enumerate(pairwise(rows), 2):
        if row[0] <= before[0]:
            raise BadInput(f"the nominal {row[0]:.10g} is not above the one before, "
                           f"{before[0]:.10g}", f"{source}: line {n}",
                           "Sort the lines by their first number; none may stand twice")
