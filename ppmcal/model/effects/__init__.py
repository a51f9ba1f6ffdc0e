"""Physical effects beyond geometry: every module of this package registers its own kind.

Other packages add kinds through the entry-point group ``ppmcal.effects``: an entry loads
an :class:`EffectKind`.
"""

from __future__ import annotations

import importlib
import pkgutil

from ppmcal.model.effects.inputs import EffectInput, Inputs
from ppmcal.model.effects.kind import (
    GEOMETRY,
    SORTS,
    Derived,
    EffectKind,
    EffectParameter,
    FromFile,
    KnownRange,
    Reversal,
    ScanRange,
    Terms,
    effect_kinds,
    find_effect,
    register,
)
from ppmcal.model.effects.setting import LimbSetting, Setting, Shift, total

for _module in sorted(m.name for m in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_module}")

__all__ = ["GEOMETRY", "SORTS", "Derived", "EffectInput", "EffectKind", "EffectParameter",
           "FromFile", "Inputs", "KnownRange", "LimbSetting", "Reversal", "ScanRange", "Setting",
           "Shift", "Terms", "effect_kinds", "find_effect", "register", "total"]
