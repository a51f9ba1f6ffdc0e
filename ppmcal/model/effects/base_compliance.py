"""Compliance of the frame: platform or base deflects in proportion to the wrench."""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import replace
from functools import partial
from itertools import combinations_with_replacement

import numpy as np

from ppmcal import linalg
from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    Derived,
    EffectKind,
    EffectParameter,
    Terms,
    Worked,
    chosen_by,
    linear,
    register,
)
from ppmcal.model.effects.setting import PLACE, Setting, Shift
from ppmcal.model.motions import Motion

WRENCH = {"x": "fx", "y": "fy", "z": "fz", "rx": "mx", "ry": "my", "rz": "mz"}
"""The wrench component conjugate to each coordinate."""
COLUMN = {"fx": 0, "fy": 1, "fz": 2, "mx": 3, "my": 4, "mz": 5}
AT_BASE = {"fx": "fx", "fy": "fy", "fz": "fz", "mx": "mx fy fz", "my": "my fx fz", "mz": "mz fx fy"}
"""Wrench components at the platform's origin that contribute to each at the base's origin."""


def _parameter(c: str, w: str, component: str) -> EffectParameter:
    return EffectParameter(
        f"{c}_{w}", f"{'angle' if c[0] == 'r' else 'length'}/{'N.m' if w[0] == 'm' else 'N'}",
        size=1e-8, component=component)


def _parameters(motion: Motion) -> tuple[EffectParameter, ...]:
    """Return one compliance ``x_fx`` per coordinate and wrench component."""
    own = motion.coordinates
    return tuple(_parameter(c, WRENCH[by], WRENCH[by]) for c in own for by in own)


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """dpose_c = sum over w of c_w wrench_w, base axes, about the platform's origin."""
    by = {}
    for name in values:
        c, w = name.rsplit("_", 1)
        pose = np.zeros((setting.wrench.shape[0], 6))
        pose[:, PLACE[c]] = setting.wrench[:, COLUMN[w]]
        by[name] = Shift(pose=pose)
    return linear(values, by)


def _of_base(motion: Motion) -> tuple[EffectParameter, ...]:
    """Return the upper triangle of a symmetric C (reciprocity of Maxwell and Betti)."""
    pairs = combinations_with_replacement([(c, WRENCH[c]) for c in motion.coordinates], 2)
    return tuple(_parameter(c, w, f"{AT_BASE[v]} {AT_BASE[w]}") for (c, v), (_, w) in pairs)


CROSSED = ("x_my", "x_mz", "y_mx", "y_mz", "z_mx", "z_my")
"""Displacements by rotations about an axis, if the springs are off the base's origin."""


def _some(parameters: Callable[[Motion], tuple[EffectParameter, ...]], further: Container[str],
          motion: Motion) -> tuple[EffectParameter, ...]:
    """Return the diagonal of C and ``further`` names, as in a file with the other values at 0."""
    return tuple(s for s in parameters(motion) if s.name in further
                 or PLACE[s.name.rsplit("_", 1)[0]] == COLUMN[s.name.rsplit("_", 1)[1]])


def _base_terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Base twist C W, W = (f, m + p x f) at its origin; the platform at p is carried along.

    The platform's origin moves by t + r x p and its axes rotate by r, where (t, r) = C W.
    """
    place = setting.pose[:, :3]
    at_base = setting.wrench.copy()
    at_base[:, 3:] += np.cross(place, setting.wrench[:, :3])
    by = {}
    for name in values:
        c, w = name.rsplit("_", 1)
        i, j = PLACE[c], COLUMN[w]
        twist = np.zeros_like(at_base)
        twist[:, i] = at_base[:, j]
        twist[:, j] = at_base[:, i]
        twist[:, :3] += np.cross(twist[:, 3:], place)
        by[name] = Shift(pose=twist)
    return linear(values, by)


def _about(axis: int) -> Callable[[Mapping[str, float], float], float]:
    return partial(_center, axis)


def _center(axis: int, values: Mapping[str, float], middle: float) -> float:
    """Return a coordinate of the point c about which a moment rotates the base, m.

    A rotation r about c moves the origin by c x r: c is fitted by least squares to displacements
    and rotations under moments; 0 along an axis that they do not determine.
    """
    matrix = np.zeros((6, 6))
    for name, value in values.items():
        c, w = name.rsplit("_", 1)
        matrix[PLACE[c], COLUMN[w]] = matrix[COLUMN[w], PLACE[c]] = value
    turned = [k for k in (3, 4, 5) if matrix[k, k] != 0.0]
    if not turned:
        return 0.0
    # c x r = -[r] c
    rows = np.concatenate([np.cross(np.eye(3), matrix[3:, k]).T for k in turned])
    moved = np.concatenate([matrix[:3, k] for k in turned])
    return float(linalg.lstsq(rows, moved, rcond=1e-9)[0][axis])


def _variants(motion: Motion) -> tuple[EffectKind, ...]:
    """Return the kinds that a search tries: first springs along base axes, with few values."""
    of_base = (SEATED, ABOUT_BASE) if motion.turns else ()
    return (ALONG_AXES, BASE_COMPLIANCE, *of_base)


FILE = chosen_by(
    "about", "platform", lambda: {"platform": BASE_COMPLIANCE, "base": ABOUT_BASE},
    "a compliance cannot be about '{}'",
    "Write `about: base` (the base rotates on its supports), or leave it out")

ABOUT_BASE: EffectKind = EffectKind(
    "base_compliance", "base twist = C W, C symmetric, W the wrench at the base's origin",
    "[LIN] section 4.3; Maxwell's and Betti's reciprocity", _of_base, ("wrench",), _base_terms,
    per_actuator=False, uses_load=True, exists_in=lambda motion: motion.turns, from_file=FILE,
    written=lambda units: {"about": "base"}, title="base_compliance about base", body="base",
    derived=tuple(Derived(f"center_{'xyz'[k]}", "length", _about(k)) for k in range(3)),
    remedy="measure the base against the ground with an indicator while applying the payload")

SEATED = replace(ABOUT_BASE, parameters=partial(_some, _of_base, CROSSED))

BASE_COMPLIANCE: EffectKind = register(EffectKind(
    "base_compliance", "platform twist = C wrench, base axes",
    "[LIN] section 4.3: compliance outside the limbs", _parameters, ("wrench",), _terms,
    per_actuator=False, from_file=FILE, variants=_variants, body="base",
    worked=Worked({"x_fx": 1e-8}, {"wrench": 200.0}, 2e-6)))

ALONG_AXES = replace(BASE_COMPLIANCE, parameters=partial(_some, _parameters, ()))
