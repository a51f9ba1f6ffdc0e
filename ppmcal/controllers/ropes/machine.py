"""What a machine on ropes to one point is: anchors, and what joint values mean."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ppmcal import algebra as cga
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.skeleton import skeleton
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism


@dataclass(frozen=True, eq=False)
class RopeGeometry:
    """Ropes to one point that does not turn, SI, in the order of the limbs.

    Attributes:
        anchors: base axes, less where each rope holds the platform (k, 3).
        offset, ratio: rope length = ratio q + offset (k,).
        actuators: index of each rope's joint value (k,).
    """

    anchors: Array
    offset: Array
    ratio: Array
    actuators: tuple[int, ...]


def holds_a_point(mechanism: Mechanism, coordinates: tuple[str, ...], least: int) -> bool:
    """Return whether ``least`` or more straight limbs, each driven, hold a point that moves so."""
    limbs = mechanism.limbs
    return (mechanism.motion.coordinates == coordinates and len(limbs) >= least
            and all(limb.kind.strut and not limb.kind.pulley for limb in limbs)
            and len({limb.actuator for limb in limbs}) == len(limbs))


def rope_geometry(mechanism: Mechanism, order: Sequence[int] = ()) -> RopeGeometry:
    """Return the ropes of a machine at its values, in an order of limbs  [default: the file's]."""
    model, home = Model(mechanism), np.atleast_2d(mechanism.home)
    k = len(mechanism.actuators)
    none, one = np.zeros((1, k)), np.ones((1, k))
    limbs = skeleton(model, home, none)
    place = cga.translation(home)[0]
    anchors = np.array([(limb.base_point - limb.platform_point)[0] + place for limb in limbs])
    at = [np.array([float(model.joint_coordinate(i, q)[0]) for i in range(len(limbs))])
          for q in (none, one)]
    own = list(order or range(len(limbs)))
    return RopeGeometry(anchors[own], at[0][own], (at[1] - at[0])[own],
                        tuple(mechanism.limbs[i].actuator for i in own))
