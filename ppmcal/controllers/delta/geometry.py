"""The numbers of a linear delta, their arithmetic, and a machine that a firmware drives with them.

A firmware has one radius r, three angles w_i, three rods L_i, three endstops e_i. For a point
(x, y, z) the carriage of tower i goes to

    h_i = sqrt(L_i^2 - (r cos w_i - x)^2 - (r sin w_i - y)^2) + z,

which is e_i + sqrt(L_i^2 - r^2) - h_i below its endstop. Klipper takes these numbers as they are,
RepRapFirmware counts some from elsewhere. Steps are not rounded.

How far the firmware sends carriages below their endstops goes, as joint values, into the
machine's own forward kinematics; where the platform ends up is compared with where it should be.
Lengths of machines are SI; a :class:`DeltaGeometry` is in mm and degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from ppmcal import algebra as cga
from ppmcal import linalg
from ppmcal.controllers.export import other_machine
from ppmcal.controllers.text import Rounded
from ppmcal.errors import BadInput
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array
from ppmcal.model.limbs.chain import U
from ppmcal.model.limbs.spatial import PUS
from ppmcal.model.mechanism import Mechanism

MM = 1e-3
TOWERS = ("a", "b", "c")
ANGLES = (210.0, 330.0, 90.0)
"""Of the towers where nobody says, degrees."""
DIGITS = 6
"""Decimals of numbers that are kept."""
SMALLEST = 1e-6
"""No number of a printer that has to be above 0 is as small, mm."""
KEYS = ("printer.delta_radius", *(f"stepper_{tower}.{key}" for tower in TOWERS
        for key in ("angle", "arm_length", "position_endstop")))
"""``section.key`` of a printer.cfg for every number of a delta's geometry."""
UPRIGHT = 0.95
"""Towers whose axis has less than this along z are not those of a delta printer."""
Triple = tuple[float, float, float]


@dataclass(frozen=True)
class DeltaGeometry(Rounded, digits=DIGITS):
    """The numbers of a linear delta: mm and degrees; triples are towers a, b, c."""

    radius: float
    angles: Triple
    arms: Triple
    endstops: Triple

    def named(self) -> dict[str, float]:
        """Return the value of each of :data:`KEYS`, mm and degrees."""
        towers = zip(self.angles, self.arms, self.endstops, strict=True)
        return dict(zip(KEYS, (self.radius, *chain(*towers)), strict=True))

    @property
    def turns(self) -> Triple:
        """How far towers stand from :data:`ANGLES`, -180 to 180 degrees."""
        return triple((np.subtract(self.angles, ANGLES) + 180.0) % 360.0 - 180.0)


def tower_angles(turns: Triple) -> Triple:
    """Return the angles of towers that stand so far from :data:`ANGLES`, degrees."""
    return triple(np.add(ANGLES, turns))


def unit_of(key: str) -> str:
    """Return the unit of a number by its key in a printer.cfg."""
    return "deg" if key.endswith("angle") else "mm"


def triple(values: Array | Sequence[float]) -> Triple:
    """Return three numbers as they go into a :class:`DeltaGeometry`."""
    return float(values[0]), float(values[1]), float(values[2])


def travel(geometry: DeltaGeometry, point: Array) -> Array:
    """Return how far below its endstop each carriage goes for points (N, 3), (N, 3), m.

    nan where a rod does not reach.
    """
    arms = np.array(geometry.arms)
    top = np.array(geometry.endstops) + np.sqrt(arms**2 - geometry.radius**2)
    angle = np.radians(geometry.angles)
    foot = geometry.radius * MM * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    away = np.sum((foot - point[:, None, :2]) ** 2, axis=-1)
    with np.errstate(invalid="ignore"):
        return np.asarray(top * MM - (np.sqrt((arms * MM) ** 2 - away) + point[:, 2:]))


def above_zero(value: float, place: str) -> float:
    """Return a number of a configuration that has to be above 0.

    Raises:
        BadInput: it is not, or too small for a printer.
    """
    if value < SMALLEST:
        raise BadInput(f"{value:g} is not above 0" if value <= 0.0 else
                       f"{value:g} is out of range", place,
                       "Write the value that the printer has")
    return value


@dataclass(frozen=True, eq=False)
class DeltaDrive:
    """How travel from the endstops becomes joint values of the machine.

    Attributes:
        mechanism: the machine.
        towers: which limb is tower a, b, c; of six rods the first of each tower.
        zero: joint values at the endstops, in tower order (3,).
        scale: joint value per metre of travel down from the endstop (3,).
    """

    mechanism: Mechanism
    towers: tuple[int, int, int]
    zero: Array
    scale: Array

    @property
    def tilts(self) -> bool:
        """Whether each rod is a limb, so that the platform can tilt."""
        return len(self.mechanism.limbs) > len(self.towers)

    def rods(self, tower: int) -> list[int]:
        """Return the limbs of one of the towers: one, or two of six rods."""
        limbs = self.mechanism.limbs
        return [i for i, limb in enumerate(limbs)
                if limb.actuator == limbs[self.towers[tower]].actuator]

    def joints(self, travel: Array) -> Array:
        """Return joint values (N, 3) in the machine's order for travel (N, 3) in tower order."""
        out = np.zeros_like(travel)
        actuators = [self.mechanism.limbs[i].actuator for i in self.towers]
        out[:, actuators] = self.zero + self.scale * travel
        return out


def drive_of(mechanism: Mechanism) -> DeltaDrive:
    """Return how the firmware would drive the machine.

    Raises:
        BadInput: it is not a delta with three upright towers, or no endstop is known.
    """
    limbs = mechanism.limbs
    kinds = {limb.kind.name for limb in limbs}
    each = 2 if mechanism.motion.turns else 1
    if kinds != {PUS.name} or mechanism.motion.planar or sorted(
            limb.actuator for limb in limbs) != sorted([*range(3)] * each):
        raise other_machine(mechanism, f"A linear delta has three limbs {PUS.name} with "
                            "`motion: translational`, or six, two to a drive, with `motion: "
                            "spatial`")
    towers = _towers(mechanism)
    zero, scale = np.zeros(3), np.zeros(3)
    nominal = mechanism.nominals
    for t, i in enumerate(towers):
        limb = limbs[i]
        way = axis(mechanism, i)[2]
        place = f"{mechanism.source}: limbs.{limb.name}"
        if abs(way) < UPRIGHT:
            raise BadInput("the tower leans by "
                           f"{np.degrees(np.arccos(min(abs(way), 1.0))):.0f} deg", place,
                           "A linear delta printer has upright towers")
        ratio = limb.slots.values(nominal).get("ratio", 1.0) * np.sign(way)
        scale[t] = -1.0 / ratio
        zero[t] = endstop(mechanism, limb.actuator, ratio, place, "Give `limits` whose upper end "
                          "is the endstop, or count steps down from it: `ratio: -0.0125`")
    return DeltaDrive(mechanism, towers, zero, scale)


def _towers(mechanism: Mechanism) -> tuple[int, int, int]:
    """Return the limbs of towers a, b, c (x, y, z): by actuators' names, else in file order.

    Of six rods the first of each.
    """
    names = [mechanism.actuators[limb.actuator].lower() for limb in mechanism.limbs]
    ends = [n.removeprefix("stepper_").removeprefix("tower_") for n in names]
    for first, second, third in (TOWERS, ("x", "y", "z")):
        if {first, second, third} == set(ends):
            return ends.index(first), ends.index(second), ends.index(third)
    actuators = [limb.actuator for limb in mechanism.limbs]
    return actuators.index(0), actuators.index(1), actuators.index(2)


def endstop(mechanism: Mechanism, actuator: int, ratio: float, place: str, hint: str) -> float:
    """Return the joint value at the endstop, the upper end of a tower or of an arm's turn.

    Raises:
        BadInput: it is not known, with ``place`` and ``hint``.
    """
    if mechanism.actuator_has_ratio[actuator] and ratio < 0.0:
        return 0.0
    end = float(mechanism.limits[actuator][1 if ratio > 0.0 else 0])
    if not np.isfinite(end):
        raise BadInput("the joint value at the endstop is not known", place, hint)
    return end


def axis(mechanism: Mechanism, limb: int) -> Array:
    """Return the direction of a tower with its error turn, (3,)."""
    values = mechanism.limbs[limb].slots.values(mechanism.values)
    turn = np.array([values.get(f"base.direction.{c}", 0.0) for c in ("rx", "ry", "rz")])
    motor = cga.motor_from_rotation_vector(turn, np.zeros(3))
    out: Array = np.asarray(cga.move_point(motor, mechanism.limbs[limb].constants[
        "base.direction"]), dtype=float)
    return out


def delta_geometry(drive: DeltaDrive) -> DeltaGeometry:
    """Return the firmware's numbers as read off the machine, turned so that c stands at 90 deg.

    Exact, apart from a turn and a shift in the plane, for upright towers without frame errors:
    single radii and a shifted effector are a circle about another centre, heights of joints are
    endstops. Of six rods each tower has the mean of its two.
    """
    mechanism = drive.mechanism
    home = home_state(mechanism)
    feet, arms, tops = np.zeros((3, 2)), np.zeros(3), np.zeros(3)
    for t in range(3):
        each = [_read_off(mechanism, i, (float(home.q[mechanism.limbs[i].actuator]),
                                         float(drive.zero[t]))) for i in drive.rods(t)]
        foot, arm, top = (np.mean(part, axis=0) for part in zip(*each, strict=True))
        feet[t], arms[t], tops[t] = foot, arm, top
    centre, radius = _circle(feet)
    angles = np.degrees(np.arctan2(*(feet - centre).T[::-1]))
    if np.any(arms <= radius):
        raise BadInput("a rod does not reach the middle", mechanism.source,
                       "A linear delta printer needs rods longer than its radius")
    ends = tops - np.sqrt(arms**2 - radius**2)
    a, b = ((angles[:2] - angles[2] + 90.0) % 360.0).tolist()
    return DeltaGeometry(radius / MM, (a, b, 90.0), triple(arms / MM), triple(ends / MM))


def _read_off(mechanism: Mechanism, i: int, q: tuple[float, float]) -> tuple[Array, float, float]:
    """Return foot (2,) and length of a rod, and its carriage's height at the endstop, m.

    ``q``: the joint value at home, and at the endstop.

    Raises:
        BadInput: the carriage is below the platform.
    """
    limb, model = mechanism.limbs[i], Model(mechanism)
    v = model.limb_values[i]
    carried = np.array([v.get(f"platform.point.{c}", 0.0) for c in "xyz"])

    def joint(value: float) -> Array:
        u = v.get("ratio", 1.0) * value + v.get("offset", 0.0)
        at: Array = cga.translation(limb.kind.base.evaluate({**v, U: u}, ())[0]) - carried
        return at

    now, top = joint(q[0]), joint(q[1])
    if now[2] <= mechanism.home_pose[2]:
        raise BadInput("the carriage is below the platform at home",
                       f"{mechanism.source}: limbs.{limb.name}",
                       "A linear delta printer has its carriages above: `branch: 1` for u "
                       "upwards")
    return np.asarray(now[:2]), float(v["length"]), float(top[2])


def _circle(points: Array) -> tuple[Array, float]:
    """Return centre (2,) and radius of the circle through three points (3, 2)."""
    across = 2.0 * (points[1:] - points[0])
    if abs(np.linalg.det(across)) < 1e-9 * np.max(across**2):
        raise BadInput("the towers stand in one line", "", "Check the points of the limbs")
    square = np.sum(points**2, axis=1)
    centre = linalg.solve(across, square[1:] - square[0])
    return centre, float(np.linalg.norm(points[0] - centre))


def reached(drive: DeltaDrive, geometry: DeltaGeometry, point: Array) -> Array:
    """Return where the machine goes (N, 3) when the firmware is told ``point`` (N, 3), m.

    nan where the firmware or the machine does not get there.
    """
    return driven(drive, travel(geometry, point))


def driven(drive: DeltaDrive, down: Array) -> Array:
    """Return where the machine goes (N, 3), m, with its carriages ``down`` (N, 3) from the top.

    nan where the firmware or the machine does not get there.
    """
    q = drive.joints(down)
    out: Array = np.array(cga.translation(forward(Model(drive.mechanism), q).pose))
    return out


def platform_jacobian(drive: DeltaDrive, geometry: DeltaGeometry, point: Array) -> Array:
    """Return how the platform moves with the joints at ``point`` (N, 3): dx/dq, (N, 3, 3).

    From A dx + Jq dq = 0; nan where it is singular or not reached.
    """
    q = drive.joints(travel(geometry, point))
    model = Model(drive.mechanism)
    found = forward(model, q)
    out = np.full((len(q), 3, 3), np.nan)
    rows = np.flatnonzero(found.converged)
    closure = model.closure(q[rows])
    pose = found.pose[rows]
    # of a platform that turns, the rows of its turns come after those of its shifts
    out[rows] = (-linalg.pinv(closure.pose_matrix(pose)) @ closure.joint_matrix(pose))[:, :3]
    return out
