"""How functions are compiled, and where what was compiled is kept.

numba looks at a file's time and size to see whether a kept function is still the same, and not at
the functions that it calls. Installed packages all have one time, and a sign that was mended has
the size of the one that was not: so the folder is named by what is in the files.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])

part = numba.njit(error_model="numpy", nogil=True, forceinline=True)
"""A piece of compiled functions. No sum is reordered (no fast-math)."""


def compiled(function: Function) -> Function:
    """Return a function compiled at its first call and kept from then on."""
    folder = _folder(function.__globals__["__file__"])
    settings: Any = numba.config
    before, settings.CACHE_DIR = settings.CACHE_DIR, folder
    try:
        made: Any = numba.njit(cache=bool(folder), error_model="numpy", nogil=True)(function)
    finally:
        settings.CACHE_DIR = before
    return cast(Function, made)


@cache
def _folder(source: str) -> str:
    """Return where functions of a file are kept, "" where nothing can be written."""
    here = Path(__file__).parent
    files = sorted({*here.glob("compil*.py"), *Path(source).parent.glob("compil*.py"),
                    Path(source)})
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:16]
    user = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for folder in (here / "__pycache__" / "compiled", user / "ppmcal"):
        try:
            (folder / digest).mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder / digest, os.W_OK):
            return str(folder / digest)
    return ""
