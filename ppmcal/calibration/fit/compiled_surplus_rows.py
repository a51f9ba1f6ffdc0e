"""Rows of machines with surplus equations, compiled: white, and with their pose eliminated.

A row's closure c at its joint values and its instrument's measurements are whitened together:

    (D c, V (y - h)),    moved by its pose as    P = (D A, V H),

where D is one over the noise of each equation due to its joint and its gap. Reflections make P a
triangle; the rest of a row, below it, is what no pose explains and all the information in the row
(Golub and Pereyra 1973). :mod:`raw_rows` and :mod:`white_rows` give the same in another basis, with
the same sums and squares.
"""

from __future__ import annotations

import math

import numpy as np

from ppmcal.calibration.fit.compiled_rows import (
    add_normal,
    products,
    seen_point,
    sight_rows,
    turn_left,
)
from ppmcal.calibration.fit.nuisance_columns import InstrumentTables
from ppmcal.kinematics.compilation import compiled, part
from ppmcal.kinematics.compiled_algebra import displace, pack, unpack
from ppmcal.kinematics.compiled_closure import (
    BLOCK,
    chains_at,
    equations_at,
    middles_at,
    pairings,
    pose_rows,
    set_runs,
    sizes_at,
    stage_lines,
)
from ppmcal.kinematics.compiled_surplus import rates_at, spreads_at
from ppmcal.kinematics.limb_tables import EntryTables, LimbTables
from ppmcal.linalg import Array, Ints


@part
def reflected(T: Array, d: int, pivot: Array) -> None:
    """Reduce the first d columns of a matrix to a triangle by reflections of its rows.

    ``T`` (c, n) holds columns; ``pivot`` (d,) becomes the triangle's diagonal, and column j of T
    holds the triangle's entries above it.
    """
    columns, n = T.shape
    for k in range(d):
        square = 0.0
        for i in range(k, n):
            square += T[k, i] * T[k, i]
        pivot[k] = -math.copysign(math.sqrt(square), T[k, k])
        if not square > 0.0:
            continue
        T[k, k] -= pivot[k]
        f = -1.0 / (pivot[k] * T[k, k])
        for j in range(k + 1, columns):
            total = 0.0
            for i in range(k, n):
                total += T[k, i] * T[j, i]
            total *= f
            for i in range(k, n):
                T[j, i] -= total * T[k, i]


@part
def solved_triangle(T: Array, pivot: Array, x: Array) -> None:
    """Fill x (d,) with the least-squares solution for column d of T, from :func:`reflected`."""
    d = x.shape[0]
    for k in range(d - 1, -1, -1):
        x[k] = T[d, k]
        for j in range(k + 1, d):
            x[k] -= T[j, k] * x[j]
        x[k] /= pivot[k]


@part
def pose_columns(white: Array, A: Array, c: Array, by: Array, seen: Array, dof: Ints, T: Array
                 ) -> float:
    """Fill the first d columns of T with P, and column d with the residual; return its square.

    ``white`` (m,): D; ``by`` (k, 6) and ``seen`` (k, f + 1), white: see :func:`sight_rows`.
    """
    m, d = A.shape
    last = seen.shape[1] - 1
    total = 0.0
    for e in range(m):
        for j in range(d):
            T[j, e] = white[e] * A[e, j]
        T[d, e] = -white[e] * c[e]
        total += T[d, e] * T[d, e]
    for i in range(by.shape[0]):
        for j in range(d):
            T[j, m + i] = by[i, dof[j]]
        T[d, m + i] = seen[i, last]
        total += T[d, m + i] * T[d, m + i]
    return total


@compiled
def likely_rows(limbs: LimbTables, sight: InstrumentTables, noise: Array, gaps: Array, u: Array,
                pose: Array, shown: Array, white: Array, steps: int, still: float, slack: float
                ) -> Array:
    """Move poses (N, 8) in place to the most likely ones of the rows; return their squares (N,).

    Like :func:`latent_poses.most_likely`, row by row.

    Args:
        limbs: of the closure.
        sight: the instrument, with k coordinates.
        noise: of the limbs' joint coordinates (L,), m or rad.
        gaps: of the equations (m,), m.
        u: joint coordinates (N, L).
        pose: platform motors (N, 8) by joints alone.
        shown: measurements (N, 6), 0 where nothing was measured.
        white: 1/sigma (N, k), 0 where nothing was measured.
        steps: maximum number of steps.
        still: steps below this end the iteration, m and rad.
        slack: a value counts as larger only if by more than this part.
    """
    count, m, d, k = pose.shape[0], limbs.form.shape[0], limbs.dof.shape[0], white.shape[1]
    out, f = np.full(count, math.nan), sight.parts.shape[0]
    chain, size, c = limbs.ends[:, :, 0].copy(), np.empty((m, 3)), np.empty(m)
    line, A, rate, own = np.empty((m, 6)), np.empty((m, d)), np.empty(m), np.empty(m)
    rotor, body, best = np.empty(4), np.empty(12), np.empty(8)
    R, t, arm, point, turned = body[:9], body[9:], np.empty(3), np.empty(3), np.zeros(3)
    work, more, by, seen = (np.empty((3, 4)), np.empty((4, 9)), np.empty((k, 6)),
                            np.empty((k, f + 1)))
    T, pivot, x, step = np.zeros((d + 1, m + k)), np.empty(d), np.empty(d), np.empty(6)
    turns = k > 0 and sight.coordinates[-1] > 2
    for n in range(count):
        chains_at(limbs, u[n], chain)
        sizes_at(limbs, chain, size)
        unpack(pose[n], rotor, R, t)
        least = math.inf
        best[:] = pose[n]
        for _ in range(steps):
            equations_at(limbs, chain, size, R, t, c, line)
            pose_rows(line, t, limbs.dof, A)
            rates_at(limbs, u[n], chain, size, R, line, rate)
            spreads_at(limbs, noise, gaps, rate)
            for e in range(m):
                own[e] = 1.0 / rate[e]
            if k > 0:
                seen_point(sight, body, arm, point)
                if turns:
                    turn_left(sight, rotor, shown[n], work, turned)
                sight_rows(sight, body, shown[n], white[n], arm, point, turned, more, by, seen)
            value = pose_columns(own, A, c, by, seen, limbs.dof, T)
            if not value <= (1.0 + slack) * least:
                break
            least = min(value, least)
            pack(rotor, t, best)
            reflected(T, d, pivot)
            out[n] = 0.0
            for i in range(d, m + k):
                out[n] += T[d, i] * T[d, i]
            solved_triangle(T, pivot, x)
            step[:] = 0.0
            largest = 0.0
            for j in range(d):
                step[limbs.dof[j]] = x[j]
                largest = max(largest, abs(x[j]))
            if not largest > still or not largest < math.inf:
                break
            displace(step, d > 3 or limbs.dof[d - 1] > 2, rotor, R, t)
        pose[n] = best
    return out


@compiled
def white_rows(limbs: LimbTables, entries: EntryTables, sight: InstrumentTables, columns: Ints,
               noise: Array, gaps: Array, u: Array, q: Array, pose: Array, shown: Array,
               white: Array, weight: Array, out: Array) -> Array:
    """Fill rows (J r), or return the upper half of (J r)^T (J r) without forming them.

    Arguments as for :func:`compiled_rows.white_rows` and :func:`likely_rows`: ``pose`` (N, 8) are
    the rows' most likely poses, ``weight`` (N,) multiplies their residuals, ``out``
    (N, m + k - d, C + 1) is zeros, or (0, m + k - d, C + 1) for sums.
    """
    rows, m, d, k = pose.shape[0], limbs.form.shape[0], limbs.dof.shape[0], white.shape[1]
    count, rest, summing = entries.place.shape[0], columns.shape[0], out.shape[0] == 0
    left = m + k - d
    sums, across = np.zeros((count + rest, count + rest)), np.zeros((4, count + rest))
    chain, size, c = limbs.ends[:, :, 0].copy(), np.empty((m, 3)), np.empty(m)
    line, middle, A = np.empty((m, 6)), np.empty((m, 6)), np.empty((m, d))
    rate, own, rotor, body = np.empty(m), np.empty(m), np.empty(4), np.empty(12)
    R, t, arm, point, turned = body[:9], body[9:], np.empty(3), np.empty(3), np.zeros(3)
    work, more, by, seen = (np.empty((3, 4)), np.empty((4, 9)), np.empty((k, 6)),
                            np.empty((k, rest)))
    # columns: P, residual, equations, open parts
    T, pivot = np.zeros((d + m + rest, m + k)), np.empty(d)
    G, value = np.empty((BLOCK, m, left)), np.zeros((BLOCK, count))
    staged = np.zeros((m, 6, 6, BLOCK))
    both, pairs = np.zeros((left, m + rest, BLOCK)), np.zeros((m + rest, m + rest, BLOCK))
    turns = k > 0 and sight.coordinates[-1] > 2
    for begin in range(0, rows, BLOCK):
        block = min(BLOCK, rows - begin)
        for w in range(block):
            n = begin + w
            chains_at(limbs, u[n], chain)
            unpack(pose[n], rotor, R, t)
            sizes_at(limbs, chain, size)
            equations_at(limbs, chain, size, R, t, c, line)
            middles_at(limbs, chain, size, middle)
            stage_lines(limbs, entries, chain, body, line, middle, staged, w)
            pose_rows(line, t, limbs.dof, A)
            rates_at(limbs, u[n], chain, size, R, line, rate)
            spreads_at(limbs, noise, gaps, rate)
            if k > 0:
                seen_point(sight, body, arm, point)
                if turns:
                    turn_left(sight, rotor, shown[n], work, turned)
                sight_rows(sight, body, shown[n], white[n], arm, point, turned, more, by, seen)
            T[d + 1:] = 0.0
            for e in range(m):
                own[e] = 1.0 / rate[e]
                T[d + 1 + e, e] = own[e]
            for i in range(k):
                for a in range(rest - 1):
                    T[d + 1 + m + a, m + i] = seen[i, a]
            pose_columns(own, A, c, by, seen, limbs.dof, T)
            reflected(T, d, pivot)
            for i in range(left):
                for a in range(rest - 1):
                    both[i, m + a, w] = weight[n] * T[d + 1 + m + a, d + i]
                both[i, m + rest - 1, w] = weight[n] * T[d, d + i]
                for e in range(m):
                    G[w, e, i] = weight[n] * T[d + 1 + e, d + i]
                    both[i, e, w] = G[w, e, i]
        pairings(entries, staged, q[begin:begin + block], block, value)
        if summing:
            both[:, :, block:] = 0.0
            products(both, pairs)
            add_normal(entries, pairs, value, across, sums)
            continue
        for w in range(block):
            set_runs(entries, G[w], value[w], out[begin + w])
            for i in range(left):
                for a in range(rest):
                    out[begin + w, i, columns[a]] = both[i, m + a, w]
    return sums
