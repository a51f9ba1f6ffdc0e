"""Conformal geometric algebra of space, batched, independent of robots.

G(4,1) in the null basis (e1, e2, e3, e∞, e0), e∞ · e0 = −1.  Arrays have any leading batch axes,
with blades last, and only the blades that their type needs:

- vector (point, sphere, plane) 5: (e1, e2, e3, e∞, e0);
- motor 8: (1, e23, e31, e12, e1∞, e2∞, e3∞, e123∞);
- twist 6: (ω, v), the velocity field x ↦ v + ω × x;
- line 6: Plücker (direction n, moment x × n);
- point pair 10: (e23, e31, e12, e1∞, e2∞, e3∞, e10, e20, e30, e∞0).
"""

from ppmcal.algebra._types import Array
from ppmcal.algebra.action import (
    adjoint_twist,
    leg_line,
    move_line,
    move_point,
    move_vector,
    pair,
    rate,
)
from ppmcal.algebra.blades import FULL, LINE, MOTOR, PAIR, SCALAR, TWIST, VECTOR, Blades
from ppmcal.algebra.conversions import (
    motor_from_matrix,
    motor_from_quaternion,
    motor_from_rotation_vector,
    rotation_matrix,
    rotation_vector,
)
from ppmcal.algebra.motors import (
    compose,
    identity_motor,
    motor_exp,
    motor_log,
    normalise,
    reverse,
    rotated,
    rotor,
    translation,
    translator,
)
from ppmcal.algebra.point_pairs import meet, middle, pair_radius_squared, split
from ppmcal.algebra.tables import dual, product, reverse_blades, sandwich
from ppmcal.algebra.vectors import coordinates, inner, plane, point, sphere, sphere_squared

__all__ = [
    "FULL",
    "LINE",
    "MOTOR",
    "PAIR",
    "SCALAR",
    "TWIST",
    "VECTOR",
    "Array",
    "Blades",
    "adjoint_twist",
    "compose",
    "coordinates",
    "dual",
    "identity_motor",
    "inner",
    "leg_line",
    "meet",
    "middle",
    "motor_exp",
    "motor_from_matrix",
    "motor_from_quaternion",
    "motor_from_rotation_vector",
    "motor_log",
    "move_line",
    "move_point",
    "move_vector",
    "normalise",
    "pair",
    "pair_radius_squared",
    "plane",
    "point",
    "product",
    "rate",
    "reverse",
    "reverse_blades",
    "rotated",
    "rotation_matrix",
    "rotation_vector",
    "rotor",
    "sandwich",
    "sphere",
    "sphere_squared",
    "split",
    "translation",
    "translator",
]
