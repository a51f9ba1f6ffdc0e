"""Figures of accuracy and repeatability: errors, ISO 9283 of poses, ISO 230-2 of axes. SI.

``errors`` (N, m) are attained minus commanded coordinates, of which the first ``places`` are of
position and the others of rotation; the commanded pose is what the certified model gives at the
joint values that were commanded, where the instrument stands.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal.calibration.validation import Figure
from ppmcal.linalg import Array, Bools, Ints

TARGETS = 5
"""Positions along an axis that ISO 230-2 asks for, and poses that ISO 9283 does."""


def error_figures(position: Array, rotation: Array) -> Iterator[Figure]:
    """Yield rms, 95 % point and largest of errors (N,) each, nan where not measured."""
    for kind, quantity, values in (("position", "length", position),
                                   ("rotation", "angle", rotation)):
        known = values[np.isfinite(values)]
        if not known.size:
            continue
        for name, value in (("rms error", np.sqrt(np.mean(known**2))),
                            ("95 % point", np.quantile(known, 0.95)),
                            ("largest error", known.max())):
            yield Figure("", f"{name} of {kind}", float(value), unit=quantity)


def grouped(labels: Ints) -> list[Ints]:
    """Return the rows of each label (N,), labels in their order."""
    order = np.argsort(labels, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(labels[order])) + 1) if order.size else []


# ---- ISO 9283


def one_sided(groups: Ints, directions: Array) -> list[Ints]:
    """Return the rows of each commanded pose that came from one direction, the most of each pose.

    Args:
        groups: label per commanded pose (N,).
        directions: sign of approach by joint (N, k), nan where it is not recorded.
    """
    signs = np.nan_to_num(directions).astype(int)
    out = []
    for rows in grouped(groups):
        _, which = np.unique(signs[rows], axis=0, return_inverse=True)
        which = which.reshape(-1)
        out.append(rows[which == np.argmax(np.bincount(which))])
    return out


def pose_figures(errors: Array, names: Sequence[str], places: int, sets: Sequence[Ints],
                 asked: int) -> list[Figure]:
    """Return AP and RP of ISO 9283, each of the worst pose.

    Args:
        errors: (N, m), nan where not measured.
        names: of the coordinates (m,).
        places: how many of them are of position.
        sets: rows of one commanded pose from one direction, by pose.
        asked: repeats that each pose needs.
    """
    whole: Bools = np.asarray(np.isfinite(errors).all(axis=1))
    counts = [int(whole[s].sum()) for s in sets]
    good = [s[whole[s]] for s, n in zip(sets, counts, strict=True) if n >= asked]
    symbols = [*(("AP_p", "RP_l") if places else ()),
               *(f"{a}_{n}" for n in names[places:] for a in ("AP", "RP"))]
    most, found = max(counts, default=0), [_of_pose(errors[s], names, places) for s in good]
    fewest = min(map(len, good), default=most)
    where = f"worst of {len(good)} of {len(sets)} poses" if good else ""
    why = "" if good else (
        f"at most {most} attained {'pose' if most == 1 else 'poses'} of a commanded pose from one "
        f"direction, {asked} are asked")
    return [Figure(s, _POSE[s[:2]], max((f[s] for f in found), default=None),
                   "length" if s in ("AP_p", "RP_l") else "angle", "ISO 9283", fewest, asked,
                   where, why) for s in symbols]


_POSE = {"AP": "pose accuracy", "RP": "pose repeatability"}


def _of_pose(errors: Array, names: Sequence[str], places: int) -> dict[str, float]:
    """Return AP and RP of the attained poses (n, m) of one commanded pose."""
    out = {}
    if places:
        middle = errors[:, :places].mean(axis=0)
        apart = np.linalg.norm(errors[:, :places] - middle, axis=1)
        out = {"AP_p": float(np.linalg.norm(middle)),
               "RP_l": float(apart.mean() + 3.0 * apart.std(ddof=1))}
    for i, name in enumerate(names[places:], places):
        out[f"AP_{name}"] = float(abs(errors[:, i].mean()))
        out[f"RP_{name}"] = float(3.0 * errors[:, i].std(ddof=1))
    return out


# ---- ISO 230-2


@dataclass(frozen=True, eq=False)
class AxisRows:
    """One driven axis: deviations (N,) of its joint, side of approach (N,), target label (N,)."""

    name: str
    quantity: str
    deviation: Array
    side: Array
    groups: Ints


def axis_figures(axis: AxisRows, asked: int) -> list[Figure]:
    """Return B, R, E and A of ISO 230-2 of an axis that targets were approached on both sides."""
    up, down, fewest, targets = _sides(axis, asked)
    enough = len(up) >= TARGETS
    values = bidirectional(up, down) if enough else {}
    where = f"{len(up)} of {targets} positions" if enough else axis.name
    why = "" if enough else _missing(axis, asked, len(up), fewest)
    return [Figure(s, f"{n} of {axis.name}", values.get(s), axis.quantity, "ISO 230-2", fewest,
                   asked, where, why) for s, n in _AXIS.items()]


_AXIS = {"B": "reversal", "R": "bidirectional repeatability",
         "E": "bidirectional systematic deviation", "A": "bidirectional accuracy"}


def _missing(axis: AxisRows, asked: int, targets: int, most: int) -> str:
    if not np.isfinite(axis.side).any():
        return "no direction of approach is recorded"
    if not np.isfinite(axis.deviation).any():
        return "the instrument does not tell the joint's place"
    return (f"{targets} positions with {asked} approaches from both sides, {TARGETS} are asked; "
            f"at most {most} from both")


def _sides(axis: AxisRows, asked: int) -> tuple[list[Array], list[Array], int, int]:
    """Return deviations from each side by target, fewest (else most) repeats, targets in all."""
    up, down, counts, most = [], [], [], 0
    targets = grouped(axis.groups)
    for rows in targets:
        here = axis.deviation[rows]
        one, two = (here[np.isfinite(here) & (axis.side[rows] == s)] for s in (1.0, -1.0))
        count = min(one.size, two.size)
        most = max(most, count)
        if count >= asked:
            up.append(one)
            down.append(two)
            counts.append(count)
    return up, down, min(counts, default=most), len(targets)


def bidirectional(up: Sequence[Array], down: Sequence[Array]) -> Mapping[str, float]:
    """Return B, R, E and A (ISO 230-2:2014, 3.14 to 3.23) from deviations by target position."""
    mean = np.array([[d.mean() for d in side] for side in (up, down)])
    s = np.array([[d.std(ddof=1) for d in side] for side in (up, down)])
    reversal = mean[0] - mean[1]
    repeat = np.maximum(2.0 * s.sum(axis=0) + np.abs(reversal), 4.0 * s.max(axis=0))
    return {"B": float(np.abs(reversal).max()), "R": float(repeat.max()),
            "E": float(mean.max() - mean.min()),
            "A": float((mean + 2.0 * s).max() - (mean - 2.0 * s).min())}
