"""Flatness errors of the touched flat, which look like errors of the machine.

Only for platforms that do not rotate: on others, the touching point of the tool is unknown here.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from ppmcal.linalg import Array, Bools
from ppmcal.model.effects.inputs import POSE
from ppmcal.model.effects.kind import (
    EffectKind,
    EffectParameter,
    Terms,
    Worked,
    fixed_list,
    linear,
    register,
)
from ppmcal.model.effects.setting import Setting, Shift

SHAPES: dict[str, Callable[[Array, Array], Array]] = {
    "bowl": lambda x, y: x**2 + y**2,
    "saddle": lambda x, y: x**2 - y**2,
    "twist": lambda x, y: 2.0 * x * y,
    "coma_x": lambda x, y: x * (x**2 + y**2),
    "coma_y": lambda x, y: y * (x**2 + y**2),
    "trefoil_x": lambda x, y: x**3 - 3.0 * x * y**2,
    "trefoil_y": lambda x, y: 3.0 * x**2 * y - y**3,
}
"""Heights of the flat over x and y relative to the radius: all of second and third order."""


def _terms(setting: Setting, on: Bools, values: Mapping[str, float]) -> Terms:
    """Raise the flat at (x, y) by sum c_i shape_i(x/radius, y/radius); no tilt, no height."""
    touch = np.zeros(setting.time.size, dtype=bool) if setting.touch is None else setting.touch
    x, y = (setting.pose[:, :2] / values["radius"]).T
    by = {}
    for name, shape in SHAPES.items():
        frame = np.zeros((touch.size, 6))
        # touching a hill, the platform reads the nominal height of the flat, not its own
        frame[:, 2] = np.where(touch, -shape(x, y), 0.0)
        by[name] = Shift(frame=frame)
    return linear(values, by)


BED_SHAPE = register(EffectKind(
    "bed_shape", "flat higher by sum c_i shape_i(x/radius, y/radius), second and third order",
    "Zernike's polynomials of second and third order (ISO 10110-5 has them for surfaces)",
    fixed_list(*(EffectParameter(name, "length", usual=(-1e-3, 1e-3), size=1e-5,
                                 why="beds and plates are flat to a few tenths of a millimetre")
                 for name in SHAPES),
               EffectParameter("radius", "length", 0.1, low=1e-6, constant=True)),
    ("touch",), _terms, per_actuator=False,
    exists_in=lambda motion: not (motion.turns or motion.planar), uses_load=True, instrument=True,
    follows=POSE, nuisance=True,
    remedy="touch another flat; the same one rotated by 60 deg about the middle shows all of its "
    "shape except a bowl: the shape rotates with it, an error of the machine stays",
    worked=Worked({**dict.fromkeys(SHAPES, 0.0), "bowl": 1e-4, "radius": 0.1},
                  {"touch": 1.0, "x": 0.1}, -1e-4)))
