"""Closure, Newton steps and error columns row by row, compiled: for many rows.

The same formulas as :mod:`closure`, :mod:`forward` and :mod:`limb_groups`, fused into one loop over
the rows, so that no intermediate result is stored for all rows. Importing this module imports
numba, which takes a quarter of a second: :mod:`compiled_limbs` does so only if there are many
rows. Parts are compiled into each function that uses them.

``chain`` (L, 3, 12) holds the ends of the base, middle and platform chain of each limb: a rotation,
row by row, and a translation.
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
    solve_transposed,
    unpack,
)
from ppmcal.kinematics.compiled_pulley import over_pulley_at
from ppmcal.kinematics.limb_tables import EntryTables, LimbTables
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.limbs.surfaces import LEVER

SPHERE, BASE_PLANE, PLATFORM_PLANE, ANGLE, BETWEEN_AXES, OVER_SHEAVE, OVER_SWIVEL = range(7)
STILL, SLIDES, TURNS = 0, 1, 2
BLOCK = 8
"""Rows whose pairings are computed together, so that one instruction serves several."""
SAME = 1e-4
"""After a step below this (translations relative to the length scale, rad) A is not recomputed: the
next step is off by this part of itself."""


@part
def chains_at(limbs: LimbTables, u: Array, chain: Array) -> None:
    """Fill the ends of the chains of all limbs at joint coordinates u (L,)."""
    for leg in range(limbs.drive.shape[0]):
        for k in range(3):
            moves = limbs.drive[leg, k]
            if moves == STILL:
                continue
            f, g = u[leg], 0.0
            if moves == TURNS:
                f, g = math.cos(u[leg]), math.sin(u[leg])
            for i in range(12):
                chain[leg, k, i] = (limbs.ends[leg, k, 0, i] + f * limbs.ends[leg, k, 1, i]
                                  + g * limbs.ends[leg, k, 2, i])


@part
def sizes_at(limbs: LimbTables, chain: Array, size: Array) -> None:
    """Fill the radius of each equation and its inverse (d, 3), 1 if there is none.

    For ropes over pulleys these, and the third, depend on the pose: :func:`over_pulley_at`.
    """
    for e in range(limbs.form.shape[0]):
        mid = chain[limbs.limb[e], 1]
        r = 0.0
        if limbs.form[e] == SPHERE:
            r = math.sqrt(mid[9] * mid[9] + mid[10] * mid[10] + mid[11] * mid[11])
        size[e, 0], size[e, 1] = r, 1.0 / r if r > 0.0 else 1.0


@part
def equations_at(limbs: LimbTables, chain: Array, size: Array, R: Array, t: Array, c: Array,
                 line: Array) -> None:
    """Fill misclosures (d,) and lines (d, 6) at a pose R (9,), t (3,)."""
    for leg in range(limbs.drive.shape[0]):
        base, mid, end = chain[leg, 0], chain[leg, 1], chain[leg, 2]
        x = R[0] * end[9] + R[1] * end[10] + R[2] * end[11] + t[0]
        y = R[3] * end[9] + R[4] * end[10] + R[5] * end[11] + t[1]
        z = R[6] * end[9] + R[7] * end[10] + R[8] * end[11] + t[2]
        for e in range(limbs.first[leg], limbs.first[leg + 1]):
            a = limbs.axis[e]
            if limbs.form[e] >= OVER_SHEAVE:
                over_pulley_at(base, mid[9 + a], limbs.wheel[leg], limbs.form[e] == OVER_SWIVEL,
                               x, y, z, c, line, size, e)
                continue
            if limbs.form[e] >= ANGLE:
                direction_at(base, end, R, a, limbs.other[e], float(limbs.form[e] - ANGLE), x, y, z,
                             c, line, e)
                continue
            p1, p2, p3 = x, y, z
            if limbs.form[e] == SPHERE:
                r, f = size[e, 0], size[e, 1]
                n1, n2, n3 = x - base[9], y - base[10], z - base[11]
                c[e] = 0.5 * f * (n1 * n1 + n2 * n2 + n3 * n3 - r * r)
                n1, n2, n3 = f * n1, f * n2, f * n3
            elif limbs.form[e] == BASE_PLANE:
                n1, n2, n3 = base[a], base[3 + a], base[6 + a]
                c[e] = (n1 * (x - base[9]) + n2 * (y - base[10]) + n3 * (z - base[11])
                        - mid[9 + a])
            else:
                m1, m2, m3 = end[a], end[3 + a], end[6 + a]
                n1 = R[0] * m1 + R[1] * m2 + R[2] * m3
                n2 = R[3] * m1 + R[4] * m2 + R[5] * m3
                n3 = R[6] * m1 + R[7] * m2 + R[8] * m3
                off = mid[a] * mid[9] + mid[3 + a] * mid[10] + mid[6 + a] * mid[11]
                p1, p2, p3 = base[9], base[10], base[11]
                c[e] = n1 * (x - p1) + n2 * (y - p2) + n3 * (z - p3) - off
            line[e, 0], line[e, 1], line[e, 2] = n1, n2, n3
            line[e, 3] = p2 * n3 - p3 * n2
            line[e, 4] = p3 * n1 - p1 * n3
            line[e, 5] = p1 * n2 - p2 * n1


@part
def direction_at(base: Array, end: Array, R: Array, i: int, j: int, meet: float, x: float, y: float,
                 z: float, c: Array, line: Array, e: int) -> None:
    """Fill misclosure and line of a condition e on directions; x, y, z: the platform's point.

    Like :func:`surfaces._angle` (``meet`` 0) and :func:`surfaces._between_axes` (1); without
    branches, which would slow down machines without such a condition.
    """
    apart = 1.0 - meet
    a1, a2, a3 = base[i], base[3 + i], base[6 + i]
    b1 = R[0] * end[j] + R[1] * end[3 + j] + R[2] * end[6 + j]
    b2 = R[3] * end[j] + R[4] * end[3 + j] + R[5] * end[6 + j]
    b3 = R[6] * end[j] + R[7] * end[3 + j] + R[8] * end[6 + j]
    d1, d2, d3 = x - base[9], y - base[10], z - base[11]
    n1, n2, n3 = a2 * d3 - a3 * d2, a3 * d1 - a1 * d3, a1 * d2 - a2 * d1
    f = meet / math.sqrt(meet * (n1 * n1 + n2 * n2 + n3 * n3) + apart)
    n1, n2, n3 = f * n1 + apart * a1, f * n2 + apart * a2, f * n3 + apart * a3
    w1, w2, w3 = a2 * n3 - a3 * n2, a3 * n1 - a1 * n3, a1 * n2 - a2 * n1
    k = meet * (w1 * b1 + w2 * b2 + w3 * b3) / (meet * (w1 * d1 + w2 * d2 + w3 * d3) + apart)
    c[e] = LEVER * (n1 * b1 + n2 * b2 + n3 * b3)
    b1, b2, b3 = b1 - k * x, b2 - k * y, b3 - k * z
    line[e, 0], line[e, 1], line[e, 2] = -LEVER * k * n1, -LEVER * k * n2, -LEVER * k * n3
    line[e, 3] = LEVER * (b2 * n3 - b3 * n2)
    line[e, 4] = LEVER * (b3 * n1 - b1 * n3)
    line[e, 5] = LEVER * (b1 * n2 - b2 * n1)


@part
def middles_at(limbs: LimbTables, chain: Array, size: Array, middle: Array) -> None:
    """Fill each equation's line in the middle chain's root axes (d, 6).

    For a rope over a pulley its moment about itself is the pulley's: the decrease of c by radius.
    """
    for e in range(limbs.form.shape[0]):
        mid, a = chain[limbs.limb[e], 1], limbs.axis[e]
        for i in range(6):
            middle[e, i] = 0.0
        if limbs.form[e] == SPHERE:
            for i in range(3):
                middle[e, i] = mid[9 + i] * size[e, 1]
        elif limbs.form[e] == BASE_PLANE:
            middle[e, a] = 1.0
            i, j = (a + 1) % 3, (a + 2) % 3
            middle[e, 3 + i] = mid[9 + j]
            middle[e, 3 + j] = -mid[9 + i]
        elif limbs.form[e] == PLATFORM_PLANE:
            for i in range(3):
                middle[e, i] = mid[3 * i + a]
        elif limbs.form[e] >= OVER_SHEAVE:
            middle[e, a], middle[e, 3 + a] = 1.0, size[e, 2]


@part
def pose_rows(line: Array, t: Array, dof: Ints, A: Array) -> None:
    """Fill A (d, d): the lines about the platform's origin t (3,)."""
    for e in range(line.shape[0]):
        n1, n2, n3 = line[e, 0], line[e, 1], line[e, 2]
        for j in range(dof.shape[0]):
            at = dof[j]
            if at < 3:
                A[e, j] = line[e, at]
            elif at == 3:
                A[e, j] = line[e, 3] - (t[1] * n3 - t[2] * n2)
            elif at == 4:
                A[e, j] = line[e, 4] - (t[2] * n1 - t[0] * n3)
            else:
                A[e, j] = line[e, 5] - (t[0] * n2 - t[1] * n1)


@compiled
def newton_rows(limbs: LimbTables, u: Array, pose: Array, scale: float, reach: float,
                iterations: int, smallest: float, closed: float) -> tuple[Bools, Array, Array]:
    """Newton on the closure of each row, like :func:`forward.newton`; ``pose`` (N, 8) in place.

    Returns:
        converged (N,), lengths of the first two steps (N, 2), and the signs of det A (N, 2) at
        the start and at the end.
    """
    count, d = pose.shape[0], limbs.dof.shape[0]
    converged = np.zeros(count, dtype=np.bool_)
    sizes, signs = np.zeros((count, 2)), np.zeros((count, 2))
    chain = limbs.ends[:, :, 0].copy()
    c, line, size_of = np.empty(d), np.empty((d, 6)), np.empty((d, 3))
    A, order, step = np.empty((d, d)), np.empty(d, dtype=np.int64), np.empty(6)
    quaternion, body = np.empty(4), np.empty(12)
    R, t = body[:9], body[9:]
    for n in range(count):
        chains_at(limbs, u[n], chain)
        sizes_at(limbs, chain, size_of)
        unpack(pose[n], quaternion, R, t)
        size = math.inf
        for k in range(iterations):
            equations_at(limbs, chain, size_of, R, t, c, line)
            # after a small step A is nearly unchanged, and the next step as good as with its own
            if not size < SAME:
                pose_rows(line, t, limbs.dof, A)
                sign = factorise(A, order)
                signs[n, 1] = sign
                if k == 0:
                    signs[n, 0] = sign
                if not abs(sign) > 0.0:    # then the order of its rows is incomplete
                    if k < 2:
                        sizes[n, k] = math.nan
                    break
            worst = 0.0
            for e in range(d):
                worst = max(worst, abs(c[e]))
            solve_factorised(A, order, c)
            step[:] = 0.0
            for j in range(d):
                step[limbs.dof[j]] = -c[j]
            size = math.hypot(
                math.sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2) / scale,
                math.sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2))
            if k < 2:
                sizes[n, k] = size
            if not size < 10.0 * reach / scale:
                break
            displace(step, d > 3 or limbs.dof[d - 1] > 2, quaternion, R, t)
            if size < smallest and worst < closed * reach:
                converged[n] = True
                break
        pack(quaternion, t, pose[n])
    return converged, sizes, signs


@part
def store_line(seen: Array, e: int, k: int, w: int, n1: float, n2: float, n3: float, m1: float,
               m2: float, m3: float) -> None:
    """Store the line seen from stage k of equation e in row w."""
    seen[e, k, 0, w], seen[e, k, 1, w], seen[e, k, 2, w] = n1, n2, n3
    seen[e, k, 3, w], seen[e, k, 4, w], seen[e, k, 5, w] = m1, m2, m3


@part
def store_carried_back(at: Array, seen: Array, e: int, k: int, w: int, n1: float, n2: float,
                       n3: float, m1: float, m2: float, m3: float) -> None:
    """Store a line as seen from axes (12,) given by a rotation and a translation."""
    m1 -= at[10] * n3 - at[11] * n2
    m2 -= at[11] * n1 - at[9] * n3
    m3 -= at[9] * n2 - at[10] * n1
    store_line(seen, e, k, w,
               at[0] * n1 + at[3] * n2 + at[6] * n3, at[1] * n1 + at[4] * n2 + at[7] * n3,
               at[2] * n1 + at[5] * n2 + at[8] * n3, at[0] * m1 + at[3] * m2 + at[6] * m3,
               at[1] * m1 + at[4] * m2 + at[7] * m3, at[2] * m1 + at[5] * m2 + at[8] * m3)


@part
def stage_lines(limbs: LimbTables, entries: EntryTables, chain: Array, body: Array, line: Array,
                middle: Array, seen: Array, w: int) -> None:
    """Fill each equation's line (d, 6, 6, BLOCK) in the axes of each stage's twists, row w.

    ``body`` (12,): the platform's pose.
    """
    for e in range(line.shape[0]):
        leg, first = limbs.limb[e], entries.first
        n1, n2, n3, m1, m2, m3 = (line[e, 0], line[e, 1], line[e, 2], line[e, 3], line[e, 4],
                                  line[e, 5])
        if first[e, 0] < first[e, 1]:
            store_line(seen, e, 0, w, n1, n2, n3, m1, m2, m3)
        if first[e, 1] < first[e, 2]:
            store_carried_back(chain[leg, 0], seen, e, 1, w, n1, n2, n3, m1, m2, m3)
        if first[e, 4] < first[e, 6]:
            store_carried_back(body, seen, e, 4, w, n1, n2, n3, m1, m2, m3)
        if first[e, 5] < first[e, 6]:
            store_carried_back(chain[leg, 2], seen, e, 5, w,
                               seen[e, 4, 0, w], seen[e, 4, 1, w], seen[e, 4, 2, w],
                               seen[e, 4, 3, w], seen[e, 4, 4, w], seen[e, 4, 5, w])
        n1, n2, n3, m1, m2, m3 = (middle[e, 0], middle[e, 1], middle[e, 2], middle[e, 3],
                                  middle[e, 4], middle[e, 5])
        if first[e, 2] < first[e, 3]:
            store_line(seen, e, 2, w, n1, n2, n3, m1, m2, m3)
        if first[e, 3] < first[e, 4]:
            store_carried_back(chain[leg, 1], seen, e, 3, w, n1, n2, n3, m1, m2, m3)


@part
def pairings(entries: EntryTables, seen: Array, q: Array, rows: int, value: Array) -> None:
    """Fill dc/d(entry) (BLOCK, S): the pairing of each entry's twist with its line, row by row."""
    B, raw = entries.twist, np.empty(BLOCK)
    for e in range(seen.shape[0]):
        for k in range(6):
            L = seen[e, k]
            for s in range(entries.first[e, k], entries.first[e, k + 1]):
                b1, b2, b3, b4, b5, b6 = B[s, 0], B[s, 1], B[s, 2], B[s, 3], B[s, 4], B[s, 5]
                for w in range(BLOCK):
                    raw[w] = (L[3, w] * b1 + L[4, w] * b2 + L[5, w] * b3
                              + L[0, w] * b4 + L[1, w] * b5 + L[2, w] * b6)
                at, joint = entries.place[s], entries.joint[s]
                if joint >= 0:
                    for w in range(rows):
                        value[w, at] = raw[w] * q[w, joint]
                else:
                    for w in range(BLOCK):
                        value[w, at] = raw[w]


@part
def by_equation(A: Array, order: Ints, by: Array, dof: Ints, G: Array) -> None:
    """Replace G (d, m) by d(seen)/d(equation) = -by A^-1, nan where A (d, d) has no inverse."""
    regular = abs(factorise(A, order)) > 0.0
    for j in range(G.shape[0]):
        for i in range(G.shape[1]):
            G[j, i] = -by[i, dof[j]] if regular else math.nan
    if regular:
        solve_transposed(A, order, G)


@part
def set_runs(entries: EntryTables, G: Array, value: Array, out: Array) -> None:
    """Set columns (m, C) to the outer products of G (d, m) and entries (S,), run by run."""
    for i in range(out.shape[0]):
        for r in range(entries.runs.shape[0]):
            e, v, c, length, more = (entries.runs[r, 0], entries.runs[r, 1], entries.runs[r, 2],
                                     entries.runs[r, 3], entries.runs[r, 4])
            g = G[e, i]
            if more:
                for j in range(length):
                    out[i, c + j] += g * value[v + j]
            else:
                for j in range(length):
                    out[i, c + j] = g * value[v + j]


@compiled
def fill_columns(limbs: LimbTables, entries: EntryTables, u: Array, q: Array, pose: Array,
                 by_pose: Array, out: Array) -> None:
    """Set columns of d(seen)/d(parameter) (N, m, C) to -by_pose A^-1 Bg; nan where A is singular.

    ``by_pose`` (N or 1, m, 6): d observed/d(origin displacement, rotation) of the platform.
    """
    count, m, d = out.shape[0], out.shape[1], limbs.dof.shape[0]
    chain = limbs.ends[:, :, 0].copy()
    c, line, middle, size_of = (np.empty(d), np.empty((d, 6)), np.empty((d, 6)),
                                np.empty((d, 3)))
    A, order = np.empty((d, d)), np.empty(d, dtype=np.int64)
    quaternion, body = np.empty(4), np.empty(12)
    R, t = body[:9], body[9:]
    seen, value = np.zeros((d, 6, 6, BLOCK)), np.empty((BLOCK, entries.place.shape[0]))
    G = np.empty((BLOCK, d, m))
    for begin in range(0, count, BLOCK):
        rows = min(BLOCK, count - begin)
        for w in range(rows):
            n = begin + w
            chains_at(limbs, u[n], chain)
            unpack(pose[n], quaternion, R, t)
            sizes_at(limbs, chain, size_of)
            equations_at(limbs, chain, size_of, R, t, c, line)
            middles_at(limbs, chain, size_of, middle)
            stage_lines(limbs, entries, chain, body, line, middle, seen, w)
            pose_rows(line, t, limbs.dof, A)
            by_equation(A, order, by_pose[n if by_pose.shape[0] > 1 else 0], limbs.dof, G[w])
        pairings(entries, seen, q[begin:begin + rows], rows, value)
        for w in range(rows):
            set_runs(entries, G[w], value[w], out[begin + w])
