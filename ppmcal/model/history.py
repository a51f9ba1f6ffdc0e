"""The history of a machine before each row: the rows of a file in the order of their visit.

Effects with memory depend on everything before. Two operators are enough: play, for a drive that
has to cross a gap before it moves the load, and a first-order lag, for heat and creep. Both are
compositions of simple maps (clamps, affine maps), and composition is associative: after log2 H
doublings every row has the composition of all maps up to it (parallel prefix; Blelloch, Prefix
sums and their applications, 1990), with no loop over rows.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from ppmcal.linalg import Array, Bools, Ints

MOST_KEPT = 64
"""Results that a history caches: a fit needs the same ones repeatedly."""
DIRECT = 0.05
"""A joint moved straight from row to row if at most this part of its recorded directions differ."""


@dataclass(frozen=True, eq=False)
class History:
    """The H rows of a file in the order of their visit, SI; nan where not recorded.

    Attributes:
        q: joint values (H, k).
        time: s (H,), never decreasing; all nan if unknown.
        temperature: K above 20 degrees Celsius (H,).
        wrench: on the platform (H, 6), and ``weight`` (H, 3), the payload's part of it.
        direct: whether a joint moved straight from row to row (k,), so that its path is known.
    """

    q: Array
    time: Array
    temperature: Array
    wrench: Array
    weight: Array
    direct: Bools
    _kept: dict[tuple[object, ...], tuple[Array, Array]] = field(default_factory=dict, repr=False)

    @property
    def timed(self) -> bool:
        """Whether the times of all rows are known."""
        return bool(np.isfinite(self.time).all())

    def slack(self, half: Array) -> tuple[Array, Array]:
        """Return play's output minus its input (H, k), and its derivative by the half width.

        ``half``: half width by joint (k,), unit of q, not negative. See :func:`slack`.
        """
        key = ("slack", *half.tolist())
        return self._once(key, lambda: slack(np.where(self.direct, self.q, np.nan), half))

    def unsettled(self, half: Array, start: float = 1.0) -> Array:
        """Return how far play's output may be from that assumed by :func:`slack` (H, k), unit q.

        ``half``: half width by joint (k,), unit of q, not negative. ``start``: state of play
        before the first row, -1 to 1 half widths off; 1 gives the largest deviation.
        """
        def spread() -> tuple[Array, Array]:
            u = np.where(self.direct, self.q, np.nan)
            (low, high), _ = _bounds(u, half)
            with np.errstate(invalid="ignore"):
                at = np.clip(_first(u) + start * half, low, high)
                return np.where(np.isfinite(u), at - 0.5 * low - 0.5 * high, np.nan), np.zeros(0)

        return self._once(("unsettled", start, *half.tolist()), spread)[0]

    def lagged(self, of: str, drive: Callable[[], Array], tau: float) -> tuple[Array, Array]:
        """Return a state that lags behind ``drive`` (H,) or (H, k), and its derivative by tau, s.

        ``of``: name of the drive. See :func:`lagged`.
        """
        return self._once((of, tau), lambda: lagged(self.time, drive(), tau))

    def once(self, what: str, found: Callable[[], Array]) -> Array:
        """Return the result of ``found``, computed once and cached under ``what``."""
        return self._once((what,), lambda: (found(), np.zeros(0)))[0]

    def rate(self) -> Array:
        """Return each joint's mean speed on the way to each row (H, k), unit of q per second."""
        known = np.isfinite(self.q)
        at = np.maximum.accumulate(np.where(known, np.arange(len(self.q))[:, None], 0), axis=0)
        travel = np.abs(np.diff(np.take_along_axis(self.q, at, axis=0), axis=0, prepend=np.nan))
        step = np.diff(self.time, prepend=self.time[:1])[:, None]
        return np.where((step > 0.0) & np.isfinite(travel), travel / np.where(
            step > 0.0, step, 1.0), 0.0 * step)

    def moved(self) -> Array:
        """Return how far each joint moved from the previous row (H, k), 0 at first; unit of q.

        nan where not recorded, or where the joint did not move straight.
        """
        step = np.diff(self.q, axis=0, prepend=self.q[:1])
        return np.where(self.direct, step, np.nan)

    def _once(self, key: tuple[object, ...], make: Callable[[], tuple[Array, Array]]
              ) -> tuple[Array, Array]:
        if key not in self._kept:
            while len(self._kept) >= MOST_KEPT:
                del self._kept[next(iter(self._kept))]
            self._kept[key] = make()
        return self._kept[key]


def history_of(q: Array, time: Array, temperature: Array, wrench: Array, weight: Array,
               sequence: bool) -> tuple[History | None, Ints]:
    """Return the history of N rows, and each row's index in it, -1 if not part of it.

    Args:
        q: joint values (N, k), nan where not known.
        time: s (N,).
        temperature: K above 20 degrees Celsius (N,).
        wrench: on the platform (N, 6).
        weight: the payload's part of its force (N, 3).
        sequence: the rows were visited in file order; otherwise the times give the order.

    None if neither gives the order. With ``sequence``, times that decrease are ignored.
    """
    n = len(q)
    if sequence:
        order = np.arange(n)
        known = bool(np.isfinite(time).all() and np.all(np.diff(time) >= 0.0))
        times = time if known else np.full(n, np.nan)
    else:
        timed = np.flatnonzero(np.isfinite(time))
        order = timed[np.argsort(time[timed], kind="stable")]
        times = time[order]
    place = np.full(n, -1, dtype=np.int64)
    place[order] = np.arange(order.size)
    if not order.size:
        return None, place
    if not (order.size == n and np.all(np.diff(order) == 1)):   # else no copy is needed
        q, temperature, wrench, weight = (v[order] for v in (q, temperature, wrench, weight))
    return History(q, times, temperature, wrench, weight,
                   np.asarray(np.isfinite(q).any(axis=0))), place


def ways(q: Array) -> Array:
    """Return the direction from the previous row (N, k), +-1; a joint at rest keeps its last.

    nan until a joint first moves; missing values are skipped.

    >>> ways(np.array([[1.0], [2.0], [np.nan], [2.0], [1.5]])).ravel().tolist()
    [nan, 1.0, 1.0, 1.0, -1.0]
    """
    if not len(q):
        return np.array(q)
    rows = np.arange(len(q))[:, None]
    known = np.isfinite(q)
    seen = np.maximum.accumulate(np.where(known, rows, -1), axis=0)
    before = np.concatenate([np.full((1, q.shape[1]), -1), seen])[:len(q)]
    start = np.take_along_axis(q, np.maximum(before, 0), axis=0)
    move = np.where(known & (before >= 0), np.sign(np.where(known, q, 0.0) - start), 0.0)
    last = np.maximum.accumulate(np.where(move != 0.0, rows, -1), axis=0)
    found = np.take_along_axis(move, np.maximum(last, 0), axis=0)
    return np.where(last >= 0, found, np.nan)


def straight(history: History, place: Ints, approach: Array) -> Bools:
    """Return which joints' recorded directions (N, k) agree with the order of the rows (k,).

    Where they do not, a joint also moved between the rows, by an unknown amount.
    """
    told = ways(history.q)[place]
    both = np.isfinite(told) & np.isfinite(approach) & (place >= 0)[:, None]
    other = both & (np.sign(approach) != told)
    return np.asarray(other.sum(axis=0) <= DIRECT * np.maximum(both.sum(axis=0), 1))


def slack(u: Array, half: Array) -> tuple[Array, Array]:
    """Return play's output minus its input (H, k), and its derivative by the half width.

    p_k = max(u_k - h, min(u_k + h, p_(k-1))): the output p stays until the input u has crossed the
    gap (Krasnosel'skii and Pokrovskii, Systems with hysteresis, 1989). The state before the first
    row is unknown: until u has spanned a full width, p is the middle of its possible range.

    Args:
        u: input (H, k); nan rows are skipped.
        half: half widths h (k,), not negative.
    """
    known = np.isfinite(u)
    (low, high), (by_low, by_high) = _bounds(u, half)
    with np.errstate(invalid="ignore"):
        out = 0.5 * (low - u) + 0.5 * (high - u)
    return np.where(known, out, np.nan), np.where(known, 0.5 * (by_low + by_high), np.nan)


def _first(u: Array) -> Array:
    """Return the first known value of each joint (k,), nan if there is none."""
    at = np.argmax(np.isfinite(u), axis=0)
    return np.asarray(u[at, np.arange(u.shape[1])])


def _bounds(u: Array, half: Array) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Return the lower and upper bounds of play's output (H, k), and d/d half of both."""
    known = np.isfinite(u)
    low, high = np.where(known, u - half, -np.inf), np.where(known, u + half, np.inf)
    by_low, by_high = -1.0 * known, 1.0 * known
    step = 1
    while step < len(u):
        ends = []
        for end, slope in ((low, by_low), (high, by_high)):
            before, behind = end[:-step], slope[:-step]
            under, over = before < low[step:], before > high[step:]
            ends.append((np.where(under, low[step:], np.where(over, high[step:], before)),
                         np.where(under, by_low[step:], np.where(over, by_high[step:], behind))))
        (low, by_low), (high, by_high) = (
            (np.concatenate([a[:step], b]), np.concatenate([c[:step], d]))
            for (b, d), (a, c) in zip(ends, ((low, by_low), (high, by_high)), strict=True))
        step *= 2
    return (low, high), (by_low, by_high)


def lagged(time: Array, drive: Array, tau: float) -> tuple[Array, Array]:
    """Return the state x (H, ...) of x' = (drive - x)/tau, and its derivative by tau, per s.

    Each row's drive is held over the step before it, for which exp(-dt/tau) is exact, however
    long. The state starts at the first drive: before the first row everything is in equilibrium.

    Args:
        time: s (H,), not decreasing.
        drive: (H, ...); nan rows are skipped.
        tau: s; 0 or less: the state is the drive.
    """
    if tau <= 0.0:
        return drive, np.zeros_like(drive)
    known = np.isfinite(drive)
    when = np.where(known, time.reshape(-1, *[1] * (drive.ndim - 1)), -np.inf)
    last = np.maximum.accumulate(when, axis=0)
    with np.errstate(invalid="ignore"):
        step = np.concatenate([np.full_like(last[:1], np.inf), last[1:] - last[:-1]])
    first = known & (np.cumsum(known, axis=0) == 1)
    step = np.where(first, np.inf, np.where(known, step, 0.0))
    stays = np.exp(-step / tau)
    held = np.where(known, drive, 0.0)
    state = _affine(stays, (1.0 - stays) * held)
    before = np.concatenate([np.zeros_like(state[:1]), state[:-1]])
    slower = stays * np.where(np.isfinite(step), step, 0.0) / tau**2
    slope = _affine(stays, slower * (before - held))
    return np.where(known, state, np.nan), np.where(known, slope, np.nan)


def _affine(factor: Array, add: Array) -> Array:
    """Return x (H, ...) of x_k = factor_k x_(k-1) + add_k, with x = 0 before the first."""
    step = 1
    while step < len(add):
        add = np.concatenate([add[:step], factor[step:] * add[:-step] + add[step:]])
        factor = np.concatenate([factor[:step], factor[step:] * factor[:-step]])
        step *= 2
    return add
