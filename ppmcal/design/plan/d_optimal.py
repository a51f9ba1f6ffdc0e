"""D-optimal choice of measurements: greedy, then excursions of exchanges.

Wanted is the design whose information on the wanted columns, prior included and open frames
and targets projected out, has the largest determinant (D_s-optimality; Silvey, Optimal
Design, 1980, section 3.1):

    D_s = log det M - log det M_nuisance,    M = P + sum over rows of J^T J.

A measurement is a block of m numbers, so that adding and removing one are updates of rank m
(Fedorov 1972): det(M +- J^T J) = det M det(I +- J M^-1 J^T), for all candidates at once.
Excursions leave the wanted size by some rows and come back (DETMAX, Mitchell, Technometrics
16, 1974): a design that an excursion passed in vain is not passed again in the same way, so
that each goes farther than the last, until one has gone too far.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.design.plan.information import CandidateInformation
from ppmcal.linalg import Array, Bools

LOOSE = 1e-3
"""Weight, per natural unit, that stands for no prior at all while rows are still too few: a
frame is known to about the reach."""
EXCURSION = 4
"""Excursions go this many rows above or below the wanted number, at most."""
MOST_MOVES = 600
"""Rows added and removed in one search, at most."""
REFRESH = 12
BETTER = 1e-9


@dataclass(frozen=True, eq=False)
class Rules:
    """How often a design may hold the same: each pose, or with ``by_row`` each row.

    ``most`` times, or, where that is None, no oftener than a design of that size needs.
    """

    by_row: bool
    most: int | None

    def allowed(self, offer: CandidateInformation, rows: Sequence[int]) -> Bools:
        """Return which rows may be added to a design (R,)."""
        label = np.arange(len(offer)) if self.by_row else np.unique(
            offer.pose, return_inverse=True)[1]
        count = np.bincount(label[list(rows)], minlength=int(label.max()) + 1)
        most = self.most or len(rows) // count.size + 1
        return np.asarray(count[label] < most)

    def sized(self, offer: CandidateInformation, count: int) -> Rules:
        """Return the rules for designs of one size."""
        units = len(offer) if self.by_row else np.unique(offer.pose).size
        return Rules(self.by_row, -(-count // units))


@dataclass(frozen=True, eq=False)
class _Block:
    """Information of a design on some columns: its inverse, and J M^-1 J^T of all rows."""

    jacobian: Array
    inverse: Array
    leverage: Array

    @classmethod
    def of(cls, jacobian: Array, prior: Array, rows: Sequence[int]) -> _Block:
        """Return it for a design, from scratch."""
        stacked = jacobian[list(rows)].reshape(-1, prior.size)
        matrix = stacked.T @ stacked + np.diag(np.where(prior > 0.0, prior, LOOSE) ** 2)
        d = 1.0 / np.sqrt(np.diagonal(matrix))
        root = linalg.inv(linalg.cholesky(matrix * np.outer(d, d))) * d
        half = jacobian @ root.T
        return cls(jacobian, root.T @ root, half @ np.swapaxes(half, -1, -2))

    def moved(self, row: int, sign: float) -> _Block:
        """Return it with one row more (sign +1) or less (-1), by an update of rank m."""
        own = self.jacobian[row]
        gain = self.inverse @ own.T
        core = sign * linalg.inv(np.eye(len(own)) + sign * (own @ gain))
        along = self.jacobian @ gain
        return _Block(self.jacobian, self.inverse - gain @ core @ gain.T,
                      self.leverage - along @ core @ np.swapaxes(along, -1, -2))

    def change(self, sign: float, rows: Sequence[int] | slice = slice(None)) -> Array:
        """Return how log det M changes with one row more or less, for all ``rows``."""
        own = self.leverage[rows]
        det = np.linalg.det(np.eye(own.shape[-1]) + sign * own)
        return np.asarray(np.log(np.maximum(det, 1e-300)))


@dataclass(frozen=True, eq=False)
class Design:
    """Chosen rows in the order of choice, and what all rows would add to them."""

    offer: CandidateInformation
    rows: tuple[int, ...]
    whole: _Block
    part: _Block | None
    age: int = 0

    @classmethod
    def of(cls, offer: CandidateInformation, rows: Sequence[int]) -> Design:
        """Return the design of some rows, computed from scratch."""
        open_ = offer.nuisance
        part = _Block.of(offer.jacobian[..., open_], offer.prior[open_], rows) if (
            open_.any()) else None
        return cls(offer, tuple(rows), _Block.of(offer.jacobian, offer.prior, rows), part)

    def added(self, row: int) -> Design:
        """Return the design with one row more."""
        rows = (*self.rows, row)
        return self._moved(rows, row, 1.0)

    def removed(self, row: int) -> Design:
        """Return the design without the last choice of one row."""
        rows = list(self.rows)
        del rows[len(rows) - 1 - rows[::-1].index(row)]
        return self._moved(tuple(rows), row, -1.0)

    def _moved(self, rows: tuple[int, ...], row: int, sign: float) -> Design:
        """Return the changed design, from scratch where an update would lose digits."""
        few = len(rows) * self.offer.jacobian.shape[1] < 3 * self.offer.prior.size
        if few or self.age >= REFRESH:
            return Design.of(self.offer, rows)
        return Design(self.offer, rows, self.whole.moved(row, sign),
                      self.part.moved(row, sign) if self.part else None, self.age + 1)

    def gains(self) -> Array:
        """Return by how much each row would raise D_s (R,)."""
        out = self.whole.change(1.0)
        return out - self.part.change(1.0) if self.part else out

    def cuts(self, aim: Array) -> Array:
        """Return by how much each row would lower trace(aim M^-1) (R,), ``aim`` (C, C).

        By the same update of rank m: trace((1 + J M^-1 J^T)^-1 J M^-1 aim M^-1 J^T).
        """
        half = self.offer.jacobian @ self.whole.inverse
        inner = linalg.solve(np.eye(half.shape[1]) + self.whole.leverage,
                                half @ aim @ np.swapaxes(half, -1, -2))
        return np.asarray(np.trace(inner, axis1=-2, axis2=-1))

    def losses(self) -> Array:
        """Return by how much D_s would fall without each row of the design (n,)."""
        rows = list(self.rows)
        out = -self.whole.change(-1.0, rows)
        return out + self.part.change(-1.0, rows) if self.part else out


def log_det(offer: CandidateInformation, rows: Sequence[int]) -> float:
    """Return D_s of a design, from scratch."""
    def log_det(columns: Bools) -> float:
        prior = offer.prior[columns]
        stacked = offer.jacobian[list(rows)][..., columns].reshape(-1, prior.size)
        matrix = np.concatenate([stacked, np.diag(np.where(prior > 0.0, prior, LOOSE))])
        diagonal = np.abs(np.diagonal(linalg.triangle(matrix)))
        return 2.0 * float(np.sum(np.log(diagonal)))

    everything = np.ones(offer.prior.size, dtype=np.bool_)
    return log_det(everything) - (log_det(offer.nuisance) if offer.nuisance.any() else 0.0)


def greedy(
    offer: CandidateInformation, count: int, rules: Rules, start: Sequence[int] = ()
) -> tuple[int, ...]:
    """Return ``count`` rows, each the best one to add to those before it."""
    design = Design.of(offer, start)
    while len(design.rows) < count:
        best = _best(design, rules)
        if best is None:
            break
        design = design.added(best)
    return design.rows


def pruned(offer: CandidateInformation, rows: Sequence[int]) -> tuple[int, ...]:
    """Return rows in an order whose first n are what is left when the least useful go first.

    Taken out of a good design one by one, they make better small designs than rows that are
    put one upon the other, where the first few are chosen before anything is determined.
    """
    design, order = Design.of(offer, rows), list[int]()
    while design.rows:
        order.append(design.rows[int(np.argmin(design.losses()))])
        design = design.removed(order[-1])
    return tuple(reversed(order))


def exchange(
    offer: CandidateInformation,
    start: Sequence[int],
    rules: Rules,
    rng: np.random.Generator,
    excursion: int = EXCURSION,
) -> tuple[int, ...]:
    """Return the best design that excursions from ``start`` find; as large, never worse."""
    best, value = Design.of(offer, start), log_det(offer, start)
    failed: set[tuple[int, ...]] = set()
    spent, exhausted = 0, set[int]()
    while spent < MOST_MOVES and len(exhausted) < 2:
        first = int(rng.choice([s for s in (1, -1) if s not in exhausted]))
        found, passed, moves, far = _excursion(best, first, rules, failed, excursion)
        spent += moves
        reached = log_det(offer, found.rows) if found is not None else -np.inf
        if found is not None and reached > value + BETTER * max(1.0, abs(value)):
            best, value = Design.of(offer, found.rows), reached
            failed, exhausted = set(), set()
        else:
            failed |= passed
            exhausted |= {first} if far else set()
    return best.rows


def _excursion(start: Design, first: int, rules: Rules, failed: set[tuple[int, ...]],
               most: int) -> tuple[Design | None, set[tuple[int, ...]], int, bool]:
    """Follow one excursion until it is back at its size.

    Returns:
        the design it ends in or None, designs passed, moves made, whether it went too far.
    """
    size, design, way = len(start.rows), start, first
    passed: set[tuple[int, ...]] = set()
    for moves in range(1, 4 * most + 1):
        row = _best(design, rules) if way > 0 else _worst(design)
        if row is None:
            return None, passed, moves, True
        design = design.added(row) if way > 0 else design.removed(row)
        away = len(design.rows) - size
        if away == 0:
            return design, passed, moves, False
        if abs(away) > most:
            return None, passed, moves, True
        key = tuple(sorted(design.rows))
        back = -1 if away > 0 else 1
        way = -back if key in failed or key in passed else back
        passed.add(key)
    return None, passed, moves, True


def _best(design: Design, rules: Rules) -> int | None:
    """Return the row that is best to add, the first of equals, None where none may be."""
    allowed = rules.allowed(design.offer, design.rows)
    if not allowed.any():
        return None
    return int(np.argmax(np.where(allowed, design.gains(), -np.inf)))


def _worst(design: Design) -> int | None:
    """Return the row of the design that is missed least."""
    if len(design.rows) < 2:
        return None
    return design.rows[int(np.argmin(design.losses()))]
