"""Limb kinds: every module of this package registers its own, so a kind is one new file.

Other packages add kinds through the entry-point group ``ppmcal.limbs``: an entry loads a
:class:`LimbKind`.
"""

from __future__ import annotations

import importlib
import pkgutil

from ppmcal.model.limbs.kind import ClosureSurface, LimbKind, Surface, find_kind, kinds, register

for _module in sorted(m.name for m in pkgutil.iter_modules(__path__)):
    importlib.import_module(f"{__name__}.{_module}")

__all__ = ["ClosureSurface", "LimbKind", "Surface", "find_kind", "kinds", "register"]
