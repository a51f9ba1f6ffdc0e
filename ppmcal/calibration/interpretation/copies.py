"""Rows that are copies of others: equal in every digit, more often than chance allows.

A repeat is a new measurement with its own noise. A row that was copied, or written again by a log,
carries no information, and counted as a repeat it makes the fit too certain. Coarse
readings do agree now and then: two readings of one value, with noise sigma and resolution r, are
equal with probability erf(a) - (1 - exp(-a^2))/(a sqrt(pi)), a = r/(2 sigma).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.errors import BadInput
from ppmcal.linalg import Array, Bools
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import number_names
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.model.repeats import NO_INFLUENCE, identical_rows
from ppmcal.model.same_rows import KEPT, KnownRows, partners, step_of, tolerances
from ppmcal.notes import Note
from ppmcal.wording import pluralize, row_list

BY_CHANCE = 1e-4
"""Expected number of equal rows among true repeats below which equal rows are copies."""
ALWAYS = 10
"""If at least this many repeats, and all there are, equal the first of their pose, the noise is far
below the resolution or absent: one of them carries the information of all."""
FEWEST = 3
REASON = "identical to an earlier row in every digit: a copy, not a repeat"


def chance_of_equal(step: float, sigma: float) -> float:
    """Return the chance that two readings of resolution ``step`` and noise ``sigma`` agree."""
    if not sigma > 0.0 or not step < math.inf:
        return 1.0
    a = step / (2.0 * sigma)
    if a < 1e-4:
        return a / math.sqrt(math.pi)
    return math.erf(a) - (1.0 - math.exp(-a * a)) / (a * math.sqrt(math.pi))


def steps_of(numbers: Mapping[str, Array], data: Dataset, reach: float) -> Array:
    """Return the resolution of x, y, z, rx, ry, rz and of the value (7,), SI; inf if unknown.

    Args:
        numbers: the file's by column, in its units, before rotations are converted to vectors.
        data: the data set made from them.
        reach: the machine's, m.

    If all values are equal, as for touches of a flat, the joints are what was measured.
    """
    length, angle = data.units.factor("length"), data.units.factor("angle")
    own = {name: (i, length if i < 3 else angle) for i, name in enumerate(POSE_COORDINATES)}
    own |= dict.fromkeys(number_names(), (6, length))
    if data.kind.scalar:
        own[data.kind.number] = (6, data.units.factor(data.kind.quantity))
    own |= {name: (c, angle) for name, c in zip(data.kind.names, (3, 4), strict=False)}
    out = np.full(7, math.inf)
    for name, (i, factor) in own.items():
        if name in numbers:
            out[i] = step_of(numbers[name]) * factor
    if data.kind.scalar and not out[6] < math.inf:
        # the whole range of a joint moves the platform by at most the reach, or a radian
        size = reach if data.kind.quantity == "length" else 1.0
        out[6] = size * max((step_of(q) / float(np.nanmax(q) - np.nanmin(q)) for q in data.q.T
                              if np.isfinite(q).any() and np.nanmax(q) > np.nanmin(q)),
                             default=math.inf)
    return out


def chance(data: Dataset, steps: Array) -> float:
    """Return the chance that two measurements of one pose agree in every digit.

    By the stated noise, or by the scatter of those repeats that differ if that is smaller.
    """
    values, sigma = _values(data), _sigmas(data)
    if data.kind.scalar:
        steps, values, sigma = steps[6:], values[:, 6:], sigma[6:]
    scatter = _scatter(data, values)
    sigma = np.where(np.isfinite(scatter), np.fmin(sigma, scatter), sigma)
    return math.prod(chance_of_equal(float(r), float(s)) for r, s in zip(steps, sigma, strict=True)
                     if math.isfinite(s))


def _values(data: Dataset) -> Array:
    return np.column_stack([data.position, data.rotation, data.value])


def _sigmas(data: Dataset) -> Array:
    """Return the median noise of each column of :func:`_values` (7,), nan where not measured."""
    sigma = np.column_stack([data.sigma_position, data.sigma_rotation, data.sigma_value])
    seen = np.isfinite(_values(data)) & np.isfinite(sigma)
    return np.array([np.median(s[k]) if k.any() else np.nan
                     for s, k in zip(sigma.T, seen.T, strict=True)])


def _scatter(data: Dataset, values: Array) -> Array:
    """Return the scatter of repeats that differ (m,), nan without any."""
    place = identical_rows(_conditions(data))
    if np.array_equal(place, np.arange(len(data))):
        return np.full(values.shape[1], np.nan)
    whole = identical_rows(np.column_stack([_conditions(data), values]))
    _, first = np.unique(whole, return_index=True)
    _, label, count = np.unique(place[first], return_inverse=True, return_counts=True)
    several = count[label] > 1
    if not several.any():
        return np.full(values.shape[1], np.nan)
    some = values[first][several]
    _, label = np.unique(label[several], return_inverse=True)
    size = np.bincount(label)
    middle = np.stack([np.bincount(label, c) / size for c in some.T], axis=1)
    degrees = max(len(some) - size.size, 1)
    return np.asarray(np.sqrt(np.sum((some - middle[label]) ** 2, axis=0) / degrees))


def _conditions(data: Dataset) -> Array:
    """Return the commands and conditions of all rows (N, c), placeholders where unknown."""
    parts = [data.q, *(p for p in (data.to_q, data.commanded) if p is not None),
             *(c[:, None] for n, c in sorted(data.columns.items()) if n not in NO_INFLUENCE)]
    return np.asarray(np.nan_to_num(np.concatenate(parts, axis=1), nan=0.5, posinf=0, neginf=0))


def copied(data: Dataset) -> Bools:
    """Return which rows (N,) are copies of an earlier one, judged by ``data.chance``."""
    values = _values(data)
    told = _conditions(data)
    whole = identical_rows(np.column_stack([told, np.nan_to_num(values, nan=0.5)]))
    out = whole < np.arange(len(data))
    if not out.any():
        return out
    repeats = identical_rows(told) < np.arange(len(data))
    moving = np.any(np.nanmax(np.where(np.isfinite(values), values, -np.inf), axis=0)
                    > np.nanmin(np.where(np.isfinite(values), values, np.inf), axis=0))
    always = moving and repeats.sum() >= ALWAYS and np.array_equal(repeats, out)
    if always or data.chance * repeats.sum() < BY_CHANCE:
        return out
    return np.zeros_like(out)


def without_copies(data: Dataset) -> Dataset:
    """Return the data set without copied rows, with a finding about them.

    Raises:
        BadInput: hardly any other rows remain.
    """
    out = copied(data)
    if not out.any():
        return data
    if len(data) - out.sum() < FEWEST <= len(data):
        raise BadInput(f"the {len(data)} rows are {pluralize(len(data) - int(out.sum()), 'row')} "
                       "copied: identical in every digit, they add nothing", data.source,
                       "Measure more poses, and a pose again where it is to be a repeat")
    return _left_out(data, out, Note(f"{data.source}: {row_list(data.rows[out] - 1)}: {REASON}; "
                                     "each counts once.", topic="copies"))


def without_shared(several: Sequence[Dataset]) -> tuple[Dataset, ...]:
    """Return data sets without the rows that an earlier one of the same kind also has.

    A copy may have been written with fewer digits, or in other units.

    Raises:
        BadInput: a data set without any row of its own.
    """
    done = list[Dataset]()
    for data in several:
        for other in done:
            if (data.kind, data.q.shape[1]) != (other.kind, other.q.shape[1]) or sorted(
                    data.columns) != sorted(other.columns):
                continue
            rows = [np.column_stack([_conditions(d), np.nan_to_num(_values(d), nan=0.5)])
                    for d in (other, data)]
            if rows[0].shape[1] != rows[1].shape[1]:
                continue
            again = identical_rows(np.concatenate(rows))[len(other):] < len(other)
            if not again.all():
                one, two = rows
                again[partners(one, two, tolerances(one, two))[1]] = True
            if again.any() and _copied_count(again, max(data.chance, other.chance)):
                if again.all():
                    raise BadInput(f"holds only rows that {other.source} holds too, equal "
                                   "within its digits", data.source,
                                   "Give each measurement only once")
                data = _left_out(data, again, Note(f"{data.source}: "
                                                   f"{pluralize(int(again.sum()), 'row')} also in "
                                                   f"{other.source}, equal within their "
                                                   "digits: copies are not repeats; each counts "
                                                   "once.", topic="copies"))
        done.append(data)
    return tuple(done)


def known_rows(data: Dataset, actuators: Sequence[str]) -> KnownRows:
    """Return the rows by which copies of a data set are recognised once its table is gone.

    Joint values or commanded poses, and the measurements; at most :data:`KEPT` rows.
    """
    columns, table = _told(data, actuators)
    return KnownRows(data.source, data.kind.name, len(data), data.chance, columns, table
                     ).thinned(KEPT)


def _told(data: Dataset, actuators: Sequence[str]) -> tuple[tuple[str, ...], Array]:
    """Return names and values (N, c), SI, of a data set's commands and measurements."""
    if data.commanded is not None:
        parts = [(f"cmd_{n}", c) for n, c in zip(POSE_COORDINATES, data.commanded.T, strict=True)]
    else:
        parts = [(f"q_{a}", c) for a, c in zip(actuators, data.q.T, strict=True)]
    if data.to_q is not None:
        parts += [(f"to_q_{a}", c) for a, c in zip(actuators, data.to_q.T, strict=True)]
    parts += list(zip((*POSE_COORDINATES, "value"), _values(data).T, strict=True))
    parts = [(name, column) for name, column in parts if np.isfinite(column).any()]
    return tuple(n for n, _ in parts), np.column_stack([c for _, c in parts])


def among(data: Dataset, actuators: Sequence[str], known: KnownRows) -> Bools:
    """Return which rows (N,) are copies of known ones, within their digits and beyond chance."""
    again = np.zeros(len(data), dtype=bool)
    columns, table = _told(data, actuators)
    if data.kind.name != known.kind or columns != known.columns or not len(known.table):
        return again
    one, two = (np.nan_to_num(t, nan=0.5) for t in (known.table, table))
    again[partners(one, two, tolerances(one, two))[1]] = True
    if again.any() and _copied_count(again, max(data.chance, known.chance)):
        return again
    return np.zeros_like(again)


def count_among(data: Dataset, actuators: Sequence[str], known: Sequence[KnownRows]
                ) -> tuple[int, bool]:
    """Return the number of rows that are copies of known ones, and whether there may be more."""
    again = [(among(data, actuators, k), k.whole) for k in known]
    some = np.any([a for a, _ in again], axis=0) if again else np.zeros(len(data), dtype=bool)
    return int(some.sum()), any(a.any() and not whole for a, whole in again)


def without_known(several: Sequence[Dataset], actuators: Sequence[str],
                  known: Sequence[KnownRows], where: str) -> tuple[Dataset, ...]:
    """Return data sets without the rows that a calibration (``where``) has already used.

    Raises:
        BadInput: a data set without any row of its own, or copies among more rows than were kept.
    """
    out = list[Dataset]()
    for data in several:
        for seen in known:
            again = among(data, actuators, seen)
            if not again.any():
                continue
            if again.all() or not seen.whole:
                rows = "all rows" if again.all() else "rows"
                raise BadInput(f"is in that calibration already: {rows} are also in {seen.source}, "
                               "equal within their digits", data.source,
                               "Give new measurements only, or leave out --keep")
            data = _left_out(data, again, Note(f"{data.source}: "
                                               f"{pluralize(int(again.sum()), 'row')} also in "
                                               f"{seen.source}, already used by {where}, "
                                               "equal within their digits: each counts "
                                               "once.", topic="copies"))
        out.append(data)
    return tuple(out)


def _copied_count(again: Bools, chance: float) -> bool:
    """Whether true repeats (N,) would hardly agree so often."""
    from scipy.special import pdtrc  # reading files needs no scipy

    return bool(pdtrc(again.sum() - 1.0, again.size * chance) < BY_CHANCE)


def _left_out(data: Dataset, out: Bools, finding: Note) -> Dataset:
    dropped = [*data.dropped, *((int(n), REASON) for n in data.rows[out])]
    return replace(data.take(~out), findings=(*data.findings, finding),
                   dropped=tuple(sorted(dropped)))
