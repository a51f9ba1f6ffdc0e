"""A shift of the base relative to the instrument in mid-run: one of them was bumped."""

from __future__ import annotations

from collections.abc import Mapping

from ppmcal.linalg import Bools
from ppmcal.model.effects.event import step_parameters, stepped
from ppmcal.model.effects.kind import EffectKind, EffectParameter, Terms, Worked, register
from ppmcal.model.effects.setting import Setting, Shift
from ppmcal.model.motions import Motion


def _parameters(motion: Motion) -> tuple[EffectParameter, ...]:
    """Return one step per coordinate of the base, including rotations of any machine."""
    return step_parameters(motion.frame_coordinates)


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Displace the base by the steps from the row on."""
    return stepped(setting, values, lambda step: Shift(frame=step))


BASE_SHIFT = register(EffectKind(
    "base_shift", "base displaced by a twist, base axes, from row from_row on",
    "ISO 230-1, set-up of the instrument", _parameters, ("row",), _terms, per_actuator=False,
    instrument=True, onset="from_row", body="base",
    remedy="measure fixed points of the base at intervals",
    worked=Worked({"x": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
