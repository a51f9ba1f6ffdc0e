"""How a rope leaves its pulley, row by row, for compiled loops.

The same formulas as :mod:`ppmcal.model.limbs.pulley`. Importing this module imports numba, like
:mod:`compiled_closure`.
"""

from __future__ import annotations

import math

from ppmcal.kinematics.compilation import called, part
from ppmcal.linalg import Array


@called
def over_pulley_at(base: Array, u: float, r: float, swivels: bool, x: float, y: float, z: float,
                   c: Array, line: Array, size: Array, e: int) -> None:
    """Fill misclosure and line of a rope e over a pulley of radius r; x, y, z: its end.

    Like :mod:`ppmcal.model.limbs.pulley` and :func:`surfaces._over_pulley`. ``size``: one
    over the free length, and minus the derivative of c by the radius.
    """
    d1, d2, d3 = x - base[9], y - base[10], z - base[11]
    s1 = base[0] * d1 + base[3] * d2 + base[6] * d3
    s2 = base[1] * d1 + base[4] * d2 + base[7] * d3
    s3 = base[2] * d1 + base[5] * d2 + base[8] * d3
    away, lean = math.hypot(s1, s2), 0.0
    if swivels:
        f, g = (s1 / away, s2 / away) if away > 0.0 else (1.0, 0.0)
        away -= r
        wrap = wrapped(math.atan2(s3, -away)
                       - math.atan2(math.sqrt(away * away + s3 * s3 - r * r), r))
        n1, n2, n3 = (1.0 - math.cos(wrap)) * f, (1.0 - math.cos(wrap)) * g, math.sin(wrap)
    else:
        flat = math.sqrt(away * away - r * r)
        turn = math.atan2(s2, s1) - math.atan2(flat, r)
        wrap, lean = wrapped(turn), r * (math.hypot(flat, s3) - flat) / flat
        n1, n2, n3 = math.cos(turn), math.sin(turn), 0.0
    s1, s2, s3 = s1 - (r + lean) * n1, s2 - (r + lean) * n2, s3 - (r + lean) * n3
    free = math.sqrt(s1 * s1 + s2 * s2 + s3 * s3 - lean * lean)
    c[e], f = free - u + r * wrap, 1.0 / free
    size[e, 0], size[e, 1], size[e, 2] = 0.0, f, f * (n1 * s1 + n2 * s2 + n3 * s3) - wrap
    n1, n2, n3 = (f * (base[0] * s1 + base[1] * s2 + base[2] * s3),
                  f * (base[3] * s1 + base[4] * s2 + base[5] * s3),
                  f * (base[6] * s1 + base[7] * s2 + base[8] * s3))
    line[e, 0], line[e, 1], line[e, 2] = n1, n2, n3
    line[e, 3], line[e, 4], line[e, 5] = y * n3 - z * n2, z * n1 - x * n3, x * n2 - y * n1


@part
def wrapped(angle: float) -> float:
    """Return an arc from minus a quarter turn to three quarters of a turn, rad."""
    return (angle + 0.5 * math.pi) % (2.0 * math.pi) - 0.5 * math.pi
