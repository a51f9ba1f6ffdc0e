"""What effects make of a machine: strokes that are left open, what is carried, loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import ppmcal
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.effect_response import (
    carried_by,
    effect_terms,
    setting,
    shifted,
    with_strokes,
)
from ppmcal.kinematics.inverse import inverse
from ppmcal.model.dataset import unknown_environment
from ppmcal.model.effects import effect_kinds
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import PLANAR
from ppmcal.units import SI


def machine(name: str, limits: bool = True, **effects: Mapping[str, object]) -> Mechanism:
    """Return a shipped machine, its joints without limits if need be, with effects in SI units."""
    found = ppmcal.load(ppmcal.shipped(name))
    if not limits:
        found = replace(found, limits=np.array([[-np.inf, np.inf]] * len(found.actuators)))
    return with_effects(found, [{"kind": k, "parameters": v} for k, v in effects.items()], SI, "e")


@pytest.mark.parametrize(("kind", "values", "spread"), [
    ("compliance", {"stiffness": 1e6}, False),
    ("compliance", {"stiffness": 1e6, "by_stroke": 0.4}, True),
    ("compliance", {"stiffness": 1e6, "by_stroke": {"value": 0.0, "free": True}}, True),
    ("curvature", {"p2": 0.0}, False), ("curvature", {"p2": 1e-5}, True),
    ("hysteresis", {"w1": 1e-4}, True)])
@pytest.mark.parametrize("limits", [True, False])
def test_strokes_are_those_of_joints_where_nothing_else_says_them(
        kind: str, values: dict[str, object], spread: bool, limits: bool) -> None:
    """And where something is spread over them; limits are strokes as they are."""
    mechanism = machine("3-RPR", limits, **{kind: values})
    q = np.array([[0.3, 0.5, 0.4], [0.6, 0.35, 0.45], [np.nan, 0.4, 0.4]])
    effect, = with_strokes(mechanism, q).effects
    names = effect_kinds()[kind].stroke_ends(PLANAR)
    found = [with_strokes(mechanism, q).parameters[effect.parameters[n]] for n in names]
    assert [p.value for p in found] == pytest.approx(
        [0.3, 0.6] if spread and not limits else [np.nan, np.nan], nan_ok=True)
    for p in found:
        assert p.nominal == pytest.approx(p.value, nan_ok=True)


def test_what_is_carried_moves_what_gives_way_from_where_it_is() -> None:
    """Turned weight that is turned more: about another axis than from the vertical."""
    mechanism = machine("6-UPS", compliance={"stiffness": 1e6},
                        gravity_tilt={"first": 0.3, "second": -0.8})
    model, kind = Model(mechanism), effect_kinds()["gravity_tilt"]
    pose = mechanism.home[None]
    rows = replace(unknown_environment(1, 6), wrench=np.array([[0.0, 0.0, -100.0, 0.0, 0.0, 0.0]]),
                   weight=np.array([[0.0, 0.0, -100.0]]))
    q = inverse(Model(replace(mechanism, effects=())), pose).q
    at = setting(model, rows, q, pose)
    found = carried_by(kind, model, at)
    own = next(t for e, t in effect_terms(mechanism, model.parameters, at) if e.kind is kind)
    assert set(found) == set(own.by) == {"first", "second"}
    for name, shift in found.items():
        h = 1e-3
        ends = [shifted(Model(machine("6-UPS", compliance={"stiffness": 1e6}, gravity_tilt={
            "first": 0.3, "second": -0.8} | {name: {"first": 0.3, "second": -0.8}[name] + s * h})),
            rows, q, pose) for s in (1.0, -1.0)]
        for slot, value in shift.slots.items():
            plus, minus = (e.shift.slots[slot] for e in ends if e.shift is not None)
            np.testing.assert_allclose(value, (plus - minus) / (2.0 * h), rtol=1e-3, atol=1e-9)
