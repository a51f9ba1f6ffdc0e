"""Campaigns on machines of ropes: what is hidden, how large, and what a rig reads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .machines import Array, Machine, balance, ropes, tensions, ways

NOISE = 0.2
"""Of a reading of a rope, mm; of an instrument's position too, and a tenth of a mrad."""
TURN_NOISE = 1e-4


@dataclass(frozen=True)
class Rows:
    """What a cause may know: paid-out lengths (N, m), tensions, places, rows and directions.

    ``tension``: in parts of what those pull that do, and ``force`` in N, as sensors show it;
    ``session`` (N,): number of the session; ``beyond`` (N,): whether x is beyond the middle.
    """

    length: Array
    tension: Array
    place: Array
    side: Array
    rng: np.random.Generator
    session: Array
    force: Array
    beyond: Array


Cause = Callable[[Rows], Array]
"""Rows -> what a rope is longer than its reading, of size one (N, m)."""


def _one(values: Array, rope: int) -> Array:
    out = np.zeros_like(values)
    out[:, rope] = values[:, rope]
    return out


def _some(values: Array, r: Rows) -> Array:
    """Return values of one of the first four ropes, whichever."""
    return _one(values, int(r.rng.integers(min(4, values.shape[1]))))


def _curved(r: Rows) -> Array:
    low, high = r.length.min(axis=0), r.length.max(axis=0)
    x = 2.0 * (r.length - low) / (high - low) - 1.0
    return 1.5 * x**2 - 0.5


def _shift(r: Rows) -> Array:
    late = np.arange(len(r.length)) >= int(r.rng.uniform(0.35, 0.65) * len(r.length))
    return _some(np.where(late[:, None], 1.0, 0.0) * np.ones_like(r.length), r)


def _wave(r: Rows) -> Array:
    return _some(np.sin(2.0 * np.pi * r.length / 150.0 + 1.0), r)


def _caught(r: Rows) -> Array:
    return r.rng.normal(size=(int(r.place.max()) + 1, r.length.shape[1]))[r.place]


def _rough(r: Rows) -> Array:
    """Return what friction leaves at each place, wild, and between the readings of one place."""
    count = int(r.place.max()) + 1
    own = r.rng.standard_t(3.0, size=(count, r.length.shape[1]))[r.place]
    settling = r.rng.standard_t(3.0, size=r.length.shape) * r.rng.uniform(
        0.0, 0.4, size=(count, 1))[r.place]
    return own + settling


def _wanders(r: Rows) -> Array:
    steps = r.rng.normal(size=len(r.length)).cumsum() / np.sqrt(len(r.length))
    return _some(np.repeat(steps[:, None], r.length.shape[1], axis=1), r)


def _homed(r: Rows) -> Array:
    zeros = r.rng.normal(size=(SESSIONS, r.length.shape[1]))
    return zeros[r.session]


def _pulled(r: Rows) -> Array:
    """Return stretch with another pull in the last session, half of it or twice."""
    other = float(r.rng.choice([0.5, 2.0]))
    return r.length * r.tension * np.where(r.session == SESSIONS - 1, other, 1.0)[:, None]


def _sides(r: Rows) -> Array:
    """Return what ropes read otherwise where those on the other side are pulled first."""
    return np.where(r.beyond[:, None], 1.0, 0.0) * r.rng.normal(size=r.length.shape[1])


UNKNOWN = frozenset({"unknown"})
CAUSES: dict[str, tuple[Cause | None, frozenset[str]]] = {
    "none": (None, frozenset()),
    "stretch": (lambda r: r.length * r.tension, frozenset({"rope_stretch", "anchor_give"})),
    "give": (lambda r: 1.0 * r.tension, frozenset({"anchor_give", "rope_stretch"})),
    "constant": (lambda r: np.ones_like(r.length), frozenset({"missing_length"})),
    "curvature": (_curved, frozenset({"curvature"})),
    "slipped": (_shift, frozenset({"zero_shift"})),
    "wave": (_wave, frozenset({"periodic"})),
    "backlash": (lambda r: _one(0.5 * r.side, 1), frozenset({"backlash"})),
    "caught": (_caught, UNKNOWN),
    "rough": (lambda r: r.length * r.tension, frozenset({"rope_stretch", "anchor_give"})),
    "wanders": (_wanders, UNKNOWN),
    "none-by-day": (None, frozenset()),
    "homed": (_homed, frozenset({"zero_shift"})),
    "pulled": (_pulled, frozenset({"rope_stretch", "anchor_give"})),
    "sides": (_sides, frozenset({"side_shift"})),
    "slipped-in-columns": (_shift, frozenset({"zero_shift"})),
    "none-in-force": (None, frozenset()),
    "elastic": (lambda r: r.length * r.force, frozenset({"rope_elasticity"})),
}
"""By name the cause, and the kinds that are right; those that no kind is right for are unknown.

Stretch and a frame that gives differ by the ropes' lengths alone: either name is right for both."""
BY_DAY = frozenset({"none-by-day", "homed", "pulled"})
"""Causes of campaigns of several sessions."""
ROUGH = frozenset({"rough"})
"""Causes beside which friction adds to each place what no model has, as on a real router: there
`eta` counts in the rms of that, and it is so many times the noise."""
TIMES = 3.0
BY_PULL = frozenset({"stretch", "give", "rough", "pulled"})
"""Causes that only ropes have which are pulled against others."""
IN_COLUMNS = frozenset({"sides", "slipped-in-columns"})
"""Causes of campaigns that go from side to side, column by column, so that late is beyond."""
IN_FORCE = frozenset({"none-in-force", "elastic"})
"""Causes of campaigns whose ropes have force sensors."""
OF_ROPES = IN_FORCE | {"sides"}
"""Causes that only ropes have."""
SESSIONS = 3
COLUMNS = 4
"""Either side of the middle."""
PULL = (20.0, 100.0)
"""With what ropes pull that do, N, drawn anew at each place where there are force sensors."""


@dataclass(frozen=True)
class Session:
    """Readings (N, m) as :func:`ways`, directions (N, m), measured poses (N, 6), and true points.

    ``eta``: rms of the hidden cause over the noise, past what geometry could take up. ``session``
    (N,) its number, ``force`` (N, m) in N: None without several sessions, or force sensors.
    """

    readings: Array
    side: Array
    poses: Array | None
    place: Array
    anchors: Array
    hooks: Array
    size: float
    session: Array | None = None
    force: Array | None = None


def session(machine: Machine, cause: str, eta: float, rng: np.random.Generator, places: int,
            repeats: int) -> Session:
    """Return a campaign with a cause of size eta hidden in it."""
    spread = rng.normal(size=(2, *machine.anchors.shape)) * machine.tolerance
    spread[..., 2] *= not machine.flat
    if machine.pointed:
        spread[1] = 0.0
    anchors, hooks = machine.anchors + spread[0], machine.hooks + spread[1]
    offset = rng.normal(size=len(anchors)) * machine.offset
    bars = np.broadcast_to(machine.bars, (len(anchors), len(machine.bars)))
    if machine.bars:
        bars = bars + rng.normal(size=bars.shape) * machine.tolerance
    at = np.array(machine.centre) + np.array(machine.half) * rng.uniform(-1, 1, (places, 6))
    if cause in IN_COLUMNS:
        at = at[np.argsort(np.round(at[:, 0] / machine.half[0] * COLUMNS), kind="stable")]
    place = np.repeat(np.arange(places), repeats)
    poses = at[place]
    _, units, arms = ropes(anchors, hooks, poses)
    length = ways(machine, anchors, hooks, bars, poses)
    before = np.concatenate([length[:1] - 1.0, length[:-1]])
    for n in np.flatnonzero(np.concatenate([[False], place[1:] == place[:-1]])):
        before[n] = length[n] - (rng.choice([-1.0, 1.0], length.shape[1]))  # come to anew
    tension = tensions(machine, units, arms)
    pull = rng.uniform(*PULL, places)[place, None] if cause in IN_FORCE else 1.0
    day = place * SESSIONS // places if cause in BY_DAY else np.zeros_like(place)
    rows = Rows(length, tension, place, np.sign(length - before), rng, day, pull * tension,
                poses[:, 0] > np.mean([anchors[:, 0].min(), anchors[:, 0].max()]))
    made = CAUSES[cause][0]
    extra = np.zeros_like(length) if made is None else made(rows)
    noise = NOISE
    rough = 0.0
    if cause in ROUGH:
        rough = TIMES * NOISE * _rough(rows) / np.sqrt(3.0)    # of variance 3 each
        noise *= TIMES
    size = eta * noise / _seen(machine, extra, anchors, hooks, bars, poses) if made else 0.0
    readings = length - offset - size * extra - rough + NOISE * rng.normal(size=length.shape)
    seen = None
    if machine.instrument == "pose":
        seen = poses + np.array([NOISE] * 3 + [TURN_NOISE] * 3) * rng.normal(size=poses.shape)
    return Session(readings, rows.side, seen, place, anchors, hooks, size,
                   day if cause in BY_DAY else None, rows.force if cause in IN_FORCE else None)


def _seen(machine: Machine, extra: Array, anchors: Array, hooks: Array, bars: Array, poses: Array
          ) -> float:
    """Return the rms of a change of ways past what poses and geometry take up, per number."""
    n, m = extra.shape
    rest = np.broadcast_to(np.eye(m), (n, m, m))
    if machine.instrument == "none":
        _, units, arms = ropes(anchors, hooks, poses)
        rest = np.stack([np.linalg.svd(b)[2][b.shape[0]:] for b in balance(machine, units, arms)])
    size = 2 if machine.flat else 3
    own = [anchors[:, :size], *([] if machine.pointed else [hooks[:, :size]]), bars]
    flat = np.concatenate([part.ravel() for part in own])

    def at(values: Array) -> Array:
        parts = np.split(values, np.cumsum([part.size for part in own])[:-1])
        a, b = anchors.copy(), hooks.copy()
        a[:, :size] = parts[0].reshape(m, size)
        if not machine.pointed:
            b[:, :size] = parts[1].reshape(m, size)
        return ways(machine, a, b, parts[-1].reshape(bars.shape), poses)

    step = 1e-3
    columns = [np.stack([(at(flat + step * e) - at(flat - step * e)) / (2.0 * step)
                         for e in np.eye(flat.size)], axis=-1)]         # (n, m, c)
    if machine.offset:
        columns.append(np.broadcast_to(np.eye(m), (n, m, m)))
    geometry = rest @ np.concatenate(columns, axis=2)
    geometry = geometry.reshape(-1, geometry.shape[2])
    column = (rest @ extra[..., None]).reshape(-1)
    left = column - geometry @ np.linalg.lstsq(geometry, column, rcond=1e-9)[0]
    return float(np.sqrt(np.mean(left**2)))
