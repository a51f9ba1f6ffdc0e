"""The effect kind of a learned function: see :mod:`ppmcal.model.effects.learned_curve`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.errors import BadInput, unknown
from ppmcal.linalg import Array
from ppmcal.model.effects.inputs import (
    DIRECTION,
    LOAD,
    MOVE,
    POSE,
    TEMPERATURE,
    TRAVEL,
    VELOCITY,
)
from ppmcal.model.effects.inputs import TIME as TIME_INPUT
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    FromFile,
    Worked,
    fixed_list,
    register,
)
from ppmcal.model.effects.learned_curve import (
    INPUTS,
    JOINT,
    LearnedCurve,
    LearnedInput,
    si_factor,
    spline_basis,
)
from ppmcal.model.effects.setting import PLACE
from ppmcal.model.motions import Motion
from ppmcal.units import Units

MOST_NODES = 200
SYMMETRIC = 1e-6
"""A covariance may be asymmetric or have negative eigenvalues by this part of its largest entry."""
FOLLOWED = {"travel": TRAVEL, "velocity": VELOCITY, "last move": MOVE,
            "load": LOAD, "temperature": TEMPERATURE,
            "time": TIME_INPUT, **dict.fromkeys(PLACE, POSE)}


def learned_kind(curve: LearnedCurve) -> EffectKind:
    """Return the effect kind of this function."""
    sources = [INPUTS[name] for name in curve.inputs]
    needs = tuple(dict.fromkeys([*(n for s in sources for n in s.needs),
                                 *(["dir"] if curve.signed else [])]))

    def exists_in(motion: Motion) -> bool:
        return curve.acts in (JOINT, *motion.coordinates) and all(
            s.name not in PLACE or s.name in motion.coordinates for s in sources)

    return EffectKind(
        LEARNED, "du, or a pose coordinate, = scale f(input), f a spline through values at nodes",
        "Kennedy & O'Hagan 2001; Plumlee 2017", fixed_list(SCALE), needs, curve.terms,
        per_actuator=curve.acts == JOINT, exists_in=exists_in,
        uses_load=any(s.by_pose for s in sources),
        worked=WORKED, follows=FOLLOWED[curve.input], remedy="measure more rows over its range",
        from_file=FROM_FILE, written=curve.entries, variants=_never, known=curve.known,
        spread=curve.spread, title=f"{LEARNED} from {' and '.join(curve.inputs)}")


def _never(motion: Motion) -> Sequence[EffectKind]:
    """Return no kinds: searches skip it, since it is learned from the residuals."""
    return ()


def _from_file(given: Mapping[str, object], units: Units, joint: str) -> EffectKind:
    """Return the kind for a file's entries; see :class:`FromFile`."""
    name = given.get("input")
    if name not in INPUTS:
        raise unknown("input", name, INPUTS, "input")
    source = INPUTS[str(name)]
    acts = given.get("acts", JOINT)
    if acts not in (JOINT, *PLACE):
        raise unknown("coordinate", acts, (JOINT, *PLACE), "acts")
    by = given.get("by")
    if by not in (None, DIRECTION.name, *INPUTS):
        raise unknown("class or input", by, (DIRECTION.name, *INPUTS), "by")
    second = INPUTS[str(by)] if by in INPUTS else None
    if acts != JOINT and (by == DIRECTION.name or not all(
            s.of_machine for s in (source, second) if s)):
        which = by if by is not None and source.of_machine else source.name
        raise BadInput(f"a function of each joint's {which} cannot act on {acts}", "acts",
                       f"Write `acts: {JOINT}`")
    if second is source:
        raise BadInput("the second input equals the first", "by", "Name another input, or none")
    nodes = _nodes(given, "nodes")
    by_nodes = _nodes(given, "by_nodes") if second else np.zeros(1)
    if second is None and "by_nodes" in given:
        raise BadInput("there are nodes for a second input, which is not named", "by_nodes",
                       "Name it: `by: temperature`")
    count = nodes.size * by_nodes.size
    values = _numbers(given, "values", (nodes.size, by_nodes.size) if second else nodes.shape)
    covariance = _numbers(given, "covariance", (count, count))
    largest = float(np.abs(covariance).max())
    if (np.any(np.abs(covariance - covariance.T) > SYMMETRIC * largest)
            or linalg.eigvalsh(covariance).min() < -SYMMETRIC * largest):
        raise BadInput("this is not a covariance: asymmetric, or with a negative variance",
                       "covariance", "Copy all of it, or write zeros if the values are certain")
    found = LearnedCurve(source.name, nodes, values.ravel(), covariance, by == DIRECTION.name,
                         str(acts), joint, second.name if second else "", by_nodes)
    own = units.factor(found.quantity)

    def si(one: LearnedInput, x: Array) -> Array:
        return np.asarray((x - one.zero) * si_factor(units, found.quantity_of(one.name)))

    return learned_kind(replace(
        found, nodes=si(source, nodes), values=found.values * own, covariance=covariance * own**2,
        by_nodes=si(second, by_nodes) if second else by_nodes))


def _nodes(given: Mapping[str, object], name: str) -> Array:
    """Return the nodes of an input, in rising order."""
    nodes = _numbers(given, name, None)
    if not 2 <= nodes.size <= MOST_NODES or np.any(np.diff(nodes) <= 0.0):
        raise BadInput("the nodes do not rise from one to the next", name,
                       f"Give 2 to {MOST_NODES} values of the input, in rising order")
    return nodes


def _numbers(given: Mapping[str, object], name: str, shape: tuple[int, ...] | None) -> Array:
    """Return the numbers of an entry, of a given shape."""
    want = "a list of numbers" if shape is None else " by ".join(map(str, shape)) + " numbers"
    try:
        found = np.array(given.get(name), dtype=float)
    except (TypeError, ValueError):
        found = np.array(np.nan)
    if not np.isfinite(found).all() or (found.ndim != 1 if shape is None else
                                        found.shape != shape):
        raise BadInput(f"'{name}' is not {want}", name, f"Give {want}, one for each node")
    return found


LEARNED = "learned"
SCALE = EffectParameter("scale", "1", 1.0, size=1e-3)
FROM_FILE = FromFile(("input", "by", "acts", "nodes", "by_nodes", "values", "covariance"),
                     _from_file)
WORKED = Worked({"scale": 1.0}, {"travel": 0.5}, 1e-5)
register(learned_kind(LearnedCurve("travel", np.array([0.0, 1.0]), np.array([0.0, 2e-5]),
                            np.zeros((2, 2)))))

__all__ = ["INPUTS", "JOINT", "LearnedCurve", "LearnedInput", "learned_kind", "spline_basis"]
