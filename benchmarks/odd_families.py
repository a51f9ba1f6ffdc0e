"""Families of odd physics: each changes the joints' values or what is seen by tenths of a mm."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import isfunction
from types import ModuleType

import odd_couplings
import odd_joints
import odd_noise
import odd_readings
from odd_campaign import Campaign

Family = Callable[[Campaign], None]


def nothing(_: Campaign) -> None:
    """Do nothing."""


LISTED = ("reversal", "homed_anew")
"""What the library has."""


def families_of(module: ModuleType) -> dict[str, Family]:
    """Return the families of a module by name."""
    return {name: do for name, do in vars(module).items() if isfunction(do)
            and do.__module__ == module.__name__ and not name.startswith("_")}


EVERY = families_of(odd_joints) | families_of(odd_readings) | families_of(odd_couplings)
NOISE = families_of(odd_noise)
FAMILIES: Mapping[str, Family] = {"nothing": nothing, **EVERY, **NOISE}
GROUPS: Mapping[str, tuple[str, ...]] = {
    "nothing": ("nothing",),
    "what no library has": tuple(n for n in EVERY if n not in LISTED),
    "noise that is not as stated": tuple(NOISE), "what the library has": LISTED}
REVERSAL = {"backlash", "play", "hysteresis"}
RIGHT: dict[str, set[str]] = {
    "crooked_wave": {"periodic"}, "swelling_wave": {"periodic"}, "two_waves": {"periodic"},
    "bent_nut": {"periodic"}, "wave_under_load": {"periodic"}, "fading_wave": {"periodic"},
    "reversal": REVERSAL, "loaded_reversal": REVERSAL, "half_a_reversal": REVERSAL,
    "dead_zone": REVERSAL, "side_under_load": REVERSAL,
    "homed_anew": {"zero_shift"}, "homed_often": {"zero_shift"}, "slips": {"zero_shift"},
    "settling": {"zero_shift"}, "wrong_rows_of_joint": {"zero_shift"},
    "bursts": {"target_shift", "base_shift"}, "sag_by_place": {"base_compliance"},
    "staircase": {"periodic", "gain"}, "hot_only": {"leg_thermal"},
    "lens": {"sensor_scale", "sensor_scale_axis"}}
"""Kinds that are part of what was done."""
