"""What a machine's joints do, as tables joint by joint that LinuxCNC adds to its commands.

The controller asks joint a for the nominal value n, which the nominal model takes as the
coordinate u = ratio0 n + offset0 of its limb. The real joint, commanded m, stands at
u = ratio m + offset + du(m), where du are the effects that know nothing but the joint's own value
and the direction of travel (gain, curvature, periodic, eccentricity, backlash). So it has to be
commanded the m at which both are equal, and LinuxCNC commands n + (nominal - forward): the table
holds forward = 2 n - m, the joint's actual position at n up to errors times slopes. All SI, apart
from :class:`Triplets`, in the controller's unit.

Files are lines of ``nominal forward reverse``, and nothing else. With ``COMP_FILE_TYPE = 0`` a line
says where a joint is (forward: in positive travel, reverse: in negative travel) when commanded to
nominal. LinuxCNC adds nominal - forward, interpolated between the nominals and constant beyond
them, to the motor's command. It stops reading at the first line that does not begin with three
numbers, a comment or an empty line included, and takes at most 256 lines, their nominals increasing
(LinuxCNC, src/emc/motion/usrmotintf.cc usrmotLoadComp, command.c EMCMOT_SET_JOINT_COMP).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ppmcal import linalg
from ppmcal.calibration.knowledge import OUTSIDE
from ppmcal.controllers.pose_grid import at_rest, refuse_open
from ppmcal.controllers.text import DECIMAL, Rounded
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import setting, shifted
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array, Ints
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Effect, Mechanism
from ppmcal.units import LENGTHS

MOST = 256
"""Lines that LinuxCNC takes, EMCMOT_COMP_SIZE."""
LONGEST = 250
"""Characters of a line; LinuxCNC cuts longer ones in two (LINELEN)."""
DIGITS = 9
"""Decimals of what is written."""
Numbers = tuple[float, ...]
HALVINGS = 12
TARGET = 1e-8
"""Tables have as many points as bring their interpolation within this, m or rad, if they can."""
COARSE = 1e-6
"""A table that is off by more between its points, m or rad, is worth a warning."""
SAMPLES = 8001
ROUNDS = 100
SETTLED = 1e-14
INSIDE = 1e-6
JOINT_SLOTS = ("offset", "ratio")


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


def knots(x: Array, y: Array, target: float, most: int) -> Ints:
    """Return which of the points carry the others by straight lines, ends included (P,).

    As few as keep all of ``y`` (n, c) over increasing ``x`` (n,) within ``target`` of the lines;
    if those are more than ``most``, about the smallest error that ``most`` of them allow.
    """
    found = _spanned(x, y, target, most)
    if found is not None:
        return found
    low, high = np.log(target), np.log(2.0 * float(np.max(np.ptp(y, axis=0))) + target)
    best = np.array([0, len(x) - 1])
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        found = _spanned(x, y, float(np.exp(middle)), most)
        if found is None:
            low = middle
        else:
            best, high = found, middle
    return best


def _spanned(x: Array, y: Array, tolerance: float, most: int) -> Ints | None:
    """Return knots of lines as long as the tolerance allows, None if that takes too many."""
    def fits(i: int, j: int) -> bool:
        part = ((x[i:j + 1] - x[i]) / (x[j] - x[i]))[:, None]
        line = y[i] + part * (y[j] - y[i])
        return bool(np.max(np.abs(y[i:j + 1] - line)) <= tolerance)

    last, out = len(x) - 1, [0]
    while out[-1] < last:
        if len(out) >= most:
            return None
        i, good, step = out[-1], out[-1] + 1, 2
        while i + step <= last and fits(i, i + step):
            good, step = i + step, 2 * step
        bad = min(i + step, last + 1)
        while bad - good > 1:
            middle = (good + bad) // 2
            good, bad = (middle, bad) if fits(i, middle) else (good, middle)
        out.append(good)
    return np.array(out)


@dataclass(frozen=True)
class CorrectionTable:
    """The table of one actuator.

    ``unit``: what the table counts in, ``factor`` its SI value (1 and "" for a bare number);
    ``error``: how far interpolation is off at most, in the unit; ``coarse``: that is more than
    :data:`COARSE`, because more points would be needed than the controller takes.
    """

    actuator: str
    unit: str
    factor: float
    table: Triplets
    error: float
    coarse: bool


def joint_effects(mechanism: Mechanism) -> tuple[Effect, ...]:
    """Return the effects that act on joints alone and know but their value and direction."""
    return tuple(e for e in mechanism.effects if e.kind.per_actuator and not e.kind.uses_load
                 and set(e.kind.needs) <= {"dir"} and _moves_joints(mechanism, e))


def _moves_joints(mechanism: Mechanism, effect: Effect) -> bool:
    alone = Model(replace(mechanism, effects=(effect,)))
    shift = shifted(alone, at_rest(mechanism, 1), home_state(mechanism).q[None],
                    mechanism.home[None]).shift
    return shift is None or (shift.pose is None and shift.stretch is None
                             and all(slot == "offset" for _, slot in shift.slots))


def joint_parameters(mechanism: Mechanism) -> list[int]:
    """Return the indices of ratios and offsets."""
    return sorted({p for limb in mechanism.limbs for slot, p in limb.slots.direct
                   if slot in JOINT_SLOTS})


def corrected_commands(mechanism: Mechanism, nominal: Array, way: Array) -> Array:
    """Return the commands (n, k) with which joints stand where ``nominal`` (n, k) means.

    Args:
        mechanism: the machine; its nominals are what the controller believes.
        nominal: joint values that nominal kinematics asks for.
        way: direction of travel of each joint (n, k), +1 or -1.

    Limbs that share a drive but not its errors share the mean.

    Raises:
        NoResult: the effects of a joint fold back, so that no such value is found.
    """
    real = replace(mechanism, effects=joint_effects(mechanism))
    want = _coordinates(mechanism.nominal(), nominal, way)
    scale = np.max(np.abs(nominal), axis=0) + 1e-9
    own = list(mechanism.driven)
    actuator = np.array([mechanism.limbs[i].actuator for i in own])
    share = (actuator[:, None] == np.arange(nominal.shape[1])
             ) / mechanism.limb_ratios[own, None]
    share /= np.bincount(actuator, minlength=nominal.shape[1])
    low, high = known_commands(mechanism).T
    out: Array = np.clip(nominal, low, high)
    for _ in range(ROUNDS):
        whole = (want - _coordinates(real, out, way)) @ share
        step = np.clip(out + whole, low, high) - out
        out += step
        if np.all(np.abs(step) <= SETTLED * scale):
            # held back at the end of what is known: there is no such command
            return np.where(np.abs(whole) <= INSIDE * scale, out, np.nan)
    worst = int(np.argmax(np.max(np.abs(step), axis=0) / scale))
    raise NoResult(f"the effects of {mechanism.actuators[worst]} are steeper than the joint itself",
                   mechanism.source, "Check their parameters and units")


def _coordinates(mechanism: Mechanism, q: Array, way: Array) -> Array:
    """Return the joint coordinate u of each driven limb (n, L) at joint values (n, k)."""
    rows = replace(at_rest(mechanism, len(q)), approach=way)
    model = shifted(Model(mechanism), rows, q, np.full((len(q), 8), np.nan))
    return np.stack([model.joint_coordinate(i, q) for i in mechanism.driven], axis=-1)


def drives_of_unequal_limbs(mechanism: Mechanism) -> list[str]:
    """Return the actuators whose limbs do not share the errors of their drive."""
    names = mechanism.actuators
    owners = [mechanism.limbs[i].actuator for i in mechanism.driven]
    if len(set(owners)) == len(owners):
        return []
    q = np.array([[-1.0], [1.0]]) + home_state(mechanism).q
    way = np.ones_like(q)
    off = (_coordinates(mechanism.nominal(), q, way)
           - _coordinates(replace(mechanism, effects=()), q, way))
    return [name for a, name in enumerate(names)
            if np.any(np.ptp(off[:, [o == a for o in owners]], axis=1) > TARGET)]


def joint_tables(mechanism: Mechanism) -> tuple[CorrectionTable, ...]:
    """Return the table of each actuator over its limits.

    Raises:
        BadInput: an actuator has no limits. NoResult: as :func:`corrected_commands`.
    """
    refuse_open(mechanism, "the table")
    low, high = known_limits(mechanism).T
    even = low + np.linspace(0.0, 1.0, SAMPLES)[:, None] * (high - low)
    wanted = _both_ways(mechanism, even)
    # other points to look at, so that nothing hides between the first ones
    other = np.random.default_rng(0).uniform(low, high, even.shape)
    check = _both_ways(mechanism, other)
    out = []
    for a, name in enumerate(mechanism.actuators):
        factor, unit = mechanism.joint_units[a]
        if unit in ("m", "cm", "um"):    # which LinuxCNC does not count in; bare numbers stay bare
            factor, unit = LENGTHS["mm"], "mm"
        limb = next(limb for limb in mechanism.limbs if limb.actuator == a)
        slope = abs(limb.slots.values(mechanism.nominals).get("ratio", 1.0))    # |du/dq|
        x, added = even[:, a], wanted[:, a] - even[:, a, None]
        chosen = knots(x, added, TARGET / slope, MOST)
        table = _table(mechanism, a, even[chosen], factor)
        error, _ = _interpolation_errors(table, factor, other[:, a], check[:, a])
        coarse = error * slope > COARSE
        if coarse:
            spread = np.linspace(0, SAMPLES - 1, MOST).astype(np.int64)
            tables = [_smoothed(x, added, at, factor) for at in (chosen, spread)]
            off = [_interpolation_errors(t, factor, other[:, a], check[:, a]) for t in tables]
            best = int(np.argmin([rms for _, rms in off]))
            table, error = tables[best], off[best][0]
        out.append(CorrectionTable(name, unit, factor, table, error / factor, coarse))
    return tuple(out)


def known_commands(mechanism: Mechanism) -> Array:
    """Return the joint values (k, 2) between which all effects of the joints are known.

    An effect is not known much beyond the joint values that were measured.
    """
    k = len(mechanism.actuators)
    out, seen = np.tile([-np.inf, np.inf], (k, 1)), mechanism.measured or MeasurementBasis()
    ones = np.ones((1, k))
    ratio = setting(Model(mechanism), at_rest(mechanism, 1), ones, np.full((1, 8), np.nan)).travel
    for effect in joint_effects(mechanism):
        for a, known in ((a, r) for a in np.flatnonzero(effect.on) for r in effect.kind.known):
            ends = np.sort(np.array([known.low, known.high]) / ratio[0, a])
            # a little inside, so that rounding stays there
            ends += np.array([1.0, -1.0]) * INSIDE * float(np.ptp(ends))
            out[a] = max(out[a, 0], ends[0]), min(out[a, 1], ends[1])
        for a in np.flatnonzero(effect.on):
            low, high = seen.ranges.get(f"q_{mechanism.actuators[a]}", (-np.inf, np.inf))
            margin = OUTSIDE * (high - low)
            out[a] = max(out[a, 0], low - margin), min(out[a, 1], high + margin)
    return out


def known_limits(mechanism: Mechanism) -> Array:
    """Return the joint range (k, 2), as nominal kinematics counts, of which commands are known."""
    out, ends = mechanism.limits.copy(), known_commands(mechanism)
    real = replace(mechanism, effects=joint_effects(mechanism))
    steps = np.array([[0.0], [1.0]]) * np.ones(len(out))
    meant = _coordinates(mechanism.nominal(), steps, np.ones_like(steps))
    owner = [mechanism.limbs[i].actuator for i in mechanism.driven]
    for a in np.flatnonzero(np.isfinite(ends).all(axis=1)):
        q = np.where(np.arange(len(out)) == a, ends[a][:, None], np.nan)
        i = owner.index(int(a))
        at = np.stack([_coordinates(real, q, np.full_like(q, way))[:, i] for way in (1.0, -1.0)])
        n = (at - meant[0, i]) / (meant[1, i] - meant[0, i])
        out[a] = max(out[a, 0], n[:, 0].max()), min(out[a, 1], n[:, 1].min())
    return out


def _table(mechanism: Mechanism, actuator: int, at: Array, factor: float) -> Triplets:
    """Return an actuator's table at joint values ``at`` (P, k), right at what the file will say."""
    n = np.round(at[:, actuator] / factor, DIGITS)
    at = at.copy()
    at[:, actuator] = n * factor
    return _triplets(n, _both_ways(mechanism, at)[:, actuator] / factor - n[:, None])


def _smoothed(x: Array, added: Array, at: Ints, factor: float) -> Triplets:
    """Return the table with points ``at`` that is nearest to ``added`` (n, 2) in the mean.

    Lines through points of waves that are too short for them may be worse than no table; those
    of least squares are not.
    """
    hats = np.stack([np.interp(x, x[at], row) for row in np.eye(len(at))], axis=-1)
    n = np.round(x[at] / factor, DIGITS)
    fitted: Array = np.asarray(linalg.lstsq(hats, added, rcond=None)[0], dtype=float)
    return _triplets(n, fitted / factor)


def _triplets(nominal: Array, added: Array) -> Triplets:
    """Return the table that adds ``added`` (P, 2) to ``nominal`` (P,)."""
    actual = nominal[:, None] - added
    return Triplets(tuple(nominal.tolist()), tuple(actual[:, 0].tolist()),
                    tuple(actual[:, 1].tolist())).rounded()


def _interpolation_errors(table: Triplets, factor: float, q: Array, right: Array
                          ) -> tuple[float, float]:
    """Return largest and rms difference of the commands at ``q`` (n,) from ``right`` (n, 2)."""
    off = np.stack([table_command(table, factor, q, np.full_like(q, way)) for way in (1.0, -1.0)],
                   axis=-1) - right
    return float(np.max(np.abs(off))), float(np.sqrt(np.mean(off**2)))


def _both_ways(mechanism: Mechanism, q: Array) -> Array:
    """Return the corrected commands in positive and in negative travel (n, k, 2)."""
    return np.stack([corrected_commands(mechanism, q, np.full_like(q, way))
                     for way in (1.0, -1.0)], axis=-1)


def table_command(table: Triplets, factor: float, q: Array, way: Array) -> Array:
    """Return what the motor is commanded (n,) for joint values ``q`` (n,), SI."""
    x = q / factor
    return (x + correction(table, x, way)) * factor
