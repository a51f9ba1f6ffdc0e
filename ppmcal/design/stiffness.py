"""How far the tool gives way under load: springs in limbs and drives, carried to the tool.

A spring of stiffness k in a part lets that part move by (internal load)/k. The part's motion
moves the tool by one column of J_g = -A^-1 B, and the tool's wrench loads the part by the same
column ([LIN] section 3.2, eq. 18 to 21), so that

    C = J_g diag(1/k) J_g^T,   K = C^-1

are compliance and stiffness at the tool point, base axes, at poses where the platform is held by
rigid parts and these springs alone. Where ropes are pulled tight, what their tension adds is in K
(geometric stiffness). Weight of the parts and the effects of the file are left out. What surplus
limbs hold, and which ropes do not, is :mod:`statics`.

Translational stiffness is (C_tt)^-1, the force per displacement of a tool that is free to turn,
not the translational block of K, which is that of a tool kept from turning; rotational
likewise. Shapes: N poses, d coordinates of the motion, S springs. SI.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ppmcal import linalg
from ppmcal.calibration.fit import GAP, gap_names
from ppmcal.design.error_jacobian import to_tool
from ppmcal.design.spring_model import Spring, spring_columns, springs_of
from ppmcal.design.statics import AppliedLoad, LimbForces, limb_forces
from ppmcal.errors import NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.least_squares_closure import closed_by
from ppmcal.kinematics.loads import only_pull
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.region import Grid, named, placed
from ppmcal.kinematics.tables import KinematicsTable, inverse_table, refuse_singular_home
from ppmcal.linalg import Array, finite_rows
from ppmcal.model.mechanism import Mechanism
from ppmcal.wording.progress import stage

RIGID = 1e-11
"""A direction is rigid where the springs' largest motion is below this part of the largest of all
directions (as roots of compliance, rotation times the length scale)."""
CHUNK = 4096


@dataclass(frozen=True, eq=False)
class Principal:
    """Stiffness by principal directions: ``values`` (N, t) from soft to stiff, inf where rigid.

    ``directions`` (N, t, t): unit vectors in base axes, one column for each value.
    """

    values: Array
    directions: Array


@dataclass(frozen=True, eq=False)
class Compliance:
    """Compliance of the tool point at N poses.

    Attributes:
        mechanism: the machine, without effects.
        springs: what gives way, (S,).
        factor: (N, d, S), C = factor factor^T: motion of the tool, base axes, for each spring's
            load of one root of its compliance; nan at singular poses. With a preload the load is
            shared with it, and no longer one spring's.
        strain: (N, d, S), what stretches each spring per unit of wrench; ``factor`` where no
            preload shares the load.
    """

    mechanism: Mechanism
    springs: tuple[Spring, ...]
    factor: Array
    strain: Array | None = None

    @property
    def matrix(self) -> Array:
        """C (N, d, d): tool displacement and rotation per unit of wrench, m, rad, N, N m."""
        return np.asarray(self.factor @ np.swapaxes(self.factor, -1, -2), dtype=float)

    @cached_property
    def _weights(self) -> Array:
        """Length scale of each coordinate (d,): makes rotation a length."""
        dof = self.mechanism.dof
        return np.array([1.0 if c < 3 else self.mechanism.length_scale for c in dof])

    @cached_property
    def _whole(self) -> tuple[Array, Array]:
        """Directions and roots of compliance of all coordinates, as lengths."""
        return _roots(self.factor * self._weights[:, None])

    @cached_property
    def stiffness(self) -> Array:
        """K = C^-1 (N, d, d); nan where some direction is rigid or the pose is singular."""
        directions, roots = self._whole
        soft = np.greater(roots, RIGID * roots[:, :1])
        regular = np.asarray(soft.all(axis=1), dtype=np.bool_)
        inverse = directions / np.where(soft, roots, 1.0)[:, None, :]
        out = self._weights[:, None] * (inverse @ np.swapaxes(inverse, -1, -2)) * self._weights
        return np.asarray(np.where(regular[:, None, None], out, np.nan), dtype=float)

    def translational(self) -> Principal:
        """Return the principal values of (C_tt)^-1, N/m."""
        return self._principal([i for i, c in enumerate(self.mechanism.dof) if c < 3], 1.0)

    def rotational(self) -> Principal:
        """Return the principal values of (C_rr)^-1, N m/rad; none where nothing can turn."""
        return self._principal([i for i, c in enumerate(self.mechanism.dof) if c >= 3],
                               self.mechanism.length_scale)

    def _principal(self, rows: Sequence[int], scale: float) -> Principal:
        """Return the inverse of one diagonal block of C by its principal directions."""
        directions, roots = _roots(self.factor[:, rows])
        rigid = roots * scale <= RIGID * self._whole[1][:, :1]
        with np.errstate(divide="ignore", over="ignore"):
            values = 1.0 / np.where(rigid, 0.0, roots) ** 2
        return Principal(values, directions)

    def deflection(self, wrench: Array) -> Array:
        """Return C w (N, 6): displacement of the tool point and rotation, base axes.

        Args:
            wrench: on the platform at the tool point, base axes (6,), N and N m; components
                that the motion lacks are borne without any motion.
        """
        dof = list(self.mechanism.dof)
        out = np.zeros((len(self.factor), 6))
        out[:, dof] = (self.factor @ (wrench[dof] @ self.factor)[..., None])[..., 0]
        return out

    def shares(self, wrench: Array) -> Array:
        """Return each spring's share of w^T C w (N, S), the deflection along the load.

        Twice the energy in each spring, over the sum; nan where nothing gives way.
        """
        load = wrench[list(self.mechanism.dof)]
        energy = (load @ (self.factor if self.strain is None else self.strain)) ** 2
        total = energy.sum(axis=1, keepdims=True)
        rigid = RIGID * self._whole[1][:, :1] * np.linalg.norm(load / self._weights)
        return np.asarray(energy / np.where(total > rigid**2, total, np.nan), dtype=float)


def compliance(mechanism: Mechanism, q: Array, pose: Array, tool: Array | None = None,
               geometric: Array | None = None) -> Compliance:
    """Return the compliance of the tool point at closed poses.

    Args:
        mechanism: the machine; its effects are left out.
        q: joint values (N, k).
        pose: platform motors (N, 8).
        tool: tool point in platform axes (3,), m; default the platform's origin.
        geometric: stiffness that a preload adds (N, d, d), at the platform's origin; None without.

    Raises:
        BadInput: no part of the machine has a stiffness.
    """
    springs = springs_of(mechanism)
    none = np.zeros((0, len(mechanism.dof), len(springs)))
    factors, strains = ([none], [none])
    for _, factor, strain, _ in _factors(mechanism, springs, q, pose, tool, geometric):
        factors.append(factor)
        strains.append(strain)
    return Compliance(replace(mechanism, effects=()), springs, np.concatenate(factors),
                      None if geometric is None else np.concatenate(strains))


def _factors(mechanism: Mechanism, springs: Sequence[Spring], q: Array, pose: Array,
             tool: Array | None, geometric: Array | None
             ) -> Iterator[tuple[slice, Array, Array, Array]]:
    """Yield rows, factor and strain (n, d, S) and det A (n,), some poses at a time."""
    model = Model(replace(mechanism, effects=()))
    root = np.sqrt([s.compliance for s in springs])
    dof, at = list(mechanism.dof), np.zeros(3) if tool is None else tool
    for begin in range(0, len(q), CHUNK):
        rows = slice(begin, begin + CHUNK)
        closure = model.closure(q[rows])
        lines = closure.lines(pose[rows])
        a = closure.pose_matrix(pose[rows], lines)
        # where A is singular nothing holds the platform: nan
        moves = spring_columns(closure, pose[rows], lines, springs) * root
        moves = closed_by(closure, pose[rows], a, moves, lines, moves)
        carry = to_tool(pose[rows], at)[:, dof][:, :, dof]
        factor = strain = moves
        if geometric is not None:
            factor, strain = _preloaded(moves, geometric[rows])
        yield rows, carry @ factor, carry @ strain, linalg.determinant(a)


def _preloaded(moves: Array, geometric: Array) -> tuple[Array, Array]:
    """Return factor and strain (n, d, S) of springs that a preload helps, or hinders.

    (C^-1 + G)^-1 = M P^-1 M' with C = M M' and P = I + M' G M, also where C has directions that are
    rigid. nan where P is not positive: the platform leaves such a pose by itself.
    """
    p = np.eye(moves.shape[-1]) + np.swapaxes(moves, -1, -2) @ geometric @ moves
    good = finite_rows(p.reshape(len(p), -1))
    vectors, roots, _ = linalg.svd(np.where(good[:, None, None], p, np.eye(p.shape[-1])))
    # the singular values of a symmetric matrix are its eigenvalues but for their signs
    signs = np.einsum("nij,nik,nkj->nj", vectors, p, vectors)
    stable = good & np.all(signs > 0.0, axis=1)
    turned = np.where(stable[:, None, None], moves @ vectors, np.nan)
    back = np.swapaxes(vectors, -1, -2)
    return (turned / np.sqrt(roots)[:, None, :]) @ back, (turned / roots[:, None, :]) @ back


def _roots(factor: Array) -> tuple[Array, Array]:
    """Return principal directions (N, t, t) and roots of compliance (N, t), largest first.

    Of (N, t, S). A triangle takes the place of many springs, so that small roots keep their
    digits, which the eigenvalues of factor factor^T lose.
    """
    n, t, _ = factor.shape
    good = finite_rows(factor.reshape(n, -1)) if factor.size else np.ones(n, dtype=bool)
    safe = np.concatenate([np.where(good[:, None, None], factor, 0.0), np.zeros((n, t, t))], axis=2)
    if not safe.size:
        return np.zeros((n, t, t)), np.zeros((n, t))
    triangle = linalg.triangle(np.swapaxes(safe, -1, -2))
    directions, roots, _ = linalg.svd(np.swapaxes(triangle, -1, -2), full=True)
    # an axis has no sign of its own: its largest component is positive
    leading = np.take_along_axis(directions, np.abs(directions).argmax(axis=1)[:, None, :], axis=1)
    directions = directions * np.where(leading < 0.0, -1.0, 1.0)
    blank = np.where(good, 1.0, np.nan)
    return directions * blank[:, None, None], roots * blank[:, None]


@dataclass(frozen=True, eq=False)
class Stiffnesses:
    """Stiffness over N poses; nan where ``table.status`` is not ok.

    Attributes:
        table: inverse kinematics of the poses.
        translational, rotational: smallest and largest principal stiffness (N, 2), inf where
            rigid; N/m, N m/rad. Rotational is nan where nothing can turn.
        deflection: of the tool under the load (N, 6), m and rad; None without one.
        determinant: of A (N,), nan where there is no inverse kinematics.
        held: what surplus limbs hold, None of machines without.
    """

    table: KinematicsTable
    translational: Array
    rotational: Array
    deflection: Array | None
    determinant: Array
    held: LimbForces | None = None

    @property
    def ok(self) -> NDArray[np.bool_]:
        """Poses that the machine takes without complaint (N,)."""
        return np.array([s == "ok" for s in self.table.status], dtype=np.bool_)


@stage("mapping the stiffness")
def stiffness_table(mechanism: Mechanism, coordinates: Array, tool: Array | None = None,
                    wrench: Array | None = None, tension: float = 0.0) -> Stiffnesses:
    """Return the stiffness at wanted poses (N, 6), nan = open coordinate.

    Args:
        mechanism: the machine; its effects are left out.
        coordinates: wanted poses, see :func:`ppmcal.kinematics.tables.inverse_table`.
        tool: tool point in platform axes (3,), m; default the platform's origin.
        wrench: load at the tool point, base axes (6,), N and N m.
        tension: of ropes without a load, their mean, N.

    Raises:
        BadInput: no part of the machine has a stiffness.
    """
    springs = springs_of(mechanism)
    bare = replace(mechanism, effects=())
    table = inverse_table(Model(bare), coordinates)
    n = len(coordinates)
    out = {"t": np.full((n, 2), np.nan), "r": np.full((n, 2), np.nan), "w": np.full((n, 6), np.nan),
           "det": np.full(n, np.nan)}
    ok = np.array([s == "ok" for s in table.status], dtype=np.bool_)
    found = np.flatnonzero(finite_rows(table.q) & finite_rows(table.pose))
    held = limb_forces(bare, springs, table.q[found], pose_motor(table.pose[found]),
                       np.zeros(3) if tool is None else tool, wrench, tension)
    for rows, factor, strain, determinant in _factors(
            bare, springs, table.q[found], pose_motor(table.pose[found]), tool,
            None if held is None else held.geometric):
        here = found[rows]
        out["det"][here] = determinant
        good, here = ok[here], here[ok[here]]
        some = Compliance(bare, springs, factor[good], strain[good])
        for key, principal in (("t", some.translational()), ("r", some.rotational())):
            if principal.values.shape[1]:
                out[key][here] = principal.values[:, [0, -1]]
        if wrench is not None:
            out["w"][here] = some.deflection(wrench)
    if held is not None:
        held = held.at(found, n, ok[found])
    if held is not None and held.deflection is not None and only_pull(bare).any():
        # a pose that the tension pushes over has no equilibrium to go to
        out["w"] = np.where(np.isnan(out["t"][:, :1]), np.nan, held.deflection)
    return Stiffnesses(table, out["t"], out["r"], None if wrench is None else out["w"],
                       out["det"], held)


@dataclass(frozen=True, eq=False)
class Home:
    """Home (N = 1): its full pose (6,), status and reason of inverse kinematics, compliance.

    ``held``: what surplus limbs hold there, None of machines without; ``untensioned``: compliance
    without the tension that was asked for, None where none was.
    """

    pose: Array
    status: str
    reason: str
    compliance: Compliance
    held: LimbForces | None = None
    untensioned: Compliance | None = None

    def deflection(self, wrench: Array) -> Array:
        """Return how far a load (6,) moves the tool (6,), nan where ropes do not hold it."""
        held = self.held
        if held is not None and held.deflection is not None and only_pull(
                self.compliance.mechanism).any():
            stable = np.isfinite(self.compliance.factor).all()
            return np.asarray(held.deflection[0] if stable else np.full(6, np.nan))
        return np.asarray(self.compliance.deflection(wrench)[0])


def stiffness_at_home(mechanism: Mechanism, tool: Array | None = None,
                      wrench: Array | None = None, tension: float = 0.0) -> Home:
    """Return the compliance at home, also where home is outside limits.

    Arguments as of :func:`stiffness_table`.

    Raises:
        BadInput: no part of the machine has a stiffness, or a limb cannot reach home.
        NoResult: home is singular, or off the surface of a machine with few actuators.
    """
    bare = replace(mechanism, effects=())
    springs = springs_of(bare)
    place = f"{mechanism.source}: home"
    refuse_singular_home(bare)
    axes = named(bare)
    wanted = placed(bare, axes, bare.home_pose[None, list(axes)])
    table = inverse_table(Model(bare), wanted)
    if not finite_rows(table.q)[0] or not finite_rows(table.pose)[0]:
        raise NoResult(f"the home pose cannot be reached: {table.reason[0]}", place,
                       "Check `home`")
    held = limb_forces(bare, springs, table.q, pose_motor(table.pose),
                       np.zeros(3) if tool is None else tool, wrench, tension)
    found = compliance(bare, table.q, pose_motor(table.pose), tool,
                       None if held is None else held.geometric)
    without = compliance(bare, table.q, pose_motor(table.pose), tool) if tension else None
    return Home(table.pose[0], table.status[0], table.reason[0], found, held, without)


@dataclass(frozen=True, eq=False)
class StiffnessStudy:
    """What was asked, and what was found.

    Attributes:
        mechanism: as read.
        wanted: poses (N, 6), nan where open; ``grid``: where they are one.
        tool: tool point in platform axes (3,), m.
        load: None without one.
        home: compliance at home; ``found``: over the poses.
        notes: what the command has to say itself.
        tension: of ropes without the load, their mean, N.
    """

    mechanism: Mechanism
    wanted: Array
    grid: Grid | None
    tool: Array
    load: AppliedLoad | None
    home: Home
    found: Stiffnesses
    notes: tuple[str, ...] = ()
    tension: float = 0.0

    @property
    def conditions(self) -> tuple[str, ...]:
        """Limbs as forces are told of them (m,), those with several conditions numbered."""
        return tuple(name.removeprefix(GAP) for name in gap_names(self.mechanism))
