"""Residuals and normal equations row by row, compiled: J^T J and J^T r without forming J.

A row's Jacobian is W [by_pose (-A^-1) blockdiag(b) | registration]: m rows that are products of a
small matrix G = -W by_pose A^-1 (m, d) and each equation's own entries b. So entries s and t of
equations e and f meet in J^T J as (G^T G)_ef b_s b_t: one product where J itself would take m.
"""

from __future__ import annotations

import math

import numpy as np

from ppmcal.calibration.fit.nuisance_columns import SCALE, TARGET, TURN, InstrumentTables
from ppmcal.kinematics.compilation import compiled, part
from ppmcal.kinematics.compiled_algebra import unpack
from ppmcal.kinematics.compiled_closure import (
    BLOCK,
    by_equation,
    chains_at,
    equations_at,
    middles_at,
    pairings,
    pose_rows,
    set_runs,
    sizes_at,
    stage_lines,
)
from ppmcal.kinematics.limb_tables import EntryTables, LimbTables
from ppmcal.linalg import Array, Ints


@part
def times(a: Array, b: Array, out: Array) -> None:
    """Fill ``out`` with the product of two rotors (4,)."""
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] - a[2] * b[3] + a[3] * b[2]
    out[2] = a[0] * b[2] + a[2] * b[0] - a[3] * b[1] + a[1] * b[3]
    out[3] = a[0] * b[3] + a[3] * b[0] - a[1] * b[2] + a[2] * b[1]


@part
def turn_left(sight: InstrumentTables, rotor: Array, shown: Array, work: Array, turned: Array
              ) -> None:
    """Fill the rotation vector (3,) from the predicted to the measured rotation.

    ``rotor`` (4,) of the platform; ``shown`` (6,): measured; ``work`` (3, 4).
    """
    first, seen, own = work[0], work[1], work[2]
    times(sight.frame_rotor, rotor, first)
    times(first, sight.body, seen)
    if sight.planar:
        angle = math.atan2(2.0 * (seen[1] * seen[2] - seen[0] * seen[3]),
                           1.0 - 2.0 * (seen[2] * seen[2] + seen[3] * seen[3]))
        left = shown[5] - angle
        turned[0], turned[1] = 0.0, 0.0
        turned[2] = left - 2.0 * math.pi * np.round(left / (2.0 * math.pi))
        return
    half = 0.5 * math.sqrt(shown[3] ** 2 + shown[4] ** 2 + shown[5] ** 2)
    sinc = math.sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0
    own[0] = math.cos(half)
    for i in range(3):
        own[1 + i] = -0.5 * sinc * shown[3 + i]
        seen[1 + i] = -seen[1 + i]
    times(own, seen, first)
    sine = math.sqrt(first[1] ** 2 + first[2] ** 2 + first[3] ** 2)
    phi = math.atan2(sine, abs(first[0]))
    ratio = phi / sine if sine > 1e-8 else 1.0 + phi * phi / 6.0
    if first[0] < 0.0:
        ratio = -ratio
    for i in range(3):
        turned[i] = -2.0 * ratio * first[1 + i]


@part
def seen_point(sight: InstrumentTables, body: Array, arm: Array, point: Array) -> None:
    """Fill the target relative to the platform's origin (3,), base axes, and as measured (3,)."""
    F, x = sight.frame, sight.target
    for i in range(3):
        arm[i] = body[3 * i] * x[0] + body[3 * i + 1] * x[1] + body[3 * i + 2] * x[2]
    for i in range(3):
        point[i] = (F[3 * i] * (arm[0] + body[9]) + F[3 * i + 1] * (arm[1] + body[10])
                    + F[3 * i + 2] * (arm[2] + body[11]) + F[9 + i])


@part
def crossed(row: Array, v: Array, j: int) -> float:
    """Return component j of row (3,) times [v], with [v] w = v x w."""
    a, b = (j + 1) % 3, (j + 2) % 3
    return float(row[a] * v[b] - row[b] * v[a])


@part
def sight_rows(sight: InstrumentTables, body: Array, shown: Array, white: Array, arm: Array,
               point: Array, turned: Array, work: Array, by: Array, seen: Array) -> None:
    """Fill white derivatives by pose (m, 6), and by open parts with the residual last (m, f + 1).

    ``work`` (4, 9): scratch.
    """
    F, both, half, slope = sight.frame, work[0], work[1], work[2]
    count = sight.parts.shape[0]
    for i in range(3):
        for j in range(3):
            both[3 * i + j] = (F[3 * i] * body[j] + F[3 * i + 1] * body[3 + j]
                               + F[3 * i + 2] * body[6 + j])
    half[:] = 0.0
    half[0] = half[4] = half[8] = 1.0
    half[1], half[2], half[5] = -0.5 * turned[2], 0.5 * turned[1], -0.5 * turned[0]
    half[3], half[6], half[7] = 0.5 * turned[2], -0.5 * turned[1], 0.5 * turned[0]
    row, own = work[3, :3], work[3, 3:6]
    for k in range(sight.coordinates.shape[0]):
        i = sight.coordinates[k]
        place = i < 3
        f = white[k] * (sight.scale if place else 1.0)
        at = i if place else i - 3
        for j in range(3):
            if place:
                row[j] = F[3 * at + j]
            else:
                row[j] = (half[3 * at] * F[j] + half[3 * at + 1] * F[3 + j]
                          + half[3 * at + 2] * F[6 + j])
        for j in range(3):
            by[k, j] = f * row[j] if place else 0.0
            by[k, 3 + j] = -f * crossed(row, arm, j) if place else f * row[j]
        if not place:
            for j in range(3):
                own[j] = (half[3 * at] * both[j] + half[3 * at + 1] * both[3 + j]
                          + half[3 * at + 2] * both[6 + j])
            for j in range(3):
                slope[j] = (own[0] * sight.slope[j] + own[1] * sight.slope[3 + j]
                            + own[2] * sight.slope[6 + j])
        for a in range(count):
            p, v = sight.parts[a], 0.0
            if p < 3:
                v = 1.0 if place and p == at else 0.0
            elif p < TARGET:
                if place:
                    # row at of -[point - about]
                    j = p - 3
                    if j != at:
                        o = 3 - at - j
                        d = point[o] - sight.about[o]
                        v = d if (at + 1) % 3 == j else -d
                else:
                    v = half[3 * at + p - 3]
            elif p < TURN:
                v = both[3 * at + p - TARGET] if place else 0.0
            elif p < SCALE:
                v = 0.0 if place else slope[p - TURN]
            else:
                v = point[at] / sight.scale if place else 0.0
            seen[k, a] = f * v
        shift = shown[i] - sight.scale * point[at] if place else turned[at]
        seen[k, count] = white[k] * shift


@compiled
def row_squares(sight: InstrumentTables, pose: Array, shown: Array, white: Array) -> Array:
    """Return the squared white residual of each row (N,).

    Args:
        sight: the instrument, with m coordinates.
        pose: platform motors (N, 8).
        shown: measurements (N, 6), 0 where nothing was measured.
        white: 1/sigma (N, m), 0 where nothing was measured.
    """
    out = np.zeros(pose.shape[0])
    rotor, body, arm, point, turned = (np.empty(4), np.empty(12), np.empty(3), np.empty(3),
                                       np.empty(3))
    work = np.empty((3, 4))
    turns = sight.coordinates[-1] > 2
    for n in range(pose.shape[0]):
        unpack(pose[n], rotor, body[:9], body[9:])
        seen_point(sight, body, arm, point)
        if turns:
            turn_left(sight, rotor, shown[n], work, turned)
        for k in range(sight.coordinates.shape[0]):
            i = sight.coordinates[k]
            left = shown[n, i] - sight.scale * point[i] if i < 3 else turned[i - 3]
            out[n] += (white[n, k] * left) ** 2
    return out


@part
def add_four(a: float, b: float, c: float, d: float, w: Array, x: Array, y: Array, z: Array,
             out: Array) -> None:
    """Add four rows times their factors to a row of the same length, read and written once."""
    # slices from 0 on: for an index that might be negative the sign is tested each time
    for j in range(out.shape[0]):
        out[j] += (a * w[j] + b * x[j]) + (c * y[j] + d * z[j])


@part
def products(both: Array, pairs: Array) -> None:
    """Fill the upper half of Q^T Q (b, b, BLOCK) for several Q (m, b, BLOCK) side by side."""
    m, size = both.shape[0], both.shape[1]
    for e in range(size):
        for f in range(e, size):
            # BLOCK separate sums: a loop over them would go through memory
            s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0
            for i in range(m):
                x, y = both[i, e], both[i, f]
                s0 += x[0] * y[0]
                s1 += x[1] * y[1]
                s2 += x[2] * y[2]
                s3 += x[3] * y[3]
                s4 += x[4] * y[4]
                s5 += x[5] * y[5]
                s6 += x[6] * y[6]
                s7 += x[7] * y[7]
            out = pairs[e, f]
            out[0], out[1], out[2], out[3] = s0, s1, s2, s3
            out[4], out[5], out[6], out[7] = s4, s5, s6, s7


@part
def add_normal(entries: EntryTables, pairs: Array, value: Array, across: Array, out: Array
               ) -> None:
    """Add some rows' contribution to the upper half of (J r)^T (J r) (T, T), T = S + f + 1.

    ``pairs`` (d + f + 1, d + f + 1, BLOCK): products of their columns; ``value`` (BLOCK, S);
    ``across`` (4, T): scratch.
    """
    count, first = value.shape[1], entries.first
    d = first.shape[0]
    size = pairs.shape[0]
    for begin in range(0, BLOCK, 4):
        for e in range(d):
            start = first[e, 0]
            for k in range(4):
                w = begin + k
                for f in range(e, d):
                    factor = pairs[e, f, w]
                    own = value[w, first[f, 0]:first[f, 6]]
                    there = across[k, first[f, 0]:first[f, 6]]
                    for s in range(own.shape[0]):
                        there[s] = factor * own[s]
                rest = across[k, count:]
                for a in range(size - d):
                    rest[a] = pairs[e, d + a, w]
            for s in range(start, first[e, 6]):
                add_four(value[begin, s], value[begin + 1, s], value[begin + 2, s],
                         value[begin + 3, s], across[0, start:], across[1, start:],
                         across[2, start:], across[3, start:], out[s, start:])
    for a in range(d, size):
        for b in range(a, size):
            total = 0.0
            for w in range(BLOCK):
                total += pairs[a, b, w]
            out[count - d + a, count - d + b] += total


@compiled
def white_rows(limbs: LimbTables, entries: EntryTables, sight: InstrumentTables, columns: Ints,
               u: Array, q: Array, pose: Array, shown: Array, white: Array, out: Array) -> Array:
    """Fill rows (J r), or return the upper half of (J r)^T (J r) without forming them.

    One function does both, and all the work on a row: passing two dozen arrays to another function
    costs half as much again.

    Args:
        limbs: of the closure.
        entries: of which its columns consist.
        sight: the instrument, with m coordinates.
        columns: those of the open parts, and of the residual (f + 1,).
        u: joint coordinates (N, L).
        q: joint values (N, k).
        pose: closed platform motors (N, 8).
        shown: measurements (N, 6), 0 where nothing was measured.
        white: weight/sigma (N, m), 0 where nothing was measured.
        out: (N, m, C + 1), zeros, or (0, m, C + 1) for sums.

    Returns:
        Sums in the order entries, open parts, residual (T, T).
    """
    rows, m, d = pose.shape[0], sight.coordinates.shape[0], limbs.dof.shape[0]
    count, rest, summing = entries.place.shape[0], columns.shape[0], out.shape[0] == 0
    sums, across = np.zeros((count + rest, count + rest)), np.zeros((4, count + rest))
    chain, size, c = limbs.ends[:, :, 0].copy(), np.empty((d, 3)), np.empty(d)
    line, middle, A = np.empty((d, 6)), np.empty((d, 6)), np.empty((d, d))
    order, rotor, body = np.empty(d, dtype=np.int64), np.empty(4), np.empty(12)
    R, t, arm, point, turned = body[:9], body[9:], np.empty(3), np.empty(3), np.zeros(3)
    work, more, by = np.empty((3, 4)), np.empty((4, 9)), np.empty((m, 6))
    G, seen, value = np.empty((BLOCK, d, m)), np.empty((m, rest)), np.zeros((BLOCK, count))
    staged = np.zeros((d, 6, 6, BLOCK))
    both, pairs = np.zeros((m, d + rest, BLOCK)), np.zeros((d + rest, d + rest, BLOCK))
    turns = sight.coordinates[-1] > 2
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
            seen_point(sight, body, arm, point)
            if turns:
                turn_left(sight, rotor, shown[n], work, turned)
            sight_rows(sight, body, shown[n], white[n], arm, point, turned, more, by, seen)
            by_equation(A, order, by, limbs.dof, G[w])
            for i in range(m):
                for a in range(rest):
                    both[i, d + a, w] = seen[i, a]
                for e in range(d):
                    both[i, e, w] = G[w, e, i]
        pairings(entries, staged, q[begin:begin + block], block, value)
        if summing:
            both[:, :, block:] = 0.0
            products(both, pairs)
            add_normal(entries, pairs, value, across, sums)
            continue
        for w in range(block):
            set_runs(entries, G[w], value[w], out[begin + w])
            for i in range(m):
                for a in range(rest):
                    out[begin + w, i, columns[a]] = both[i, d + a, w]
    return sums
