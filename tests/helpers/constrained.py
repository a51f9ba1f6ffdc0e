"""Limbs that hold rotations, as serial chains of 4x4 matrices through all of their passive joints.

:func:`serial_pose` stands the platform where such a limb lets it stand: the passive joints are
drawn, the chain is multiplied out, and no closure equation is asked.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from helpers.machines import Array, chain, motors, read_text
from helpers.paths import ROOT
from ppmcal.model.mechanism import Mechanism

MACHINES = {"UP": "tricept", "U(P)U": "3-UPU", "(R)RPaU": "delta-parallelograms",
            "(P)RRR": "mixed-spatial", "U(P)R": "mixed-spatial",
            "UPU": "passive-legs", "UPR": "passive-legs"}
"""Kind -> a config with it."""
PASSIVE = {
    # base to the limb, with `a`, `b` ... the passive joints and `s` a passive slide; platform
    "UP": ("A D:base.axis J1 Rz:a Q Rz:b X:s", "B D:platform.axis:platform.direction J2x"),
    "U(P)U": ("A D:base.axis J1 Rz:a Rx:b Y:u Rx:c Rz:d", "B D:platform.axis:none J3"),
    "(R)RPaU": ("A D:base.axis:base.zero J1 Rz:u X:proximal J2 Rz:a Pa:b Rz:c Q Rz:d",
                "B D:platform.axis:none J4"),
    "(P)RRR": ("A D:base.axis J1 Z:u J2 Rz:a X:s Rz:b Y:t Z:lateral Rz:c",
               "B D:platform.axis:none J4"),
    "U(P)R": ("A D:base.axis J1 Rz:a Q Rz:b X:u Z:lateral Rz:c", "B D:platform.axis:none J3"),
    "UPU": ("A D:base.axis J1 Rz:a Rx:b Y:long Rx:c Rz:d", "B D:platform.axis:none J3"),
    "UPR": ("A D:base.axis J1 Rz:a Q Rz:b X:long Z:lateral Rz:c", "B D:platform.axis:none J3"),
}
CONDITIONS = {"UP": 3, "U(P)U": 2, "(R)RPaU": 2, "(P)RRR": 3, "U(P)R": 3,
              "UPU": 1, "UPR": 2}


def with_joint_frames(kind: str) -> Mechanism:
    """Return the config's machine with everything free, joint frames and `lateral` too."""
    text = (ROOT / "configs" / f"{MACHINES[kind]}.yaml").read_text(encoding="utf-8")
    return read_text(text.replace("# lateral:", "lateral:") + 'free: ["*"]\n')


def serial_pose(kind: str, v: Mapping[str, float], c: Mapping[str, Array], u: Array,
                rng: np.random.Generator) -> Array:
    """Return motors (N, 8) of a platform held by one limb alone.

    Args:
        kind: of the limb.
        v: its slots.
        c: its directions.
        u: joint coordinates (N,).
        rng: draws the passive joints.
    """
    passive = {name: rng.uniform(-0.8, 0.8, u.shape) for name in "abcdst"}
    passive["long"] = rng.uniform(0.4, 0.8, u.shape)
    base, platform = PASSIVE[kind]
    place = (chain(base, {**v, **passive}, c, u)
             @ np.linalg.inv(chain(platform, v, c, u)))
    return motors(place[:, :3, :3], place[:, :3, 3])
