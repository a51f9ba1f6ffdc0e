"""A shift of the target relative to the platform in mid-run: bumped, or removed and remounted.

With several targets on the platform, of all as one body, or of one (`target`: its data set's name).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache

from ppmcal.errors import BadInput
from ppmcal.linalg import Bools
from ppmcal.model.effects.event import step_parameters, stepped
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    FromFile,
    Terms,
    Worked,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift
from ppmcal.model.motions import Motion
from ppmcal.units import Units


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Displace the target by the steps from the row on."""
    return stepped(setting, values, lambda step: Shift(target=step))


def _of_a_point(motion: Motion) -> tuple[EffectParameter, ...]:
    """Return one step per coordinate of a point, whose rotation is not observable."""
    return step_parameters([c for c in motion.coordinates if not c.startswith("r")])


@cache
def _of_one(target: str) -> EffectKind:
    """Return the kind for one of several targets, the same object each time."""
    def terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
        return stepped(setting, values, lambda step: Shift(targets={target: step}))

    return replace(
        TARGET_SHIFT, equation=f"target {target} displaced, platform axes, from row from_row on",
        parameters=_of_a_point, evaluate=terms, written=lambda units: {"target": target},
        title=f"{TARGET_SHIFT.name} of {target}", target=target, worked=None)


def _made(entries: Mapping[str, object], units: Units, joint: str) -> EffectKind:
    """Return the kind for the ``target`` given in a file.

    Raises:
        BadInput: it is not a name.
    """
    target = entries.get("target", "")
    if not isinstance(target, str):
        raise BadInput(f"'{target}' is not the name of a target", "target",
                       "Write the data set's name, such as `target: run3 T2`, or leave it out")
    return _of_one(target) if target else TARGET_SHIFT


TARGET_SHIFT = register(EffectKind(
    "target_shift", "target displaced by a twist, platform axes, from row from_row on",
    "ISO 230-1, set-up of the instrument",
    lambda motion: step_parameters(motion.coordinates), ("row",), _terms, per_actuator=False,
    instrument=True, onset="from_row", body="platform", from_file=FromFile(("target",), _made),
    of_target=_of_one, remedy="put the target back on its seat and repeat the first poses",
    worked=Worked({"x": 3e-5, "from_row": 5.0}, {"row": 6.0}, 3e-5)))
