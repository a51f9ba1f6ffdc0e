"""The inputs of effects: the axes against which residuals are plotted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ppmcal.linalg import Array


@dataclass(frozen=True, eq=False)
class Inputs:
    """Inputs in N rows, SI, k actuators: see :class:`Setting`; nan where not recorded.

    ``pose`` (N, 6) of the platform; ``point`` (N, 3) as measured; ``temperature`` deg C; ``move``
    from the previous row.
    """

    travel: Array
    approach: Array
    velocity: Array
    load: Array
    temperature: Array
    wrench: Array
    time: Array
    row: Array
    pose: Array
    point: Array
    move: Array


@dataclass(frozen=True, eq=False)
class EffectInput:
    """One input.

    Attributes:
        name: as in ``diagnosis.json`` and plots.
        quantity: like that of a parameter (``joint/s``, ``load``), or ``deg C``; empty for classes
            and where each component has its own.
        value: rows -> the input of each joint (N, k), of the machine (N,), or its components
            (N, c).
        of_machine: measured coordinates are shown against it for an effect of the whole machine;
            otherwise joint errors.
        components: (name, quantity) of each component; empty if there is one.
        own_component: each coordinate is shown only against the component of its own name.
        classes: +1 and -1 are classes, joint by joint; other values are left out.
    """

    name: str
    quantity: str
    value: Callable[[Inputs], Array]
    of_machine: bool = False
    components: tuple[tuple[str, str], ...] = ()
    own_component: bool = False
    classes: bool = False


def _since_first(rows: Inputs) -> Array:
    known = np.isfinite(rows.time)
    return rows.time - float(np.min(rows.time[known])) if known.any() else rows.time


_PLACES = (("x", "length"), ("y", "length"), ("z", "length"))
_TURNS = (("rx", "angle"), ("ry", "angle"), ("rz", "angle"))

TRAVEL = EffectInput("travel", "joint", lambda rows: rows.travel)
PHASE = EffectInput("phase", "joint", lambda rows: rows.travel)
"""The travel, folded by the period of the kind that uses it."""
DIRECTION = EffectInput("direction", "", lambda rows: rows.approach, classes=True)
VELOCITY = EffectInput("velocity", "joint/s", lambda rows: rows.velocity)
MOVE = EffectInput("last move", "joint", lambda rows: rows.move)
LOAD = EffectInput("load", "load", lambda rows: rows.load)
WOUND_LOAD = EffectInput("wound load", "load", lambda rows: rows.approach * np.abs(rows.load))
TEMPERATURE = EffectInput("temperature", "deg C", lambda rows: rows.temperature)
TIME = EffectInput("time", "s", _since_first, of_machine=True)
WRENCH = EffectInput("wrench", "", lambda rows: rows.wrench, of_machine=True, components=(
    ("fx", "N"), ("fy", "N"), ("fz", "N"), ("mx", "N.m"), ("my", "N.m"), ("mz", "N.m")))
POSE = EffectInput("pose", "", lambda rows: rows.pose, of_machine=True,
                   components=(*_PLACES, *_TURNS))
POINT = EffectInput("point", "", lambda rows: rows.point, of_machine=True, components=_PLACES,
                    own_component=True)

ROW = EffectInput("row", "1", lambda rows: rows.row)

BY_NEED = {"dir": DIRECTION, "vel": VELOCITY, "load": LOAD, "tension": LOAD, "wrench": WRENCH,
           "temperature": TEMPERATURE, "time": TIME, "row": ROW, "touch": POSE,
           "order": DIRECTION, "past": TIME}
"""The columns that an effect may need, and its default input for each."""
