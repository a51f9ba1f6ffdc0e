"""Machines whose file gives a diameter for a radius, or the reverse, or lengths in another unit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ppmcal.model.mechanism import Mechanism


def other_radii(mechanism: Mechanism) -> Iterator[tuple[Mechanism, tuple[str, ...], str]]:
    """Yield machines with base, platform or both scaled by 0.5 or 2: machine, ends, description."""
    for ends in (("base",), ("platform",), ("base", "platform")):
        for factor, given, meant in ((0.5, "diameter", "radius"), (2.0, "radius", "diameter")):
            machine = scaled_points(mechanism, ends, factor)
            if machine is not None:
                far = "twice" if factor < 1.0 else "half"
                yield machine, ends, (f"the {' and '.join(ends)} points are {far} as far out as "
                                      "{reason}: " + f"a {given} for a {meant}?")


def scaled_points(mechanism: Mechanism, ends: Sequence[str], factor: float) -> Mechanism | None:
    """Return the machine with the joints of its base or platform scaled about the z axis.

    None if all those points are on the z axis. ``ends``: base, platform.
    """
    parameters, found = [], False
    for p in mechanism.parameters:
        mine = any(f"{end}.point." in p.name for end in ends) and p.name.rsplit(".", 1)[-1] in (
            "x", "y", "radius")
        found |= mine and p.value != 0.0
        parameters.append(replace(p, value=factor * p.value, nominal=factor * p.nominal)
                          if mine else p)
    return replace(mechanism, parameters=tuple(parameters)) if found else None


def scaled_lengths(mechanism: Mechanism, factor: float) -> Mechanism:
    """Return the machine with all its lengths, and their tolerances, times ``factor``."""
    def scaled(value: float | None) -> float | None:
        return None if value is None else factor * value

    parameters = tuple(p if not p.quantity.startswith("length") else replace(
        p, value=factor * p.value, nominal=factor * p.nominal, tolerance=scaled(p.tolerance),
        sigma=scaled(p.sigma), size=scaled(p.size)) for p in mechanism.parameters)
    of_joints = np.array([factor if q == "length" and not bare else 1.0 for q, bare in zip(
        mechanism.actuator_quantity, mechanism.actuator_has_ratio, strict=True)])
    return replace(
        mechanism, parameters=parameters,
        home_pose=mechanism.home_pose * np.where(np.arange(6) < 3, factor, 1.0),
        home_q=mechanism.home_q * of_joints, limits=mechanism.limits * of_joints[:, None],
        gaps={name: factor * gap for name, gap in mechanism.gaps.items()},
        digits={q: v * (factor if q == "length" else 1.0) for q, v in mechanism.digits.items()})
