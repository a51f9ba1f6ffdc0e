"""What counts as one session and as one pose in it: decided here, and nowhere else.

A column `session` decides it; without one each file is a session of its own, except files of one
campaign: several targets of one body, seen at the same poses from one frame, distances from several
points at the same poses and times, and the heights and distances of one printer. Such files form
one session. A pose held out of one file is held out of all, and an event between two poses happens
in all files at once. The same holds for files that the column `session` joins, if their rows were
recorded at the same poses and times.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.dataset import Dataset
from ppmcal.model.same_rows import in_step, partners, tolerances


def session_masks(datasets: Sequence[Dataset]) -> list[tuple[str, list[Bools]]]:
    """Return label and rows, a mask (N,) by data set, of each session in order of appearance.

    A session column splits a file, and joins rows of several; without one each campaign is a
    session, named after its files.
    """
    files: dict[str, list[str]] = {}
    for d in datasets:
        if not d.sessions:
            files.setdefault(campaign(d), []).append(d.body or d.name)
    name = {key: " + ".join(dict.fromkeys(names)) for key, names in files.items()}
    labels = [np.array(d.sessions) if d.sessions else None for d in datasets]
    every = dict.fromkeys(
        label for d in datasets for label in d.sessions or [name[campaign(d)]])
    return [(label, [np.full(len(d), name[campaign(d)] == label) if own is None else own == label
                     for d, own in zip(datasets, labels, strict=True)]) for label in every]


def one_session() -> BadInput:
    """Return the error for leaving out sessions when there is only one."""
    return BadInput("there is only one session to leave out", "--leave-out",
                    "Give files from several days, or add a column `session`")


def campaign(data: Dataset) -> str:
    """Return the name shared by the files of one campaign: that of one of them."""
    return data.campaign or data.name


def pose_labels(datasets: Sequence[Dataset]) -> list[Ints]:
    """Return one label per commanded pose (N,) by data set, shared by files of one campaign."""
    place: dict[str, int] = {}
    own = np.array([place.setdefault(campaign(d), len(place)) for d in datasets], dtype=np.int64)
    return [d.groups * len(place) + n for d, n in zip(datasets, own.tolist(), strict=True)]


def as_campaigns(datasets: Sequence[Dataset]) -> tuple[Dataset, ...]:
    """Return data sets grouped into campaigns, with their rows on one time line.

    Rows are numbered across all files in order; targets of one body seen at the same poses share
    row numbers and pose labels. Targets in one file share them row by row.
    """
    owner = _owners(datasets)
    out, begin = list(datasets), 0
    whole = {i: max((j for j, o in enumerate(owner) if o == i), key=lambda j: (
        len(datasets[j]), -j)) for i in set(owner)}
    at: dict[int, int] = {}
    for i, data in enumerate(datasets):
        first = whole[owner[i]]
        if first not in at:
            at[first] = begin
            begin += max(int(d.rows.max(initial=0)) for d in datasets
                         if d is datasets[first] or _one_file(d, datasets[first]))
        out[i] = replace(data, before=at[first], moments=None, campaign="")
    for i, o in enumerate(owner):
        if owner.count(o) == 1:
            continue
        first = whole[o]
        if first == i or _one_file(datasets[i], datasets[first]):
            out[i] = replace(out[i], campaign=datasets[first].name)
        else:
            out[i] = _beside(out[i], out[first])
    return _heights_and_distances(out)


def companions(datasets: Sequence[Dataset]) -> list[list[tuple[int, Ints]]]:
    """Return for each data set the earlier ones seen at its stops, and their rows (N,), or -1.

    Two targets seen at one stop, at which the joints were read once, share the noise of the
    joints.
    """
    key = [d.numbers() for d in datasets]
    out: list[list[tuple[int, Ints]]] = [[] for _ in datasets]
    for i, data in enumerate(datasets):
        for j, other in enumerate(datasets[:i]):
            if not data.campaign or campaign(other) != data.campaign or not (
                    _shows_poses(data) and _shows_poses(other)):
                continue
            both = data.stands, other.stands
            mine, theirs = both if both[0] is not None and both[1] is not None else (
                key[i], key[j])
            assert mine is not None and theirs is not None
            rows = _same_stand(mine, theirs, data.q, other.q)
            if (rows >= 0).any():
                out[i].append((j, rows))
    return out


def targets_beside_others(datasets: Sequence[Dataset]) -> list[str]:
    """Return the names of data sets whose target is one of several in their campaign."""
    mine = [d for d in datasets if d.campaign and _shows_poses(d)]
    several = Counter(d.campaign for d in mine)
    return [d.name for d in mine if several[d.campaign] > 1]


def _shows_poses(data: Dataset) -> bool:
    return data.kind.of_poses and not data.kind.scalar and data.to_q is None


def _same_stand(mine: Ints, theirs: Ints, q: Array, other: Array) -> Ints:
    """Return the row in ``theirs`` (M,) of each stop in ``mine`` (N,) with equal joints, or -1."""
    stand, first = np.unique(theirs, return_index=True)
    if not stand.size or not mine.size:
        return np.full(mine.size, -1)
    at = np.minimum(np.searchsorted(stand, mine), stand.size - 1)
    rows = first[at]
    near = np.all(np.abs(q - other[rows]) <= tolerances(q, other), axis=1)
    return np.where((stand[at] == mine) & near, rows, -1)


def _owners(datasets: Sequence[Dataset]) -> list[int]:
    """Return for each data set the first one that saw the same poses."""
    owner = list(range(len(datasets)))
    for i, data in enumerate(datasets):
        for j in range(i):
            if owner[j] != owner[i] and _other_target(datasets[j], data):
                owner = [min(owner[i], owner[j]) if o in (owner[i], owner[j]) else o
                         for o in owner]
    return owner


def _one_file(one: Dataset, two: Dataset) -> bool:
    """Whether both are targets of one body in one file."""
    return bool(one.body) and one.body == two.body


def _other_target(one: Dataset, two: Dataset) -> bool:
    """Whether two files hold two targets of one body, seen at the same poses from one frame.

    Also true for readings of encoders at other joints, or of an inclinometer, at these poses, and
    for whatever else was read at the same times.
    """
    if _one_file(one, two) or _at_same_moments(one, two):
        return True
    if one.sessions or two.sessions:
        return False
    beside = one.kind is not two.kind and not (one.kind.of_poses and two.kind.of_poses)
    if not beside and not _one_frame(one, two):
        return False
    targets = one.target, two.target
    if not beside and not any(t.fitted for t in targets) and np.array_equal(
            targets[0].value, targets[1].value):
        return False    # the same target again: the poses were visited twice
    if not _at_one_time(one, two):
        return False
    # most rows of the shorter file are poses that the other visits in the same order
    return int((_places(one, two) >= 0).sum()) > 0.5 * min(len(one), len(two))


def _one_frame(one: Dataset, two: Dataset) -> bool:
    if one.frame.fitted or two.frame.fitted:
        names = [{d.name, d.frame.same_as} - {None} for d in (one, two)]
        return one.frame.fitted and two.frame.fitted and not names[0].isdisjoint(names[1])
    return np.array_equal(one.frame.value, two.frame.value) and one.kind == two.kind and (
        not one.kind.scalar)


def _at_same_moments(one: Dataset, two: Dataset) -> bool:
    """Whether most rows of the shorter file are of poses and times of the other.

    Clocks of two days that count from 0 may agree: a column `session` has to join the files, or all
    that is recorded beside the distances from two points to be the same.
    """
    if bool(one.sessions) != bool(two.sessions) or not (one.sessions or _two_points(one, two)):
        return False
    names = one.columns.keys() & two.columns.keys()
    if "time" not in names:
        return False
    place = _places(one, two)
    rows = np.flatnonzero(place >= 0)
    same = np.ones(rows.size, dtype=bool)
    if one.sessions and two.sessions:
        names = {"time"}
        same = np.array(one.sessions)[place[rows]] == np.array(two.sessions)[rows]
    for name in names:
        own = one.columns[name][:, None], two.columns[name][:, None]
        near = np.abs(own[0][place[rows]] - own[1][rows])[:, 0] <= tolerances(
            *own, (np.zeros(1), np.zeros(1)))
        same &= near | (name != "time") & np.isnan(own[1][rows, 0])
    return int(same.sum()) > 0.5 * min(len(one), len(two))


def _two_points(one: Dataset, two: Dataset) -> bool:
    """Whether two files hold distances, each from a point of its own."""
    fitted = one.frame.fitted, two.frame.fitted
    apart = not _one_frame(one, two) if any(fitted) else not np.array_equal(
        one.frame.value, two.frame.value)
    return one.kind.along_line and two.kind.along_line and apart and (
        one.to_q is None and two.to_q is None)


def _at_one_time(one: Dataset, two: Dataset) -> bool:
    """Whether the times of two files overlap, or are unknown."""
    times = [d.columns["time"] for d in (one, two) if "time" in d.columns]
    times = [t[np.isfinite(t)] for t in times]
    if len(times) < 2 or not all(t.size for t in times):
        return True
    return bool(max(t.min() for t in times) <= min(t.max() for t in times))


def _told(data: Dataset) -> Array:
    """Return the commands, joint values or a commanded pose (N, c)."""
    parts = [data.q, *(p for p in (data.commanded, data.to_q) if p is not None)]
    return np.nan_to_num(np.concatenate(parts, axis=1))


def _places(one: Dataset, two: Dataset) -> Ints:
    """Return the row of ``one`` at the pose of each row of ``two`` (N,), in order; -1: none."""
    told = _told(one), _told(two)
    if told[0].shape[1] != told[1].shape[1]:
        return np.full(len(two), -1)
    if np.array_equal(*told):
        return np.arange(len(two))
    return in_step(*partners(*told, tolerances(*told)), len(two))


def _beside(data: Dataset, first: Dataset) -> Dataset:
    """Return a data set with the row numbers and pose labels of ``first``."""
    place = _places(first, data)
    known = np.flatnonzero(place >= 0)
    # a row without a counterpart was measured after the last one with a counterpart
    last = np.maximum(np.searchsorted(known, np.arange(len(data)), side="right") - 1, 0)
    labels, group = np.unique(data.groups, return_inverse=True)
    new = int(first.groups.max(initial=-1)) + 1 + np.arange(labels.size)
    new[group.reshape(-1)[known[::-1]]] = first.groups[place[known[::-1]]]
    return replace(data, campaign=first.name, stands=None, groups=new[group.reshape(-1)],
                   moments=first.numbers()[place[known]][last])


def _heights_and_distances(datasets: Sequence[Dataset]) -> tuple[Dataset, ...]:
    """Return data sets, the heights and the distances of a printer as one campaign.

    With several files of heights, it is unknown which of them the distances belong to.
    """
    plain = [d for d in datasets if not d.sessions]
    found = [d for d in plain if d.kind.touches], [d for d in plain if d.kind.along_line]
    if any(len(some) != 1 for some in found) or len(datasets) != 2:
        return tuple(datasets)
    first, second = datasets
    return (replace(first, campaign=first.name), replace(
        second, campaign=first.name, groups=second.groups + int(first.groups.max(initial=-1)) + 1))
