"""What may have changed between two sessions of a machine, and which of it explains a misfit.

An explanation is some columns of the misfit: one parameter, all of one kind by the same amount,
joints homed again, an instrument or a flat that moved. Which of them are in the misfit is decided
as elsewhere: by a posterior over sets of them, including nothing and something unlisted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.sessions.session_posteriors import SHAPES
from ppmcal.inference.blocks import Block
from ppmcal.inference.columns import MatrixColumns
from ppmcal.inference.priors import ALL_ALIKE, MOVED, SELDOM, SURE, UNKNOWN, WIDE
from ppmcal.inference.question import Question
from ppmcal.inference.sets import posterior
from ppmcal.linalg import Array
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording import actuator_list

PARALLEL = 1.0 - 1e-6
UNLISTED = "something that is not listed"


@dataclass(frozen=True, eq=False)
class Explanation:
    """Something that may have changed.

    ``columns``: for each of its numbers what moves by one natural unit, name -> weight;
    ``parts``: names of its numbers; ``share``: its part of the prior of changes;
    ``group``: explanations with a common cause share it, like that of a block.
    """

    name: str
    columns: tuple[dict[str, float], ...]
    parts: tuple[str, ...]
    share: float
    group: str = ""


@dataclass(frozen=True, eq=False)
class TakenExplanation:
    """An explanation that was chosen: values and covariance of its numbers in natural units.

    ``probability``: that it is this one; ``instead``: names of its alternatives.
    """

    explanation: Explanation
    value: Array
    covariance: Array
    probability: float
    instead: tuple[str, ...]


@dataclass(frozen=True, eq=False)
class Explained:
    """The explanation of a misfit.

    ``taken``: changes with a name; ``nothing``: probability that nothing changed; ``unlisted``:
    that something not listed changed, alone or beside the others.
    """

    taken: tuple[TakenExplanation, ...]
    nothing: float
    unlisted: float


def explanations(mechanism: Mechanism, parameters: Sequence[str], session: Sequence[str],
                 defining: Sequence[str] = ()) -> list[Explanation]:
    """Return everything that may have changed.

    Args:
        mechanism: names joints and limbs.
        parameters: names of those that both calibrations had free.
        session: candidates that both sessions took as known, as in
            :class:`prior_information.SessionKnowledge`.
        defining: names of those that define their frames, which may move like any other.
    """
    single = (*parameters, *defining)
    kind = {n: mechanism.parameters[mechanism.names.index(n)].tolerance_class for n in single}
    one = 1.0 - float(ALL_ALIKE)
    dimensions = max(1, sum(k != "offset" for k in kind.values()))
    out = [Explanation(n, ({n: 1.0},), (n,), *((one / len(mechanism.actuators), "zeros")
                       if kind[n] == "offset" else (one * float(SELDOM) / dimensions, kind[n])))
           for n in single]
    out += _homing(mechanism, session)
    out += _pulls(mechanism, session)
    out += _together(mechanism, parameters, kind)
    data = dict.fromkeys(n.partition(" of ")[2] for n in session)    # the session itself is one
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
            share = 1.0 if kind[own[0]] == "offset" else float(SELDOM) / len(suffixes)
            out.append(Explanation(f"{suffix} of all limbs alike", (dict.fromkeys(own, 1.0),),
                                   (suffix,), float(ALL_ALIKE) * share))
    return out


def _homing(mechanism: Mechanism, session: Sequence[str]) -> list[Explanation]:
    """Return joints homed again: each, all by the same amount, all."""
    own = [n for n in session if n.startswith("homing.")]
    if not own:
        return []
    names = [n.partition(" of ")[0].removeprefix("homing.") for n in own]
    out = [Explanation(f"homing of {a}", ({n: 1.0},), (a,), (1.0 - float(ALL_ALIKE)) / len(own),
                       "zeros") for a, n in zip(names, own, strict=True)]
    if len(own) > 1:
        if len(set(mechanism.joint_units)) == 1:
            out.append(Explanation("homing of all joints alike", (dict.fromkeys(own, 1.0),),
                                   ("all joints",), 0.5 * float(ALL_ALIKE)))
        out.append(Explanation("homing of every joint", tuple({n: 1.0} for n in own),
                               tuple(names), 0.5 * float(ALL_ALIKE)))
    return out


def _pulls(mechanism: Mechanism, session: Sequence[str]) -> list[Explanation]:
    """Return ropes that pull with another force: by any kind of effect, on any of its sets."""
    out = []
    for kind in effect_kinds().values():
        own = [n for n in session if kind.opposed and n.startswith(f"{kind.name}.")]
        for n in own:
            ropes, _, part = n.partition(" of ")[0].removeprefix(f"{kind.name}.").rpartition(".")
            on = actuator_list(ropes.split("+"), len(mechanism.actuators))
            out.append(Explanation(f"{kind.label} on {on}", ({n: 1.0},), (part,), 1.0 / len(own),
                                   kind.name))
    return out


def _instrument(own: Sequence[str], where: str) -> list[Explanation]:
    """Return possible changes of one data set: its flat or instrument, target, body and scale."""
    by = {n.partition(" of ")[0]: n for n in own}
    out = []

    def take(label: str, parts: Sequence[str], share: float, least: int = 1,
             sign: float = 1.0) -> None:
        there = [p for p in parts if p in by]
        if len(there) >= least:
            out.append(Explanation(label + where, tuple({by[p]: sign} for p in there),
                                   tuple(p.rpartition(".")[2] for p in there), share))

    shift, turn = (tuple(f"frame.{c}" for c in cs) for cs in (("x", "y", "z"), ("rx", "ry", "rz")))
    spin = tuple(f"target_rotation.{c}" for c in ("rx", "ry", "rz"))
    point = tuple(f"target.{c}" for c in "xyz")
    if f"shape.{SHAPES[0]}" in by:
        # the frame is the machine's in the bed; the bed moves the other way
        take("height of the bed", ("frame.z",), 1.0 / 3.0, 1, -1.0)
        take("tilt of the bed", turn, 1.0 / 3.0, 2, -1.0)
        take("height and tilt of the bed", ("frame.z", *turn), 1.0 / 3.0, 3, -1.0)
        take("shape of the bed", tuple(f"shape.{s}" for s in SHAPES), float(SELDOM), 3, -1.0)
    else:
        take("instrument shifted", shift, 0.5, 2)
        take("instrument moved", (*shift, *turn), 0.5, 3)
    take("measured point on the platform", point, 1.0 / 3.0)
    take("rotation of the measured body", spin, 1.0 / 3.0)
    if any(p in by for p in spin):
        take("measured body defined anew", (*point, *spin), 1.0 / 3.0, 2)
    take("scale of the measurements", ("scale",), float(SELDOM))
    return out


def explained_by(candidates: Sequence[Explanation], columns: Sequence[Array], misfit: Array,
                 known: float) -> Explained:
    """Return the explanation of a misfit.

    Args:
        candidates: what may have changed.
        columns: of each, the derivative of the misfit by its numbers (d, n), natural units.
        misfit: white (d,).
        known: number of values from which the size of its noise is known.
    """
    candidates, columns = _distinct(candidates, columns)
    count, size = misfit.size, [c.shape[1] for c in columns]
    first = np.cumsum([0, *size]).tolist()
    blocks = [Block(c.name, c.name, tuple(range(at, at + n)),
                    float(np.log(float(MOVED) * c.share)), low=-float(WIDE), high=float(WIDE),
                    group=c.group)
              for c, at, n in zip(candidates, first, size, strict=False)]
    blocks.append(Block(UNLISTED, UNLISTED, tuple(range(first[-1], first[-1] + count)),
                        float(np.log(float(UNKNOWN)))))
    found = posterior(Question(
        MatrixColumns(np.concatenate([*columns, np.eye(count)], axis=1)), misfit,
        np.zeros((count, 0)), tuple(blocks), np.ones((count, 1), dtype=bool),
        np.zeros(count - 1, dtype=np.int64), known=known))
    likely = {i: found.likely(n, float(SURE)) for n, i in enumerate(found.best.chosen)}
    sure = [i for i, members in likely.items() if i < len(candidates) and not any(
        m.probability > 1.0 - float(SURE) for m in members if not m.family)]
    fit = linalg.pinv(np.concatenate([np.zeros((count, 0)), *(columns[i] for i in sure)], axis=1),
                      rcond=1e-9)
    taken, at = [], 0
    for i in sure:
        own, at = fit[at:at + size[i]], at + size[i]
        name = candidates[i].name
        mine = sum(m.probability for m in likely[i] if m.family == name)
        taken.append(TakenExplanation(candidates[i], own @ misfit, own @ own.T, mine, tuple(
            m.family for m in likely[i] if m.family not in ("", name))))
    return Explained(tuple(taken), found.nothing(), float(found.probability[-1]))


def _distinct(candidates: Sequence[Explanation], columns: Sequence[Array]
              ) -> tuple[list[Explanation], list[Array]]:
    """Leave out homing that is equivalent to an offset, and offsets equivalent to homing of all."""
    keep: list[int] = []
    for i, c in enumerate(candidates):
        if not any({"homing", "offset"} == {w for w in ("homing", "offset")
                                           for n in (c.name, candidates[k].name) if w in n}
                   and len(c.columns) == len(candidates[k].columns) == 1
                   and _alike(columns[i][:, 0], columns[k][:, 0]) for k in keep):
            keep.append(i)
    return [candidates[i] for i in keep], [columns[i] for i in keep]


def _alike(a: Array, b: Array) -> bool:
    return bool(abs(a @ b) > PARALLEL * np.linalg.norm(a) * np.linalg.norm(b) > 0.0)
