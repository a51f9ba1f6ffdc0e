"""Common parts of thermal effects: time constant, growth with temperature or drives' work."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from ppmcal.linalg import Bools
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    FromFile,
    ScanRange,
    Terms,
    Worked,
    chosen_by,
    fixed_list,
)
from ppmcal.model.effects.setting import Setting


def taus(data: ScanRange) -> list[float]:
    """Return time constants between a few rows and the whole campaign, s."""
    return [part * data.duration for part in (0.03, 0.1, 0.3)]


EXPANSION = EffectParameter("expansion", "1/K", low=-120e-6, high=120e-6, size=1e-6,
                            usual=(0.0, 120e-6), why="warm parts grow, metals by up to 30e-6 per "
                            "K, polymers of printed machines by up to 110e-6")
TAU = EffectParameter("tau", "s", 0.0, low=0.0, usual=(0.0, 1e6), size=1.0, scan=taus,
                      optional=True, needs=("past",),
                      why="with more than a week, nothing heats within a campaign")
OWN_WORK = fixed_list(
    EffectParameter("growth", "s/joint", low=-1.0, high=1.0, size=1e-4, usual=(0.0, 1.0),
                    why="work heats"),
    replace(TAU, default=None, optional=False, low=1e-6, usual=(1e-6, 1e6), needs=()))
"""Parameters of parts heated by the drives' own work."""


def grown(which: str, setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Return the terms of slots ``which`` x (1 + expansion x), x' = (T - 20 C - x)/tau."""
    warm, slope = setting.late(values["tau"])
    shape = setting.at_slots(which, warm, on)
    return Terms(shape.times(values["expansion"]), {
        "expansion": shape,
        "tau": setting.at_slots(which, values["expansion"] * slope, on)})


def rate_grown(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Return the terms of struts x (1 + growth x), x' = (|dq|/dt - x)/tau by joint."""
    work, slope = setting.worked(values["tau"])
    shape = setting.at_struts(work, on)
    return Terms(shape.times(values["growth"]), {
        "growth": shape, "tau": setting.at_struts(np.asarray(values["growth"] * slope), on)})


def mean_rate_grown(which: str, setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Return the terms of slots ``which`` x (1 + growth x), x' = (mean |dq|/dt - x)/tau."""
    work, slope = (w.mean(axis=1) for w in setting.worked(values["tau"]))
    shape = setting.at_slots(which, work, on)
    return Terms(shape.times(values["growth"]), {
        "growth": shape, "tau": setting.at_slots(which, values["growth"] * slope, on)})


def source_of_heat(body: str, kinds: Callable[[], Mapping[str, EffectKind]]) -> FromFile:
    """Return the file entry for the source of heat: ``from: motion``, or none for the thermometer.

    ``body``: the heated part, for the message; ``kinds``: returns source -> kind.
    """
    return chosen_by("from", "thermometer", kinds, f"{body} not heated from '{{}}'",
                     "Write `from: motion` (the drives' own work), or leave it out")


def body_thermal(body: str, remedy: str) -> EffectKind:
    """Return the kind ``base_thermal`` or ``platform_thermal``, heated by the air or the drives.

    ``remedy``: what to measure to distinguish it from similar effects.
    """
    file, name = source_of_heat(f"the {body} is", lambda: by_source), f"{body}_thermal"
    motion = EffectKind(
        name, f"{body} points x (1 + growth x), x' = (mean |dq|/dt of all drives - x)/tau",
        "ISO 230-3, distortion by moving axes: the drives' work heats their support",
        OWN_WORK, ("past",), partial(mean_rate_grown, body), per_actuator=False, from_file=file,
        written=lambda units: {"from": "motion"}, title=f"{name} from motion", body=body,
        remedy="move all joints back and forth for a while between two measurements of one pose")
    air = EffectKind(
        name, f"{body} points x (1 + expansion x), x' = (T - 20 C - x)/tau",
        "ISO 1: lengths refer to 20 degrees Celsius; ISO 230-3, thermal effects",
        fixed_list(EXPANSION, TAU), ("temperature",), partial(grown, body), per_actuator=False,
        from_file=file, variants=lambda motion: tuple(by_source.values()), remedy=remedy,
        worked=Worked({"expansion": 11e-6, "tau": 0.0}, {"temperature": 5.0, body: 2.0}, 1.1e-4),
        body=body)
    by_source = {"thermometer": air, "motion": motion}
    return air
