"""Mistakes of rows: shifted, stale, shuffled, typed wrong; and in the machine's file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .mistakes import Blame, Paper


def shifted(rng, paper: Paper) -> Blame:
    """Measured columns some rows behind the joints; the ends are cut."""
    by = int(rng.integers(1, 4)) * int(rng.choice([1, -1]))
    n = paper.rows
    seen, rest = (slice(0, n - by), slice(by, n)) if by > 0 else (slice(-by, n), slice(0, n + by))
    measured = paper.seen
    for name in list(paper.table):
        paper.table[name] = paper.table[name][seen if name in measured else rest]
    # row k has the measurement of by rows before
    return Blame("shifted", measured, {"shift": by}, note="measured of row k belongs to row k - by")


def stale(what: str):
    """Joints or measurements repeated from the row before, on some rows."""

    def make(rng, paper):
        names = paper.joints if what == "joints" else paper.seen
        first = next(iter(names))
        changed = np.flatnonzero(np.diff(paper.table[first]) != 0) + 1
        rows = np.sort(rng.choice(changed, max(3, paper.rows // 15), replace=False))
        for name in names:
            old = paper.table[name].copy()
            for k in rows:
                old[k] = old[k - 1]
            paper.table[name] = old
        return Blame("stale", names, None, rows.tolist(), mends=False)

    return make


def outside_limits(rng, paper: Paper) -> Blame:
    """A joint counted from another zero: beyond its limits everywhere."""
    name = str(rng.choice(paper.joints))
    low, high = paper.mechanism["limits"][name[2:]]
    paper.table[name] = paper.table[name] + 1.2 * (high - low)
    return Blame("outside-limits", [name], None, mends=False, note="another zero")


def doubled(part: str):
    """Diameter written where the mechanism file wants a radius."""

    def make(rng, paper):
        for limb in paper.mechanism["limbs"]:
            point = np.array(limb[part]["point"], float)
            polar = {"radius": 2 * float(np.hypot(*point[:2])),
                     "angle": float(np.degrees(np.arctan2(point[1], point[0])))}  # fmt: skip
            if len(point) == 3:
                polar["z"] = float(point[2])
            limb[part]["point"] = polar
        return Blame(
            "radius", [f"*.{part}.point.radius"], None, note="halve the radii", mends=False
        )

    return make


def shuffled(rng, paper: Paper) -> Blame:
    """Measured columns in another order than the joints, in a block of rows."""
    start = int(rng.integers(0, paper.rows // 3))
    rows = np.arange(start, start + paper.rows // 3)
    order = rng.permutation(rows)
    for name in paper.seen:
        values = paper.table[name].copy()
        values[rows] = values[order]
        paper.table[name] = values
    return Blame(
        "shuffled", paper.seen, None, rows.tolist(), mends=False, note="no kind of the list"
    )


def reversed_order(rng, paper: Paper) -> Blame:
    """Whole rows in another order than taken (time tells the right one): harmless."""
    order = rng.permutation(paper.rows)
    for name in paper.table:
        paper.table[name] = paper.table[name][order]
    return Blame("reordered", [], {}, note="rows are whole: nothing to mend but the order by time")


def approach_inverted(share: float):
    """Direction columns with the wrong sign on the first part: of all rows it is no mistake."""

    def make(rng, paper):
        names = [n for n in paper.table if n.startswith("dir_")]
        rows = np.arange(int(share * paper.rows))
        for name in names:
            values = paper.table[name].copy()
            values[rows] = -values[rows]
            paper.table[name] = values
        return Blame("sign", names, None, rows.tolist(), mends=False)

    return make


def in_stretch(mistake, low: float, high: float, to_end: bool = False):
    """A mistake of columns on a part of the rows only, as after a cable was changed."""

    def make(rng, paper):
        right = {name: values.copy() for name, values in paper.table.items()}
        blame = mistake(rng, paper)
        count = int(rng.uniform(low, high) * paper.rows)
        start = paper.rows - count if to_end else int(rng.integers(0, paper.rows - count + 1))
        inside = (np.arange(paper.rows) >= start) & (np.arange(paper.rows) < start + count)
        for name, values in right.items():
            paper.table[name] = np.where(inside, paper.table[name], values)
        rows = np.flatnonzero(inside).tolist()
        return replace(blame, read=None, rows=rows, mends=False, note="rows in a stretch only")

    return make


def typos(share: float):
    """Single entries typed wrong: decimal point, two digits exchanged, or the sign."""

    def make(rng, paper):
        count = max(1, round(share * paper.rows))
        rows = np.sort(rng.choice(paper.rows, count, replace=False))
        names = paper.joints + paper.seen
        for k in rows:
            name = str(rng.choice(names))
            values = paper.table[name].copy()
            values[k] = typed_wrong(float(values[k]), rng)
            paper.table[name] = values
        return Blame("gross", names, None, rows.tolist(), note="outliers, not a misreading")

    return make


def typed_wrong(value: float, rng) -> float:
    """A number as a tired hand types it."""
    how = rng.choice(["decimal", "digits", "sign"])
    if how == "decimal":
        return value * float(rng.choice([0.1, 10.0]))
    if how == "sign":
        return -value
    text = f"{abs(value):.3f}"
    places = [
        i for i in range(len(text) - 2) if "." not in text[i : i + 2] and text[i] != text[i + 1]
    ]
    if not places:
        return value + 1.0
    i = int(rng.choice(places[:2]))
    return np.sign(value) * float(text[:i] + text[i + 1] + text[i] + text[i + 2 :])


def both(first, second):
    """Two mistakes at once."""

    def make(rng, paper):
        return [first(rng, paper), second(rng, paper)]

    return make
