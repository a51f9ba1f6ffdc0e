"""Kinds of instruments: every module of this package registers its own, so a kind is one new file.

Other packages add kinds through the entry-point group ``ppmcal.instruments``: an entry loads an
:class:`InstrumentKind`.
"""

from __future__ import annotations

import importlib
import pkgutil

from ppmcal.model.instruments.kind import (
    HOMING,
    REGISTERED,
    ROTATION,
    InstrumentKind,
    find_instrument,
    instruments,
    is_own_reading,
    number_names,
    register,
)

from ppmcal.model.instruments.pose import POSE  # isort: skip
from ppmcal.model.instruments.position import POSITION  # isort: skip
from ppmcal.model.instruments.plane import PLANE  # isort: skip
from ppmcal.model.instruments.distance import DISTANCE  # isort: skip

# in the order in which they are listed; new ones come last
for _module in sorted(m.name for m in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_module}")

__all__ = ["DISTANCE", "HOMING", "PLANE", "POSE", "POSITION", "REGISTERED", "ROTATION",
           "InstrumentKind", "find_instrument", "instruments", "is_own_reading", "number_names",
           "register"]
