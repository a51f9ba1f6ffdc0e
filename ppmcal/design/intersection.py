"""Forward kinematics by intersection of the limbs' bodies ([PPM] section 3.2).

Planar machines of any limbs here; deltas of three parallelograms and tripods, for whose platforms
other bodies meet, in :mod:`ppmcal.design.intersection_spatial`.

[PPM] starts from limbs whose joint values are all known, passive ones too: the end points B_i
follow, spheres of radius b_i about them meet in a point pair, its middle is the platform's centre,
and the orientation comes from the B_i. Of a machine only the actuated joints are known. So, at
each row of joint values:

1. Lock the actuated joints. What a limb leaves open for its end point B_i is its kinematic
   geometric body: a circle of the plane (a sphere whose centre lies in it) or a line (a plane).
   Turned by phi and carried along -B_i by a translator it is where the platform's centre can be.
   The three bodies and the plane of motion have a point in common at the roots of one
   trigonometric polynomial F(phi), eigenvalues of a companion matrix: all assembly modes at once
   (:mod:`ppmcal.design.assembly_modes_planar`).
2. At each root that point is the meet of the three in the algebra.
3. The limbs are now closed and their end points B_i known; spheres about them, or, where one
   slides along the platform, about where it has slid, are intersected as [PPM] does (eq. 16-27).

No step iterates on the closure. The assembly mode is home's: the joints are led from home in
steps that are small enough for one mode to be where the velocities lead.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ppmcal import algebra as cga
from ppmcal.design.assembly_modes_planar import rotations, weights
from ppmcal.design.assembly_modes_spatial import apart
from ppmcal.design.intersection_spatial import is_tripod, translational_poses, tripod_ends
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.forward import CONTRACTION, SMALLEST_STEP, Forward, moved
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array, finite_rows, solve_rows
from ppmcal.model.mechanism import Mechanism

MEETS = 1e-8
"""Bodies meet where every limb closes to this part of the reach: what a root's round-off leaves."""
SAME = 1e-6
"""Modes nearer than this, in length scales and rad, are one."""
ON_A_LINE = 1e-9
"""End points whose triangle is below this part of its longest edge squared have no orientation."""
PLANE_OF_MOTION = cga.plane(np.array([0.0, 0.0, 1.0]), 0.0)


def require_meet(mechanism: Mechanism) -> None:
    """Refuse a machine whose limbs' bodies do not meet in closed form.

    Raises:
        BadInput: surplus limbs, a spatial machine other than a tripod, universal joints with an
            offset, effects.
    """
    place = f"{mechanism.source} with --method intersection"
    motion = mechanism.motion
    if mechanism.surplus:
        raise BadInput("the limbs' surfaces have no intersection: this machine has more limbs than "
                       "its platform has freedoms, and where joint values contradict each other "
                       "they meet nowhere", place, "Use --method newton")
    if motion.turns and not motion.planar and not is_tripod(mechanism):
        raise BadInput("the limbs' surfaces have no intersection in closed form: this machine is "
                       f"{motion}, its platform turns, and only three limbs on a circle each "
                       "(3-R(P)S) leave an equation in one unknown", place,
                       "Use --method newton; planar machines, deltas of three parallelograms and "
                       "tripods can be intersected")
    turned = [limb for limb, values in zip(mechanism.limbs, Model(mechanism).limb_values,
                                           strict=True) if limb.kind.is_turned(values)]
    over = [limb.name for limb in turned if limb.kind.pulley]
    if over:
        raise BadInput("the limbs' surfaces have no intersection in closed form: "
                       f"{', '.join(over)} run over pulleys, and the end of a rope over a pulley "
                       "is on no sphere",
                       place, "Use --method newton")
    offset = [limb.name for limb in turned]
    if offset:
        raise BadInput("the limbs' surfaces have no intersection in closed form: the axes of a "
                       f"universal joint of {', '.join(offset)} do not meet, so its surface is "
                       "not a sphere", place, "Use --method newton")
    if mechanism.effects:
        kinds = ", ".join(dict.fromkeys(e.kind.name for e in mechanism.effects))
        raise BadInput(f"the intersection is of the geometry alone, and the file has effects "
                       f"({kinds})", place, "Use --method newton, or take the effects out")


def forward_by_intersection(model: Model, q: Array) -> Forward:
    """Return the poses at joint values ``q`` (N, k), SI, in home's assembly mode.

    Raises:
        BadInput: as :func:`require_meet`.
    """
    require_meet(model.mechanism)
    q = np.atleast_2d(np.asarray(q, dtype=float))
    pose, progress = np.full((len(q), 8), np.nan), np.zeros(len(q))
    reason = [""] * len(q)
    for n in np.flatnonzero(finite_rows(q)):
        try:
            pose[n], progress[n] = _led(model, q[n])
        except NoResult as error:
            reason[n] = error.what
    return Forward(pose, progress >= 1.0, progress, tuple(reason))


def _led(model: Model, q: Array) -> tuple[Array, float]:
    """Lead the joints from home to ``q`` (k,); return the pose (8,) and how far they got."""
    home = home_state(model.mechanism).q
    pose, at, step = model.mechanism.home, 0.0, 1.0
    while at < 1.0:
        to = min(at + step, 1.0)
        found = _next_mode(model.closure(home + to * (q - home)), pose)
        if found is not None:
            pose, at, step = found, to, 1.5 * step
        elif step / 2.0 < SMALLEST_STEP:
            return np.full(8, np.nan), at
        else:
            step /= 2.0
    return pose, at


def _next_mode(closure: Closure, pose: Array) -> Array | None:
    """Return the mode (8,) to which the velocities lead from ``pose`` (8,); None if unclear."""
    mechanism = closure.model.mechanism
    before = closure.pose_matrix(pose)
    way = np.zeros((1, 6))
    way[:, mechanism.dof] = -solve_rows(before, closure.misclosure(pose))
    modes = intersections(closure)
    if not len(modes) or not finite_rows(way).all():
        return None
    away = apart(mechanism, modes, moved(pose[None], way)[0])
    first = int(np.argmin(away))
    size = np.hypot(np.linalg.norm(way[0, :3]) / mechanism.length_scale,
                    np.linalg.norm(way[0, 3:]))
    side = np.sign(np.linalg.det(closure.pose_matrix(modes[first])))
    clear = away[first] <= CONTRACTION * size + SAME and side == np.sign(np.linalg.det(before))
    return np.asarray(modes[first]) if clear else None


def intersections(closure: Closure) -> Array:
    """Return motors (n, 8) of all poses in which a machine's bodies meet, each once.

    ``closure`` has one row of joint values.

    Raises:
        NoResult: infinitely many poses close, or the end points are on one line.
    """
    mechanism = closure.model.mechanism
    if not mechanism.motion.turns:
        return _closed(closure, translational_poses(closure))
    if not mechanism.motion.planar:
        _refuse_line(closure, cga.coordinates(closure.moving[:1])[:, ::2])
        return _closed(closure, intersection_pose(*tripod_ends(closure)))
    phi = rotations(closure, weights(closure) != 0.0)
    starts = _closed(closure, _centres(closure, phi) if len(phi) else np.zeros((0, 8)))
    if not len(starts):
        return starts
    ends, local = limb_ends(closure, starts)
    _refuse_line(closure, local)
    return intersection_pose(ends, local)


def _closed(closure: Closure, starts: Array) -> Array:
    """Return those motors (n, 8) at which every limb closes, each once."""
    mechanism = closure.model.mechanism
    starts = starts[finite_rows(starts)]
    with np.errstate(over="ignore", invalid="ignore"):
        gap = np.abs(closure.misclosure(starts)).max(axis=1, initial=0.0)
    starts = starts[np.argsort(gap, kind="stable")][:int((gap < MEETS * mechanism.reach).sum())]
    kept: list[Array] = []
    for pose in starts:
        if not kept or apart(mechanism, np.array(kept), pose).min() > SAME:
            kept.append(pose)
    return np.array(kept).reshape(-1, 8)


def _refuse_line(closure: Closure, local: Array) -> None:
    """Refuse end points (n, 3, 3) on one line (NoResult)."""
    edges = local[:, 1:] - local[:, :1]
    area = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1)
    if np.any(area < ON_A_LINE * np.max(np.sum(edges**2, axis=-1), axis=1)):
        raise NoResult("the limbs' end points on the platform are on one line: spheres about them "
                       "meet in no point pair", closure.model.mechanism.source,
                       "Use --method newton")


def _centres(closure: Closure, phi: Array) -> Array:
    """Return motors of candidates (M, 8): where bodies of the centre meet at rotations ``phi``.

    Two circles, less one another, are the line through both of their points, a plane of the
    algebra: with the plane of motion, the planes of two such pairs (or of lines) meet in a point.
    Where they are parallel, a circle, a plane and the plane of motion meet in a point pair. What
    does not lie on all bodies is dropped by the caller.
    """
    rotor = cga.rotor(np.broadcast_to([0.0, 0.0, 1.0], (len(phi), 3)), phi)
    bodies = _centre_bodies(closure, rotor)
    weight = bodies[..., 4:]
    circles = np.flatnonzero(weight[0, :, 0])
    if circles.size:
        first = bodies[:, circles[:1]]
        planes = np.delete(bodies - weight * first / first[..., 4:], circles[0], axis=1)
    else:
        first, planes = bodies[:, :0], bodies
    points = []
    for i, j in combinations(range(planes.shape[1]), 2):
        points.append(flat_point(cga.meet(planes[:, i], planes[:, j], PLANE_OF_MOTION)))
    if circles.size:
        for i in range(planes.shape[1]):
            both = cga.split(cga.meet(first[:, 0], planes[:, i], PLANE_OF_MOTION))[:2]
            points += [cga.coordinates(p) for p in both]
    return np.concatenate([cga.compose(cga.translator(p), rotor) for p in points])


def _centre_bodies(closure: Closure, rotor: Array) -> Array:
    """Return the bodies (M, d, 5) on which the platform's centre lies, turned by rotors (M, 8).

    A point b of the platform on a body S: the centre is on S carried by -R b. A plane of the
    platform through a point c of the base: the centre is on the plane, turned about the
    centre and carried by c, and mirrored in it: n.(c - x) = d.
    """
    turned = cga.move_vector(rotor[:, None, :], closure.moving)
    out = []
    for k, point_moves in enumerate(closure.point_moves):
        body = np.broadcast_to(closure.fixed[:, k], (len(rotor), 5))
        if point_moves:
            out.append(cga.move_vector(cga.translator(-cga.coordinates(turned[:, k])), body))
        else:
            normal = turned[:, k, :3]
            out.append(cga.plane(normal, np.sum(normal * cga.coordinates(body), axis=-1)
                                 - turned[:, k, 3]))
    return np.stack(out, axis=1)


def flat_point(pair: Array) -> Array:
    """Return where three planes meet (..., 3), of their meet P and infinity; nan if nowhere.

    In the storage of :mod:`ppmcal.algebra.point_pairs`: P = -g / z.
    """
    z = pair[..., 9:]
    return np.asarray(-pair[..., 3:6] / np.where(z == 0.0, np.nan, z), dtype=float)


def limb_ends(closure: Closure, pose: Array) -> tuple[Array, Array]:
    """Return where the closed limbs hold the platform: base axes and platform axes.

    Each limb's passive joints are set to close it ([PPM] eq. 15). The first result is built
    from the base side (centre, strut direction, strut length) wherever the limb ends in a
    revolute or spherical joint; the second from the platform's own slots, or, where the
    limb slides along the platform, from how far it has slid.

    Returns:
        two arrays (N, L, 3), m.
    """
    closure = closure.at(pose)
    contact = closure.contacts(pose)
    own = cga.move_point(cga.reverse(np.atleast_2d(pose))[:, None, :], contact)
    ends, local, row = [], [], 0
    for body in closure.bodies:
        point = contact[:, row]
        if body.radius[:, 0].max() > 0.0:
            centre = cga.coordinates(body.fixed[:, 0])
            along = point - centre
            along = along / np.linalg.norm(along, axis=-1, keepdims=True)
            point = centre + body.radius[:, 0, None] * along
        ends.append(point)
        local.append(own[:, row])
        row += len(body.point_moves)
    return np.stack(ends, axis=1), np.stack(local, axis=1)


def intersection_pose(ends: Array, local: Array) -> Array:
    """Return platform motors (N, 8) from three limb end points, by [PPM]'s construction.

    Spheres about the end points B_i with the platform's own radii b_i = |local_i| meet in a
    point pair; its middle is the foot of the platform centre on the plane of the B_i
    ([PPM] eq. 16-19), which is the centre itself in a planar machine. The orientation comes
    from that plane and the edge B1 B2 (eq. 20-27).

    Args:
        ends: end points in base axes (N, 3, 3), not on one line.
        local: the same points in platform axes (N, 3, 3).
    """
    radius = np.linalg.norm(local, axis=-1)
    pair = cga.meet(*(cga.sphere(ends[:, i], radius[:, i]) for i in range(3)))
    seen, own = _triad(ends), _triad(local)
    rotation = seen @ np.swapaxes(own, -1, -2)
    height = -np.sum(own[..., :, 2] * local[:, 0], axis=-1)
    centre = cga.middle(pair) + height[:, None] * seen[..., :, 2]
    return cga.motor_from_matrix(rotation, centre)


def _triad(points: Array) -> Array:
    """Orthonormal axes (N, 3, 3) from three points: edge 1-2, in-plane normal, plane normal."""
    x = points[:, 1] - points[:, 0]
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    z = np.cross(x, points[:, 2] - points[:, 0])
    z = z / np.linalg.norm(z, axis=-1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=-1)
