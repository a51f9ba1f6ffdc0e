"""What may have changed between two sessions of a machine, and which of it explains a misfit best.

An explanation is some columns of the misfit: one parameter, all of one kind by the same amount,
joints homed anew, an instrument or a flat that moved. It is judged by what it takes off
chi-squared, less what so many numbers cost (Schwarz 1978) and how rarely such things happen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.sessions.session_posteriors import SHAPES
from ppmcal.linalg import Array, svd
from ppmcal.model.mechanism import Mechanism

CHANGED = 0.01
"""A change is named where chance would show one this rarely among all explanations."""
AS_GOOD = 6.0
"""An explanation is tied with the best where twice the logarithm of their odds differ by less."""
VISIBLE = 1e-3
"""A change counts as seen where one natural unit of it makes so many standard deviations."""
FEWEST = 8.0
"""A further number costs at least what it does with so many rows."""
WHOLE = 0.2
"""An explanation is none beside others that explain all but this part of what it would do."""
PARALLEL = 1.0 - 1e-6
RARE = 0.1
"""Odds of a change of dimensions against one of homing or of where the instrument stands."""
MANY = 0.1
"""Odds of what takes many numbers: where it is so, it is plain to see."""
UNTOLD = 1.0
"""Explanations that take off chi-squared alike, to so much, are not told apart by the data."""


@dataclass(frozen=True, eq=False)
class Explanation:
    """Something that may have changed.

    ``columns``: what moves by one natural unit, name -> weight, for each of its numbers;
    ``parts``: what these are called; ``odds``: how common it is, bare.
    """

    name: str
    columns: tuple[dict[str, float], ...]
    parts: tuple[str, ...]
    odds: float


@dataclass(frozen=True, eq=False)
class TakenExplanation:
    """An explanation that is taken: values and covariance of its numbers in natural units.

    ``p_value``: how often noise would ask for one as much, among all; ``instead``: names of those
    tied with it.
    """

    explanation: Explanation
    value: Array
    covariance: Array
    p_value: float
    instead: tuple[str, ...]


def explanations(mechanism: Mechanism, parameters: Sequence[str], session: Sequence[str]
                 ) -> list[Explanation]:
    """Return everything that may have changed.

    Args:
        mechanism: names joints and limbs.
        parameters: names of those that both calibrations had free.
        session: candidates that both sessions took for known, as in
            :class:`posterior.SessionKnowledge`.
    """
    kind = {n: mechanism.parameters[mechanism.names.index(n)].tolerance_class for n in parameters}
    joints = len(mechanism.actuators)
    dimensions = max(1, sum(k != "offset" for k in kind.values()))
    out = [Explanation(n, ({n: 1.0},), (n,), 1.0 / joints if kind[n] == "offset"
                       else RARE / dimensions) for n in parameters]
    out += _together(mechanism, parameters, kind)
    out += _homing(mechanism, session)
    data = dict.fromkeys(n.partition(" of ")[2] for n in session)
    for name in data:
        own = [n for n in session if n.partition(" of ")[2] == name]
        out += _instrument(own, f" of {name}" if len(data) > 2 else "")
    return out


def _together(mechanism: Mechanism, parameters: Sequence[str], kind: dict[str, str]
              ) -> list[Explanation]:
    """Return changes of all lengths, radii or scales of limbs by the same amount."""
    out = []
    suffixes = dict.fromkeys(n.partition(".")[2] for n in parameters)
    limbs = {limb.name for limb in mechanism.limbs}
    for suffix in suffixes:
        own = [n for n in parameters if n.partition(".")[2] == suffix
               and n.partition(".")[0] in limbs]
        alike = suffix.endswith("radius") or all(kind[n] in ("length", "offset", "ratio")
                                                 for n in own)
        if suffix and len(own) > 1 and alike:
            scale = 1.0 if kind[own[0]] == "offset" else RARE
            out.append(Explanation(f"{suffix} of all limbs alike", (dict.fromkeys(own, 1.0),),
                                   (suffix,), scale))
    return out


def _homing(mechanism: Mechanism, session: Sequence[str]) -> list[Explanation]:
    """Return joints homed anew: each, all by the same amount, all."""
    own = [n for n in session if n.startswith("homing.")]
    if not own:
        return []
    names = [n.partition(" of ")[0].removeprefix("homing.") for n in own]
    out = [Explanation(f"homing of {a}", ({n: 1.0},), (a,), 1.0 / len(own))
           for a, n in zip(names, own, strict=True)]
    if len(own) > 1:
        if len(set(mechanism.joint_units)) == 1:
            out.append(Explanation("homing of all joints alike", (dict.fromkeys(own, 1.0),),
                                   ("all joints",), 1.0))
        out.append(Explanation("homing of every joint", tuple({n: 1.0} for n in own),
                               tuple(names), MANY))
    return out


def _instrument(own: Sequence[str], where: str) -> list[Explanation]:
    """Return what may be about one data set: its flat or instrument, target, body and scale."""
    by = {n.partition(" of ")[0]: n for n in own}
    out = []

    def take(label: str, parts: Sequence[str], odds: float, least: int = 1, sign: float = 1.0
             ) -> None:
        there = [p for p in parts if p in by]
        if len(there) >= least:
            out.append(Explanation(label + where, tuple({by[p]: sign} for p in there),
                                   tuple(p.rpartition(".")[2] for p in there), odds))

    shift, turn = (tuple(f"frame.{c}" for c in cs) for cs in (("x", "y", "z"), ("rx", "ry", "rz")))
    spin = tuple(f"target_rotation.{c}" for c in ("rx", "ry", "rz"))
    point = tuple(f"target.{c}" for c in "xyz")
    if f"shape.{SHAPES[0]}" in by:
        # the frame is the machine's in the bed's; the bed moves the other way
        take("height of the bed", ("frame.z",), 1.0, 1, -1.0)
        take("tilt of the bed", turn, 0.5, 2, -1.0)
        take("height and tilt of the bed", ("frame.z", *turn), 0.3, 3, -1.0)
        take("shape of the bed", tuple(f"shape.{s}" for s in SHAPES), RARE, 3, -1.0)
    else:
        take("instrument shifted", shift, 0.5, 2)
        take("instrument moved", (*shift, *turn), 1.0, 3)
    take("measured point on the platform", point, 0.5)
    take("rotation of the measured body", spin, 0.5)
    if any(p in by for p in spin):
        take("measured body defined anew", (*point, *spin), 1.0, 2)
    take("scale of the measurements", ("scale",), RARE)
    return out


def best_of(candidates: Sequence[Explanation], columns: Sequence[Array], misfit: Array,
            rows: float, chance: Callable[[float, int], float]
            ) -> tuple[list[TakenExplanation], Array]:
    """Return the likeliest explanations of a misfit, and what they leave of it (d,).

    The likeliest is added until none is needed; what is not needed any more is dropped.

    Args:
        candidates: what may have changed.
        columns: of each, how the misfit moves by its numbers (d, n), natural units.
        misfit: white (d,).
        rows: how many measured numbers are behind it: what a further number costs.
        chance: how often noise takes as much off chi-squared with so many numbers.
    """
    candidates, columns = _distinct(candidates, columns)
    chosen: list[int] = []
    while True:
        trial = _Trial.of(columns, misfit, chosen, candidates, rows)
        p = np.array([chance(g, k) * len(candidates) if k and i not in chosen else np.inf
                      for i, (g, k) in enumerate(zip(trial.gain, trial.rank, strict=True))])
        if misfit.size <= sum(columns[c].shape[1] for c in chosen) or not (p < CHANGED).any():
            break
        chosen.append(int(np.argmax(np.where(p < CHANGED, trial.score, -np.inf))))
    for c in list(chosen):
        trial = _Trial.of(columns, misfit, [o for o in chosen if o != c], candidates, rows)
        if len(chosen) > 1 and chance(trial.gain[c], trial.rank[c]) * len(candidates) > CHANGED:
            chosen.remove(c)
    found = []
    for c in chosen:
        others = [o for o in chosen if o != c]
        trial = _Trial.of(columns, misfit, others, candidates, rows)
        tied = [i for i in np.argsort(-trial.score, kind="stable").tolist()
                if i not in chosen and trial.tied(i, c)]
        rest, left = without(columns[c], misfit, [columns[o] for o in others])
        inverse = linalg.pinv(rest, rcond=1e-9)
        p_value = min(1.0, chance(trial.gain[c], trial.rank[c]) * len(candidates))
        found.append(TakenExplanation(candidates[c], inverse @ left, inverse @ inverse.T, p_value,
                                      tuple(candidates[i].name for i in tied)))
    return found, without(columns[0][:, :0], misfit, [columns[c] for c in chosen])[1]


def _distinct(candidates: Sequence[Explanation], columns: Sequence[Array]
              ) -> tuple[list[Explanation], list[Array]]:
    """Leave out homing that is nothing but an offset, and offsets that are homing of all."""
    keep: list[int] = []
    for i, c in enumerate(candidates):
        homing = c.name.startswith("homing of ")
        twin = [k for k in keep if len(c.columns) == len(candidates[k].columns) == 1 and homing
                and "offset" in candidates[k].name and _alike(columns[i][:, 0], columns[k][:, 0])]
        if twin and c.name == "homing of all joints alike":
            keep = [k for k in keep if k not in twin]
        elif twin:
            continue
        keep.append(i)
    return [candidates[i] for i in keep], [columns[i] for i in keep]


def _alike(a: Array, b: Array) -> bool:
    return bool(abs(a @ b) > PARALLEL * np.linalg.norm(a) * np.linalg.norm(b) > 0.0)


@dataclass(frozen=True)
class _Trial:
    """What each explanation would take off chi-squared, by how many numbers, and its score."""

    gain: Array
    rank: list[int]
    score: Array

    @classmethod
    def of(cls, columns: Sequence[Array], misfit: Array, chosen: Sequence[int],
           candidates: Sequence[Explanation], rows: float) -> _Trial:
        taken = [columns[c] for c in chosen]
        gain, rank = np.zeros(len(columns)), [0] * len(columns)
        for i, block in enumerate(columns):
            rest, left = without(block, misfit, taken)
            if np.any(np.linalg.norm(rest, axis=0) < WHOLE * np.linalg.norm(block, axis=0)):
                continue
            u, s, _ = svd(rest)
            u = u[:, s > VISIBLE]
            gain[i], rank[i] = float(np.sum((u.T @ left) ** 2)), u.shape[1]
        odds = np.array([c.odds for c in candidates])
        cost = np.array(rank) * np.log(max(rows, FEWEST))
        return cls(gain, rank, gain - cost + 2.0 * np.log(odds))

    def tied(self, one: int, other: int) -> bool:
        """Whether an explanation is as likely as another, or the data do not tell the two apart."""
        near = bool(self.score[one] > self.score[other] - AS_GOOD)
        same = self.rank[one] == self.rank[other] and bool(
            abs(self.gain[one] - self.gain[other]) < UNTOLD)
        return self.rank[one] > 0 and (near or same)


def without(columns: Array, misfit: Array, taken: Sequence[Array]) -> tuple[Array, Array]:
    """Return columns (d, n) and misfit (d,) with what other columns explain taken out."""
    if not taken:
        return columns, misfit
    block = np.concatenate(taken, axis=1)
    u, s, _ = svd(block)
    q = u[:, s > 1e-9 * s.max(initial=1e-300)]
    rest = columns - q @ (q.T @ columns)
    length = np.linalg.norm(columns, axis=0)
    gone = np.linalg.norm(rest, axis=0) < 1e-6 * np.maximum(length, 1e-300)
    return np.where(gone, 0.0, rest), misfit - q @ (q.T @ misfit)
