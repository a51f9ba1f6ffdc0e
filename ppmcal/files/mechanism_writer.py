"""Writing a mechanism as a file that reads back as the same machine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ppmcal.files.effects import effects_tree
from ppmcal.files.exact import to_file
from ppmcal.files.mechanism_schema import FORMAT
from ppmcal.files.pose_text import OF_FRAME, OF_MOTION, pose_to_map
from ppmcal.files.slot_text import SlotWriter
from ppmcal.files.stiffness_reader import stiffness_trees
from ppmcal.files.yaml_text import dump_yaml
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.parameters import free_indices


def write_mechanism(mechanism: Mechanism, comment: str = "") -> str:
    """Return the text of an equivalent mechanism file, in ``mechanism.units``.

    Numbers have as many digits (at most 17) as it takes to read back equal. A slot is a plain
    number where that loses nothing, else ``{value, nominal, sigma, tolerance, fixed, share}``.
    Directions are written as they stand now, with the drawing's as ``nominal``; see
    :mod:`ppmcal.files.directions`.

    Args:
        mechanism: the machine, SI.
        comment: lines to put at the top.
    """
    writer = SlotWriter(mechanism)
    stiffness, own = stiffness_trees(mechanism)
    tree: dict[str, Any] = {
        "format": FORMAT, "name": mechanism.name,
        "units": {"length": mechanism.units.length, "angle": mechanism.units.angle},
        "motion": mechanism.motion,
        "limbs": [{**writer.limb(i), **own[i]} for i in range(len(mechanism.limbs))],
        "home": _home(mechanism),
    }
    if writer.tolerances:
        tree["tolerances"] = writer.tolerances
    limits = _limits(mechanism)
    if limits:
        tree["limits"] = limits
    default = [0.0, -1.0, 0.0] if mechanism.motion == "planar" else [0.0, 0.0, -1.0]
    if not np.array_equal(mechanism.gravity, default):
        tree["gravity"] = [float(v) for v in mechanism.gravity]
    if mechanism.effects:
        tree["effects"] = effects_tree(mechanism)
    if stiffness:
        tree["stiffness"] = stiffness
    if mechanism.cost:
        tree["cost"] = {name: {"weight": w, "exponent": e}
                        for name, (w, e) in mechanism.cost.items()}
    free = _free(mechanism)
    if free is not None:
        tree["free"] = free
    if mechanism.registrations:
        tree["measurement"] = {"datasets": _registrations(mechanism)}
    return dump_yaml(tree, comment)


def joint_factors(mechanism: Mechanism) -> Array:
    """Return the SI value of one file unit of each joint variable (k,); 1 with a ratio."""
    return np.array([1.0 if ratio else mechanism.units.factor(q) for q, ratio in zip(
        mechanism.actuator_quantity, mechanism.actuator_has_ratio, strict=True)])


def _home(mechanism: Mechanism) -> dict[str, Any]:
    out: dict[str, Any] = {"pose": pose_to_map(mechanism.home_pose, OF_MOTION[mechanism.motion],
                                               mechanism.units)}
    q = {name: to_file(float(v), float(f)) for name, v, f in zip(
        mechanism.actuators, mechanism.home_q, joint_factors(mechanism), strict=True)
        if np.isfinite(v)}
    if q:
        out["q"] = q
    return out


def _limits(mechanism: Mechanism) -> dict[str, list[float]]:
    return {name: [to_file(float(v), float(f)) for v in pair] for name, pair, f in zip(
        mechanism.actuators, mechanism.limits, joint_factors(mechanism), strict=True)
        if np.isfinite(pair).any()}


def _free(mechanism: Mechanism) -> list[str] | None:
    """Return the ``free`` list: the file's patterns, or names where the choice is another."""
    patterns = mechanism.free_patterns
    if tuple(free_indices(mechanism.parameters, patterns)) == tuple(mechanism.free):
        return None if patterns is None else list(patterns)
    return [mechanism.parameters[i].name for i in mechanism.free]


def _registrations(mechanism: Mechanism) -> Mapping[str, Any]:
    units = mechanism.units
    return {name: {
        "frame": pose_to_map(r.frame, OF_FRAME[mechanism.motion], units),
        "target": [to_file(float(v), units.factor("length")) for v in r.target],
        "target_rotation": [to_file(float(v), units.factor("angle")) for v in r.target_rotation],
    } for name, r in mechanism.registrations.items()}
