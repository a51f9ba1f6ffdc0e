"""Many machines drawn from the tolerances: how far off each is, as built and calibrated.

The full nonlinear model for every machine and pose. Work comes in batches with generators of
their own, so that the same seed gives the same numbers on one core, on many, or on a cluster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ppmcal import algebra as cga
from ppmcal.calibration.fit import turn_between
from ppmcal.design.error_jacobian import Poses, displacement
from ppmcal.design.recalibration import Calibrated, MeasurementSetup, calibrate
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import newton
from ppmcal.kinematics.partial_pose import solve_named
from ppmcal.kinematics.region import named
from ppmcal.kinematics.registration import predict
from ppmcal.linalg import Array, Bools, Ints
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

BATCH = 100
"""Machines in one batch; the same whatever it runs on."""


@dataclass(frozen=True, eq=False)
class Fleet:
    """What a batch needs to know.

    Attributes:
        mechanism: the nominal one, without effects.
        wanted: parameters that are off (S,); sigma: their standard deviations (S,), SI.
        tasks: where the machines are judged, T poses of the nominal machine, and the tool point.
        setup: how each is calibrated, or None.
    """

    mechanism: Mechanism
    wanted: tuple[int, ...]
    sigma: Array
    tasks: Poses
    setup: MeasurementSetup | None = None


@dataclass(frozen=True, eq=False)
class MachineErrors:
    """Lengths of errors of M machines at T poses, m and rad; nan where one cannot go there."""

    position: Array
    rotation: Array


@dataclass(frozen=True, eq=False)
class MonteCarloErrors:
    """Errors of M machines: as built, registered alone, calibrated (None without a setup).

    ``built``: in the base frame. ``registered``: frame and target fitted, geometry as nominal;
    ``calibrated``: geometry fitted too; both as the instrument sees the machine afterwards.
    """

    built: MachineErrors
    registered: MachineErrors | None = None
    calibrated: MachineErrors | None = None


def batches(count: int, seed: int) -> list[tuple[int, np.random.SeedSequence]]:
    """Return how many machines each batch has, and its seed."""
    sizes = [min(BATCH, count - begin) for begin in range(0, count, BATCH)]
    return list(zip(sizes, np.random.SeedSequence(seed).spawn(len(sizes)), strict=True))


def run(fleet: Fleet, batch: tuple[int, np.random.SeedSequence]) -> MonteCarloErrors:
    """Return the errors of one batch of machines."""
    count, seed = batch
    rng = np.random.default_rng(seed)
    g = np.tile(fleet.mechanism.values, (count, 1))
    g[:, list(fleet.wanted)] += rng.normal(size=(count, len(fleet.wanted))) * fleet.sigma
    owner = np.repeat(np.arange(count), len(fleet.tasks.q))
    at = Poses(np.tile(fleet.tasks.q, (count, 1)), np.tile(fleet.tasks.motor, (count, 1)),
               fleet.tasks.tool)
    moved = displacement(Model(fleet.mechanism), at, g[owner])
    built = _lengths(moved, count)
    if fleet.setup is None:
        return MonteCarloErrors(built)
    setup = fleet.setup
    noise = rng.normal(size=(count, *setup.linear.white.shape[:-1]))
    plain = calibrate(setup, setup.registration, g, noise)
    known = calibrate(setup, setup.linear, g, noise)
    return MonteCarloErrors(built, *(_left(fleet, setup, c, g, at, owner) for c in (plain, known)))


def _left(
    fleet: Fleet, setup: MeasurementSetup, found: Calibrated, g: Array, at: Poses, owner: Ints
) -> MachineErrors:
    """Return what is left where commands come from what a calibration found.

    A command for the pose that the found machine takes at joints q is q; the error is where
    the true machine goes instead, as the instrument sees it. A machine with fewer actuators
    than coordinates is sent so that the coordinates which a command can name come out as
    wanted; the others are what they then are, and count.
    """
    truth, theirs = setup.instrument.registration, found.seen_by(owner)
    if fleet.tasks.tool.any():
        truth, theirs = (replace(s, target=fleet.tasks.tool) for s in (truth, theirs))
    model = Model(fleet.mechanism, found.g[owner])
    if fleet.mechanism.dependent:
        wanted = predict(truth, at.motor)
        q, here = _sent(fleet, model, theirs, wanted)
    else:
        pose, here, _ = newton(model.closure(at.q), at.motor)
        q, wanted = at.q, predict(theirs, pose)
    real, there, _ = newton(Model(fleet.mechanism, g[owner]).closure(q), at.motor)
    shown = predict(truth, real)
    moved = np.concatenate([shown[0] - wanted[0], turn_between(shown[1], wanted[1])], axis=1)
    good = there & here & found.settled[owner]
    return _lengths(np.where(good[:, None], moved, np.nan), len(g))


def _sent(fleet: Fleet, model: Model, registration: Registration, wanted: tuple[Array, Array]
          ) -> tuple[Array, Bools]:
    """Return joints (R, k) at which the found machine shows the named coordinates as wanted."""
    point, turn = wanted
    asked = np.concatenate([point, cga.rotation_vector(
        cga.motor_from_matrix(turn, np.zeros(3)))], axis=1)
    open_ = np.tile(~np.isin(np.arange(6), named(fleet.mechanism)), (len(asked), 1))
    _, q, solved = solve_named(model, registration, asked, open_)
    return q, solved


def _lengths(moved: Array, count: int) -> MachineErrors:
    return MachineErrors(np.linalg.norm(moved[:, :3], axis=1).reshape(count, -1),
                  np.linalg.norm(moved[:, 3:], axis=1).reshape(count, -1))


def together(parts: list[MonteCarloErrors]) -> MonteCarloErrors:
    """Return the batches as one."""
    def joined(name: str) -> MachineErrors | None:
        own = [getattr(p, name) for p in parts]
        if own[0] is None:
            return None
        return MachineErrors(np.concatenate([o.position for o in own]),
                      np.concatenate([o.rotation for o in own]))

    built = joined("built")
    assert built is not None
    return MonteCarloErrors(built, joined("registered"), joined("calibrated"))
