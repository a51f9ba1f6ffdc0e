"""The frame of the base, which a machine that calibrates itself cannot see: its gauge.

Joint values alone are the same wherever the base stands. So some coordinates of base points are
held where they are and define its frame: all of the first limb's, of the next ones as many as turn
would leave open. They are a choice, and neither known nor redundant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note

LEVERAGE = 0.3
"""A coordinate holds a turn that moves it by more than this part of the base's size."""


def with_gauge(mechanism: Mechanism, datasets: Sequence[Dataset]) -> Mechanism:
    """Return the machine with the parameters held that define the frame of its base.

    Itself where an instrument says where the base stands, where the file leaves that to the
    tolerances (``gauge: tolerances``), and where enough is fixed already.
    """
    if mechanism.gauge != "base" or not datasets or not all(d.kind.blind for d in datasets):
        return mechanism
    held = _held(mechanism)
    if not held:
        return mechanism
    names = [mechanism.names[p] for p in held]
    said = Note(f"{', '.join(names)} are held as they are: they define the frame "
                "of the base, of which joint values alone say nothing (gauge).", NOTE, "gauge")
    return replace(mechanism, free=tuple(p for p in mechanism.free if p not in held),
                   findings=(*mechanism.findings, said))


def _held(mechanism: Mechanism) -> list[int]:
    """Return the free parameters to hold, limb by limb, in each those that turns move most."""
    points = [limb.slots.values(mechanism.values) for limb in mechanism.limbs]
    places = np.array([[v.get(f"base.point.{a}", 0.0) for a in "xyz"] for v in points])
    size = float(np.linalg.norm(np.ptp(places, axis=0))) or 1.0
    parts = list(mechanism.motion.frame_parts)
    seen, out = np.zeros((0, len(parts))), list[int]()
    # what the file fixes comes first: it defines the frame already
    for fixed in (True, False):
        for limb, place in zip(mechanism.limbs, places, strict=True):
            moves = _moves(place / size)[:, parts]
            own = {axis: dict(limb.slots.direct).get(f"base.point.{a}")
                   for axis, a in enumerate("xyz")}
            new = [_new(seen, move) for move in moves]
            for axis in sorted(own, key=new.__getitem__, reverse=True):
                p = own[axis]
                if p is None or (p in mechanism.free) == fixed or len(seen) == len(parts):
                    continue
                if _new(seen, moves[axis]) > LEVERAGE:
                    seen = np.concatenate([seen, moves[axis][None]])
                    out += [] if fixed else [p]
    return out


def _moves(place: Array) -> Array:
    """Return how a point (3,) moves with displacements and turns of the base (3, 6)."""
    x, y, z = place
    return np.concatenate([np.eye(3), [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]], axis=1)


def _new(seen: Array, move: Array) -> float:
    """Return how much of a coordinate's motion (f,) those before (n, f) leave open."""
    if not len(seen):
        return float(np.linalg.norm(move))
    basis = linalg.column_basis(seen.T)
    return float(np.linalg.norm(move - basis @ (basis.T @ move)))
