"""Closure by least squares row by row, compiled: for many rows of a machine with surplus equations.

The same formulas as :mod:`least_squares_closure` for equations that each have a drive of their own:
then S is diagonal, and the step that closes gaps best solves the d normal equations A' S^-1 A.
Importing this module imports numba, like :mod:`compiled_closure`.
"""

from __future__ import annotations

import math

import numpy as np

from ppmcal.kinematics.compilation import compiled, part
from ppmcal.kinematics.compiled_algebra import (
    displace,
    factorise,
    pack,
    solve_factorised,
    unpack,
)
from ppmcal.kinematics.compiled_closure import (
    SAME,
    SPHERE,
    STILL,
    TURNS,
    chains_at,
    equations_at,
    pose_rows,
    sizes_at,
)
from ppmcal.kinematics.limb_tables import LimbTables
from ppmcal.linalg import Array, Bools, Ints


@part
def rates_at(limbs: LimbTables, u: Array, chain: Array, size: Array, R: Array, line: Array,
             rate: Array) -> None:
    """Fill dc/du (m,) of spheres and ropes at a rotation R (9,).

    Each by its own limb's joint coordinate.
    """
    for e in range(limbs.form.shape[0]):
        leg = limbs.limb[e]
        rate[e] = 0.0
        for k in range(3):
            if limbs.drive[leg, k] == STILL:
                continue
            f, g = 1.0, 0.0
            if limbs.drive[leg, k] == TURNS:
                f, g = -math.sin(u[leg]), math.cos(u[leg])
            for i in range(3):
                moved = (f * limbs.ends[leg, k, 1, 9 + i] + g * limbs.ends[leg, k, 2, 9 + i])
                if k == 0:
                    rate[e] -= line[e, i] * moved
                elif k == 1:
                    if limbs.form[e] == SPHERE:
                        moved *= chain[leg, 1, 9 + i] * size[e, 1]
                    elif limbs.axis[e] != i:    # for a rope over a pulley, along the rope
                        moved = 0.0
                    rate[e] -= moved
                else:
                    rate[e] += (line[e, 0] * R[i] + line[e, 1] * R[3 + i]
                                + line[e, 2] * R[6 + i]) * moved


@part
def spreads_at(limbs: LimbTables, noise: Array, gaps: Array, rate: Array) -> float:
    """Replace dc/du (m,) by the standard deviations of the equations (m,).

    From the ``noise`` of the limbs' joint coordinates (L,) and the closure gaps (m,). Returns
    the smallest of their variances over the largest if any has a gap; else 1.
    """
    gaping, least, most = False, math.inf, 0.0
    for e in range(rate.shape[0]):
        rate[e] = abs(rate[e] * noise[limbs.limb[e]])
        if gaps[e] > 0.0:
            gaping = True
            rate[e] = math.sqrt(rate[e] * rate[e] + gaps[e] * gaps[e])
        least, most = min(least, rate[e]), max(most, rate[e])
    return least * least / (most * most) if gaping else 1.0


@part
def add_curvature(limbs: LimbTables, chain: Array, size: Array, R: Array, line: Array,
                  force: Array, out: Array) -> None:
    """Add the second derivative of spheres by the pose, times forces (m,), to out (d, d).

    A point at ``a`` from the platform's origin moves by v + w x a, and so does the line n to it.
    Displacements together give f / r, displacement and rotation w x (a / r - n / 2) f, and
    rotations M - tr(M) with M = (n a' + a n') f / 2 - a a' f / r.
    """
    square = x1 = x2 = x3 = 0.0
    m11 = m12 = m13 = m22 = m23 = m33 = 0.0
    for e in range(limbs.form.shape[0]):
        end, f = chain[limbs.limb[e], 2], force[e]
        a1 = R[0] * end[9] + R[1] * end[10] + R[2] * end[11]
        a2 = R[3] * end[9] + R[4] * end[10] + R[5] * end[11]
        a3 = R[6] * end[9] + R[7] * end[10] + R[8] * end[11]
        n1, n2, n3 = f * line[e, 0], f * line[e, 1], f * line[e, 2]
        f *= size[e, 1]
        square += f
        x1 += f * a1 - 0.5 * n1
        x2 += f * a2 - 0.5 * n2
        x3 += f * a3 - 0.5 * n3
        m11 += (n1 - f * a1) * a1
        m22 += (n2 - f * a2) * a2
        m33 += (n3 - f * a3) * a3
        m12 += 0.5 * (n1 * a2 + a1 * n2) - f * a1 * a2
        m13 += 0.5 * (n1 * a3 + a1 * n3) - f * a1 * a3
        m23 += 0.5 * (n2 * a3 + a2 * n3) - f * a2 * a3
    both = ((square, 0.0, 0.0, 0.0, x3, -x2), (0.0, square, 0.0, -x3, 0.0, x1),
            (0.0, 0.0, square, x2, -x1, 0.0), (0.0, -x3, x2, -m22 - m33, m12, m13),
            (x3, 0.0, -x1, m12, -m11 - m33, m23), (-x2, x1, 0.0, m13, m23, -m11 - m22))
    for i in range(out.shape[0]):
        for j in range(out.shape[0]):
            out[i, j] += both[limbs.dof[i]][limbs.dof[j]]


@part
def gradient_at(A: Array, force: Array, g: Array) -> None:
    """Fill A' f (d,) of forces (m,)."""
    m, d = A.shape
    g[:] = 0.0
    for e in range(m):
        for i in range(d):
            g[i] += A[e, i] * force[e]


@part
def normal_rows(A: Array, weight: Array, force: Array, N: Array, g: Array) -> None:
    """Fill A' W A (d, d) of weights (m,) and A' f (d,) of forces (m,)."""
    m, d = A.shape
    gradient_at(A, force, g)
    for i in range(d):
        for j in range(i + 1):
            N[i, j] = 0.0
    for e in range(m):
        for i in range(d):
            f = weight[e] * A[e, i]
            for j in range(i + 1):
                N[i, j] += f * A[e, j]
    for i in range(d):
        for j in range(i):
            N[j, i] = N[i, j]


@part
def length_of(x: Array) -> float:
    """Return the length of a vector (d,)."""
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * x[i]
    return math.sqrt(total)


@part
def solved_step(N: Array, order: Ints, g: Array, x: Array) -> None:
    """Replace x (d,) by -N^-1 g of a factorised N (d, d)."""
    for j in range(x.shape[0]):
        x[j] = -g[j]
    solve_factorised(N, order, x)


@compiled
def newton_rows(limbs: LimbTables, u: Array, pose: Array, scale: float, reach: float,
                iterations: int, smallest: float, most: float, exact: float, small: float,
                noise: Array, gaps: Array) -> tuple[Bools, Array]:
    """Newton to the least closure error, like :func:`forward.newton`; ``pose`` (N, 8) in place.

    ``most``: rows whose second step is above this part of the first are abandoned; ``exact`` and
    ``small``: see :mod:`least_squares_closure`; ``noise`` of joint coordinates (L,) and ``gaps``
    (m,) weight the equations.

    Returns:
        converged (N,) and lengths of the first two steps (N, 2).
    """
    count, m, d = pose.shape[0], limbs.form.shape[0], limbs.dof.shape[0]
    converged, sizes = np.zeros(count, dtype=np.bool_), np.zeros((count, 2))
    chain = limbs.ends[:, :, 0].copy()
    c, line, size_of, rate = np.empty(m), np.empty((m, 6)), np.empty((m, 3)), np.empty(m)
    A, weight, force = np.empty((m, d)), np.empty(m), np.empty(m)
    N, bent, g = np.empty((d, d)), np.empty((d, d)), np.empty(d)
    order, other = np.empty(d, dtype=np.int64), np.empty(d, dtype=np.int64)
    plain, curved, step = np.empty(d), np.empty(d), np.empty(6)
    quaternion, body = np.empty(4), np.empty(12)
    R, t = body[:9], body[9:]
    for n in range(count):
        chains_at(limbs, u[n], chain)
        sizes_at(limbs, chain, size_of)
        unpack(pose[n], quaternion, R, t)
        size, bends = math.inf, False
        for k in range(iterations):
            equations_at(limbs, chain, size_of, R, t, c, line)
            pose_rows(line, t, limbs.dof, A)
            rates_at(limbs, u[n], chain, size_of, R, line, rate)
            alike = spreads_at(limbs, noise, gaps, rate)
            mean = length_of(rate) ** 2 / m
            for e in range(m):
                weight[e] = 1.0 / (rate[e] * rate[e] / mean + exact)
                force[e] = weight[e] * c[e]
            # after a small step both matrices are nearly unchanged, as in compiled_closure; if some
            # equations weigh far more than others, a small rotation is not a small step
            again = size < SAME * alike
            if again:
                gradient_at(A, force, g)
            else:
                normal_rows(A, weight, force, N, g)
                bent[:] = N
                add_curvature(limbs, chain, size_of, R, line, force, bent)
                if not abs(factorise(N, order)) > 0.0:
                    sizes[n, min(k, 1)] = math.nan
                    break
            if not again or not bends:
                solved_step(N, order, g, plain)
            if not again:
                bends = abs(factorise(bent, other)) > 0.0
            if bends:
                solved_step(bent, other, g, curved)
                if not again:
                    # far off, the curvature may lead uphill: then take the step without it
                    down = apart = whole = 0.0
                    for j in range(d):
                        down += curved[j] * g[j]
                        apart += (curved[j] - plain[j]) ** 2
                        whole += (curved[j] if limbs.dof[j] < 3 else curved[j] * scale) ** 2
                    bends = down <= 0.0 and (math.sqrt(apart) <= length_of(plain)
                                             or math.sqrt(whole) < small * scale)
            step[:] = 0.0
            for j in range(d):
                step[limbs.dof[j]] = curved[j] if bends else plain[j]
            size = math.hypot(length_of(step[:3]) / scale, length_of(step[3:]))
            if k < 2:
                sizes[n, k] = size
            if not size < 10.0 * reach / scale:
                break
            if k == 1 and sizes[n, 0] > 1e-6 and size > most * sizes[n, 0]:
                break
            displace(step, d > 3 or limbs.dof[d - 1] > 2, quaternion, R, t)
            if size < smallest:
                converged[n] = True
                break
        pack(quaternion, t, pose[n])
    return converged, sizes


@compiled
def gap_squares(limbs: LimbTables, u: Array, pose: Array) -> Array:
    """Return the sum of the squared gaps, as true lengths, of each row (N,); m^2."""
    m = limbs.form.shape[0]
    out, chain = np.zeros(pose.shape[0]), limbs.ends[:, :, 0].copy()
    c, line, size_of = np.empty(m), np.empty((m, 6)), np.empty((m, 3))
    quaternion, body = np.empty(4), np.empty(12)
    R, t = body[:9], body[9:]
    for n in range(pose.shape[0]):
        chains_at(limbs, u[n], chain)
        sizes_at(limbs, chain, size_of)
        unpack(pose[n], quaternion, R, t)
        equations_at(limbs, chain, size_of, R, t, c, line)
        for e in range(m):
            r = size_of[e, 0]
            gap = math.sqrt(max(r * r + 2.0 * r * c[e], 0.0)) - r if r > 0.0 else c[e]
            out[n] += gap * gap
    return out
