"""Wanted poses, the command that brings the machine to each, and a controller that uses them.

The controller turns a commanded pose into joint values with the nominal geometry. Commands are
corrected so that the identified machine ends at what was wanted
(:mod:`ppmcal.calibration.compensation`).
Between the poses of a regular grid a controller interpolates the difference command - wanted
linearly in every coordinate; how far the machine then is from what was wanted is measured at poses
in between. Effects are taken at rest: no direction of approach, no speed, no load, 20 degrees
Celsius, time 0. Full poses are (N, 6) x, y, z and rotation vector in the base frame; all SI.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import RegularGridInterpolator

from ppmcal.calibration.compensation import compensate
from ppmcal.controllers.pose_errors import ErrorSummary, pose_errors
from ppmcal.errors import BadInput, NoResult
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.partial_pose import inverse_partial, pose_motor, wanted_poses
from ppmcal.kinematics.region import Grid, largest_box, named, placed
from ppmcal.linalg import Array, Bools, finite_rows
from ppmcal.model.dataset import REFERENCE_TEMPERATURE, Environment, environment
from ppmcal.model.measured import MeasurementBasis
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.model.registration import Registration
from ppmcal.notes import NOTE, Note
from ppmcal.wording.progress import stage

PLACES = {1: 101, 2: 31, 3: 11, 4: 7, 5: 5, 6: 5}
TURNS = {1: 101, 2: 31, 3: 9, 4: 5, 5: 3, 6: 3}
"""Levels of each position and of each rotation, by how many coordinates the grid has."""
MARGIN = 0.98
BETWEEN = 500
"""Poses in between at which the interpolation is tried."""
ENOUGH = 20
STILL = 0.01
"""A coordinate was measured at one value where that is less than this part of its range."""


@dataclass(frozen=True, eq=False)
class Corrected:
    """Corrected commands of N wanted poses, SI; nan rows where there is none.

    Attributes:
        wanted: full poses (N, 6), open coordinates solved for.
        command: the pose to ask of a controller with the nominal geometry (N, 6).
        q: joint values (N, k). good: rows that have them (N,).
        left_out: reason -> how many rows have none for it.
    """

    wanted: Array
    command: Array
    q: Array
    good: Bools
    left_out: Mapping[str, int]


def rest_columns(mechanism: Mechanism, rows: int) -> dict[str, Array]:
    """Return the columns of rows at rest: everything that effects depend on is 0, 20 C."""
    none = np.zeros(rows)
    joints = {f"{what}_{a}": none for what in ("dir", "vel") for a in mechanism.actuators}
    return {**joints, "temperature": np.full(rows, REFERENCE_TEMPERATURE), "payload": none,
            "time": none}


def at_rest(mechanism: Mechanism, rows: int) -> Environment:
    """Return the environment of rows at rest."""
    return environment(rest_columns(mechanism, rows), mechanism.actuators, mechanism.gravity,
                       np.zeros((rows, len(mechanism.actuators))))


def default_grid(mechanism: Mechanism) -> Grid:
    """Return the largest box about home inside all limits (:func:`largest_box`) as a grid.

    Of a machine that was measured it ends where the measurements end.

    Raises:
        BadInput: an actuator has no limits. NoResult: next to nothing is inside them.
    """
    refuse_open(mechanism, "the grid", ", or give the poses with --poses")
    chosen = named(mechanism)
    n = len(chosen)
    low, high = largest_box(mechanism, chosen, 5 if n <= 3 else 3)
    home = mechanism.home_pose[list(chosen)]
    low, high = home + MARGIN * (low - home), home + MARGIN * (high - home)
    ends = [measured_part(mechanism, c, float(a), float(b))
            for c, a, b in zip(chosen, low, high, strict=True)]
    return Grid(chosen, tuple(np.linspace(a, b, PLACES[n] if c < 3 else TURNS[n])
                              for c, (a, b) in zip(chosen, ends, strict=True)))


def measured_part(mechanism: Mechanism, coordinate: int, low: float, high: float
                  ) -> tuple[float, float]:
    """Return what of a range of a coordinate was measured; all of it where that is not known.

    Also where it was measured at one value only: what is far from that is left out row by row.
    """
    seen = mechanism.measured or MeasurementBasis()
    ends = seen.ranges.get(POSE_COORDINATES[coordinate], (low, high))
    inside = max(low, ends[0]), min(high, ends[1])
    return inside if inside[1] - inside[0] > STILL * (high - low) else (low, high)


def refuse_open(mechanism: Mechanism, what: str, hint: str = "") -> None:
    """Refuse a machine with an actuator without limits: ``what`` then has no end."""
    open_ = [a for a, pair in zip(mechanism.actuators, mechanism.limits, strict=True)
             if not np.isfinite(pair).all()]
    if open_:
        have = "has" if len(open_) == 1 else "have"
        raise BadInput(f"{', '.join(open_)} {have} no limits, so {what} has no end",
                       f"{mechanism.source}: limits",
                       f"Add `limits: {{{open_[0]}: [low, high]}}`{hint}")


@stage("correcting the grid")
def corrected(mechanism: Mechanism, wanted: Array) -> Corrected:
    """Return the corrected commands of wanted platform poses (N, 6), nan where open."""
    found = compensate(mechanism, wanted, Registration(),
                       columns=rest_columns(mechanism, len(wanted)))
    reason = list(found.reason)
    command = nearest_rotations(found.command, found.seen)
    for n in np.flatnonzero(finite_rows(found.q) & ~finite_rows(command)):
        reason[n] = "the nominal geometry has no pose at these joint values"
    good = np.array([not r for r in reason], dtype=np.bool_)
    return Corrected(found.seen, np.where(good[:, None], command, np.nan),
                     np.where(good[:, None], found.q, np.nan), good,
                     dict(Counter(r.partition(":")[0] for r in reason if r)))


def nearest_rotations(vector: Array, to: Array) -> Array:
    """Return poses (N, 6) with the rotation vector of the same turn that is nearer to ``to``."""
    out = vector.copy()
    angle = np.linalg.norm(out[:, 3:], axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        other = np.where(angle > 0.0, out[:, 3:] * (1.0 - 2.0 * np.pi / angle), out[:, 3:])
    closer = (np.linalg.norm(other - to[:, 3:], axis=1)
              < np.linalg.norm(out[:, 3:] - to[:, 3:], axis=1))
    out[:, 3:] = np.where(closer[:, None], other, out[:, 3:])
    return out


def interpolated(grid: Grid, found: Corrected, values: Array) -> Array:
    """Return command - wanted (N, 6) at ``values`` (N, c) of the grid's coordinates.

    Linear in every coordinate between the two levels around it; nan where a corner of the
    cell has no command.
    """
    table = (found.command - found.wanted).reshape(*grid.shape, 6)
    out: Array = np.asarray(RegularGridInterpolator(grid.levels, table)(values), dtype=float)
    return out


def driven(mechanism: Mechanism, commands: Array, rows: Environment) -> Array:
    """Return where commanded poses (N, 6) bring the machine, motors (N, 8).

    The commands go through the nominal inverse kinematics; nan where they do not.
    """
    asked = commands.copy()
    asked[:, [c for c in mechanism.dof if c not in named(mechanism)]] = np.nan
    q = inverse_partial(Model(mechanism.nominal()), asked).q
    return reached_poses(Model(mechanism), q, rows).pose


def completed_poses(mechanism: Mechanism, wanted: Array) -> Array:
    """Return wanted poses (N, 6) with their open coordinates solved for; nan where none is."""
    return wanted_poses(Model(mechanism), Registration(), wanted)[0]


def errors_between_poses(mechanism: Mechanism, grid: Grid, found: Corrected, seed: int
                  ) -> tuple[ErrorSummary, ErrorSummary]:
    """Return errors at poses in between without and with the interpolated correction.

    Raises:
        NoResult: hardly any cell of the grid has commands at all its corners.
    """
    values = grid.inside(BETWEEN, np.random.default_rng(seed))
    wanted = placed(mechanism, grid.coordinates, values)
    correction = interpolated(grid, found, values)[:, list(grid.coordinates)]
    full = completed_poses(mechanism, wanted)
    asked = placed(mechanism, grid.coordinates, values + correction)
    asked[~finite_rows(correction)] = np.nan
    return _compared(mechanism, full, wanted, asked, ENOUGH)


@stage("predicting errors of the grid")
def errors_at_poses(mechanism: Mechanism, found: Corrected) -> tuple[ErrorSummary, ErrorSummary]:
    """Return errors at the poses themselves without and with their commands."""
    full = found.wanted[found.good]
    return _compared(mechanism, full, full, found.command[found.good])


def _compared(mechanism: Mechanism, full: Array, before: Array, after: Array, least: int = 0
              ) -> tuple[ErrorSummary, ErrorSummary]:
    """Return how far the machine is from ``full`` poses with two lists of commands, (N, 6) each.

    Over the rows that are known of both, ``least`` of them.
    """
    rest = at_rest(mechanism, len(full))
    ends = [driven(mechanism, commands, rest) for commands in (after, before)]
    both = np.all([finite_rows(rows) for rows in (*ends, full)], axis=0)
    if both.sum() < least:
        raise NoResult("hardly any cell of the grid has commands at all its corners",
                       mechanism.source, "Check `limits`, or give the poses with --poses")
    wanted = pose_motor(full[both])
    return (pose_errors(mechanism, ends[1][both], wanted),
            pose_errors(mechanism, ends[0][both], wanted))


def instrument_notes(mechanism: Mechanism) -> Iterator[Note]:
    """Yield which effects are the instrument's, so that no controller has to know them."""
    for effect in mechanism.effects:
        if effect.kind.instrument:
            yield Note(f"effect {effect.kind.name} belongs to the instrument and is not sent", NOTE)
