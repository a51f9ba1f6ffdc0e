"""The gauge freedom of a self-calibrating machine: what it cannot know of its own frames.

Joint values alone, of drives and of encoders at other joints, do not depend on where the base
stands, nor on how the platform's own axes are placed in it. So some coordinates of base points, and
then of platform points, are held and define these frames: all of the first limb's, and as many of
the next ones as rotations would leave open. They are a choice, neither known nor redundant.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from ppmcal import linalg
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.joint_readings import JointReading
from ppmcal.kinematics.least_squares_closure import held_by, surplus
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.chain import cross_matrix
from ppmcal.model.mechanism import Limb, Mechanism
from ppmcal.notes import NOTE, Note

LEVERAGE = 0.3
"""A coordinate may hold a frame motion that moves it by this part of the most moved coordinate."""
UNSEEN = 1e-7
"""Rows that show no more than this part of a motion show round-off: it is unseen."""
ALIKE = 0.99
"""Coordinates at least this good relative to the best are tied: the first of them is held."""
POSES = 40
"""Number of rows examined, evenly spread."""


def with_gauge(mechanism: Mechanism, datasets: Sequence[Dataset]) -> Mechanism:
    """Return the machine with the parameters held that define the frames of base and platform.

    Unchanged if an instrument locates the frames, if the file leaves that to the tolerances
    (``gauge: tolerances``), or if enough is fixed already. Parameters that are not free, as in a
    machine written by such a calibration, are chosen before free ones.
    """
    if mechanism.gauge != "base" or not datasets or not all(d.kind.inside for d in datasets):
        return mechanism
    if not mechanism.free:      # a machine that is examined, not fitted
        return mechanism
    image = _mirror(mechanism) if any(d.kind.blind for d in datasets) else None
    if image is not None:
        mechanism = replace(mechanism, findings=(*mechanism.findings, image))
    idle = [i for i, p in enumerate(mechanism.parameters)
            if p.tolerance and not p.fixed and i not in mechanism.free]
    every = replace(mechanism, free=(*idle, *mechanism.free))
    moves, size = _motions(every, datasets)
    held = _held(every, size[:, None] * moves, (idle, mechanism.free))
    if not held:
        return mechanism
    said = Note(f"{', '.join(mechanism.names[p] for p in held)} are held at their values: they "
                "define the frames of base and platform, which joint values alone cannot "
                "determine (gauge). Pose uncertainties refer to these frames.",
                NOTE, "gauge")
    return replace(mechanism, free=tuple(p for p in mechanism.free if p not in held),
                   defining=tuple(held), findings=(*mechanism.findings, said))


def _mirror(mechanism: Mechanism) -> Note | None:
    """Return that the mirror image fits as well: for planar machines, and for symmetric limbs.

    Exchanging limbs across a plane of symmetry of the drawing gives the mirror image.
    """
    names = [limb.name for limb in mechanism.limbs]
    pairs = [f"{names[i]} with {names[j]}" for image in mirror_images(mechanism)[:1]
             for i, j in enumerate(image) if i < j]
    if not pairs and not mechanism.motion.planar:
        return None
    also = f"; exchanging {', '.join(pairs)} fits as well" * bool(pairs)
    return Note("Joint values alone cannot tell a machine from its mirror image: the order of the "
                f"limbs in the mechanism file decides{also} (gauge).", NOTE, "gauge")


def mirror_images(mechanism: Mechanism) -> list[list[int]]:
    """Return each limb's mirror image, for each plane of symmetry of the drawing (x, y or z)."""
    values = [(limb.kind, limb.slots.values(mechanism.values)) for limb in mechanism.limbs]
    ends = np.array([[[v.get(f"{kind.point(end)}.{a}", np.nan if a == "x" else 0.0) for a in "xyz"]
                      for end in ("base", "platform")] for kind, v in values])
    away, out = ends - ends.mean(axis=0), []
    for axis in range(mechanism.motion.axes):
        image = away * np.where(np.arange(3) == axis, -1.0, 1.0)
        apart = np.abs(image[:, None] - away[None]).max(axis=(2, 3), initial=0.0)
        if np.isnan(apart).any():
            return []
        other = np.argmin(apart, axis=1)
        same = apart[np.arange(len(other)), other] < UNSEEN * mechanism.reach
        if same.all() and (other != np.arange(len(other))).any():
            out.append(other.tolist())
    return out


def by_defining(mechanism: Mechanism, datasets: Sequence[Dataset], free: Sequence[int]) -> Array:
    """Return how parameters ``free`` (F,) move with errors of those that define frames (F, G).

    An error of a held parameter moves its frame, and so the other parameters as seen from it.
    """
    others, own, _ = _moves_of(mechanism, datasets, free, mechanism.defining)
    return np.asarray(others @ linalg.pinv(own))


def seen_from_frames(mechanism: Mechanism, datasets: Sequence[Dataset], free: Sequence[int]
                     ) -> tuple[tuple[int, ...], Array]:
    """Return the coordinates that alone define frames, and how ``free`` changes with each (F, G).

    They are held by a calibration or fixed in the file. Joint values alone cannot tell a unit
    error of one of them from changes of the parameters ``free`` (F,) by these amounts. Coordinates
    fixed beyond need, such as all those of a point with several hooks, define no frame.
    """
    if not all(d.kind.inside for d in datasets):
        return (), np.zeros((len(free), 0))
    held = sorted({p for limb in mechanism.limbs for end in ("base", "platform")
                   for p in limb.slots.feeds_point(limb.kind.point(end))} - set(free))
    others, own, size = _moves_of(mechanism, datasets, free, held)
    back = linalg.pinv(own)
    alone = np.abs(own @ back - np.eye(len(held))).max(axis=0, initial=0.0) < UNSEEN
    seen = -others @ back
    seen[size[:len(free), None] * np.abs(seen) < UNSEEN * size[len(free):]] = 0.0
    good = alone & seen.any(axis=0)
    return tuple(p for p, g in zip(held, good, strict=True) if g), np.asarray(seen[:, good])


def _moves_of(mechanism: Mechanism, datasets: Sequence[Dataset], free: Sequence[int],
              held: Sequence[int]) -> tuple[Array, Array, Array]:
    """Return motions of the frames in parameters ``free`` (F, M) and ``held`` (H, M), and sizes."""
    moves, size = _motions(replace(mechanism, free=(*free, *held)), datasets)
    return moves[:len(free)], moves[len(free):], size


def by_frames(mechanism: Mechanism, datasets: Sequence[Dataset], free: Sequence[int],
              away: Array) -> float:
    """Return how much of the tolerances' chi-squared an error of the frames explains.

    Args:
        mechanism: with the parameters that define its frames; 0 if it has none.
        datasets: the measured joint values.
        free: indices of the fitted parameters (F,).
        away: each column's distance from nominal over its tolerance, parameters first.
    """
    known = [mechanism.parameters[p].prior_sigma for p in (*free, *mechanism.defining)]
    if not mechanism.defining or None in known[len(free):]:
        return 0.0
    moves = np.concatenate([by_defining(mechanism, datasets, free),
                            np.eye(len(mechanism.defining))])
    weight = np.array([1.0 / s if s else 0.0 for s in known])
    basis = linalg.column_basis(weight[:, None] * moves)
    return float(np.sum((away[:len(free)] @ basis[:len(free)]) ** 2))


def _held(mechanism: Mechanism, unseen: Array, pools: Sequence[Sequence[int]]) -> list[int]:
    """Return the free parameters to hold, limb by limb, the ones first that the gauge moves most.

    ``unseen``: how they move with the frames, angles as arcs (F, z); ``pools``: sets of parameters
    to choose from, one after the other.
    """
    basis, out = np.zeros((unseen.shape[1], 0)), list[int]()
    for pool, end, limb, leverage in (
            (pool, e, limb, part) for pool in pools for part in (LEVERAGE, 0.1 * LEVERAGE)
            for e in ("base", "platform") for limb in mechanism.limbs):
        own = [c for c, p in enumerate(mechanism.free)
               if p in pool and p in limb.slots.feeds_point(limb.kind.point(end))]
        for _ in own:
            new = np.linalg.norm(unseen - unseen @ basis @ basis.T, axis=1)
            rest = [c for c in own if mechanism.free[c] not in out]
            most = max((new[c] for c in rest), default=0.0)
            if most <= leverage * new.max(initial=UNSEEN):
                break
            # the first of those that are equally good
            out.append(mechanism.free[next(c for c in rest if new[c] > ALIKE * most)])
            rows = unseen[[mechanism.free.index(p) for p in out]]
            basis = linalg.column_basis(rows.T)
    return out


def _motions(mechanism: Mechanism, datasets: Sequence[Dataset]) -> tuple[Array, Array]:
    """Return how free parameters (F, z) move with the frame motions that no row shows.

    Also the size (F,) of what one unit of each moves; scaled by it, the z are orthogonal.
    """
    free = list(mechanism.free)
    slots = list(_slots(mechanism))
    moves = np.stack([move for _, _, move in slots]) if slots else np.zeros((0, 12))
    by_free = np.concatenate([
        mechanism.limbs[i].slots.jacobian(mechanism.values, (name,), free)
        for i, name, _ in slots]) if slots else np.zeros((0, len(free)))
    steps = linalg.pinv(by_free) @ moves
    # what the file fixes cannot move, and what rows show is not gauge
    alone = np.concatenate([d.q for d in datasets if d.kind.blind or mechanism.surplus]
                           or [np.zeros((0, len(mechanism.actuators)))])
    shown = [moves - by_free @ steps, _shown(mechanism, alone, free) @ steps,
             *(_read(mechanism, d, free) @ steps for d in datasets if not d.kind.blind)]
    _, size, motions = linalg.svd(np.concatenate(shown), full=True)
    whole = np.concatenate([size, np.zeros(len(motions) - len(size))])
    still = motions[whole < UNSEEN * max(1.0, float(whole.max(initial=0.0)))]
    # motions that move no free parameter need not be held
    size, found = np.linalg.norm(by_free, axis=0), steps @ still.T
    _, weight, turned = linalg.svd(size[:, None] * found)
    return np.asarray(found @ turned[weight > UNSEEN].T), np.asarray(size)


def _slots(mechanism: Mechanism) -> Iterator[tuple[int, str, Array]]:
    """Yield limb, slot and its derivative by motions of base and platform (12,), scaled to size 1.

    Displacements along x, y, z and rotations about them, of the base and then of the platform.
    """
    size = mechanism.reach
    base = mechanism.motion.frame_parts
    platform = [c for c in range(6) if c < mechanism.motion.axes or c in mechanism.dof]
    for i, limb in enumerate(mechanism.limbs):
        values = limb.slots.values(mechanism.values)
        for end, first, parts in (("base", 0, base), ("platform", 6, platform)):
            point = limb.kind.point(end)
            place = np.array([values.get(f"{point}.{a}", 0.0) for a in "xyz"]) / size
            turned = -cross_matrix(place)
            for slot in values:
                wound = _wound(limb, values) if (end, slot) == ("base", "offset") else 0.0
                if not slot.startswith(f"{end}.") and not wound:
                    continue
                move = np.zeros(12)
                axis = "xyz".find(slot[-1])
                if wound:
                    move[first + 5] = wound / size
                elif slot.rpartition(".")[0] == point:
                    move[first + axis] = 1.0
                    move[first + 3:first + 6] = turned[axis]
                elif slot.endswith((".rx", ".ry", ".rz")):
                    move[first + 3 + axis] = 1.0 / size
                elif slot == f"{end}.angle":
                    move[first + 5] = 1.0 / size
                else:
                    continue
                kept = np.zeros(12, dtype=bool)
                kept[[first + c for c in parts]] = True
                yield i, slot, np.where(kept, move, 0.0)


def _wound(limb: Limb, values: Mapping[str, float]) -> float:
    """Return by how much a rope's offset grows as its pulley turns about z with the base, m/rad.

    For a planar pulley, whose zero has no slot of its own to turn: the offset takes its place.
    """
    if not limb.kind.pulley or not limb.kind.axes_without_errors:
        return 0.0
    axis = limb.constants[limb.kind.axes_without_errors[0]]
    return float(values[limb.kind.pulley.radius] * axis[2])


def _some(mechanism: Mechanism, q: Array, free: Sequence[int]) -> tuple[Closure, Array]:
    """Return the closure and poses (n, 8) of a few of the rows (N, k)."""
    some = q[np.linspace(0, len(q) - 1, min(len(q), POSES)).astype(int)]
    model = Model(replace(mechanism, effects=()))
    some = some[finite_rows(some)]
    pose = forward(model, some).pose
    good = finite_rows(pose)
    return model.closure(some[good], free), pose[good]


def _shown(mechanism: Mechanism, q: Array, free: Sequence[int]) -> Array:
    """Return what surplus equations of some rows show about free parameters (r, F)."""
    closure, pose = _some(mechanism, q, free)
    if not len(pose) or not mechanism.surplus:
        return np.zeros((0, len(free)))
    basis = surplus(mechanism, closure.pose_matrix(pose))
    shown = np.swapaxes(basis, -1, -2) @ closure.error_matrix(pose, free)
    return np.asarray(shown.reshape(-1, len(free)))


def _read(mechanism: Mechanism, data: Dataset, free: Sequence[int]) -> Array:
    """Return what an encoder at a joint shows about free parameters (r, F), up to its offset."""
    closure, pose = _some(mechanism, data.q, free)
    if not len(pose):
        return np.zeros((0, len(free)))
    reading = JointReading(closure, pose, data.kind.at)
    by_pose = reading.by_pose[:, mechanism.dof, None]
    a = closure.pose_matrix(pose)
    by_gap = held_by(closure, pose, a, by_pose)[..., 0]
    shown = -np.asarray(np.einsum("nm,nmf->nf", by_gap, closure.error_matrix(pose, free)))
    columns = closure.columns[reading.limb]
    if columns:
        own = reading.by_parameters(columns, closure.slots[reading.limb])
        shown[:, [list(free).index(p) for p in columns]] += own
    return np.asarray(shown - shown.mean(axis=0)) if data.offset.fitted else shown
