"""How functions are compiled, and where compiled functions are cached.

numba uses a file's time and size to decide whether a cached function is still valid, and ignores
the functions that it calls. Installed packages all have one time, and a corrected sign does not
change the size: so the cache folder is named by the contents of the files. It is in the
user's cache, never in the package: an installer does not remove what it did not write, and a folder
left behind could still be imported.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

from ppmcal.wording.progress import stage

log = logging.getLogger(__package__)

Function = TypeVar("Function", bound=Callable[..., object])

COMPILING = "compiling what takes many rows, some 15 s, once"

part = numba.njit(error_model="numpy", nogil=True, forceinline=True)
"""A part of compiled functions. No sum is reordered (no fast-math)."""
called = numba.njit(error_model="numpy", nogil=True)
"""A part that few machines need, too large to be inlined in each function."""


def compiled(function: Function) -> Function:
    """Return a function compiled at its first call, which is announced, and cached from then on."""
    folder = _folder(function.__globals__["__file__"])
    settings: Any = numba.config
    before, settings.CACHE_DIR = settings.CACHE_DIR, folder
    try:
        made: Any = numba.njit(cache=bool(folder), error_model="numpy", nogil=True)(function)
    finally:
        settings.CACHE_DIR = before

    @wraps(function)
    def call(*args: object) -> object:
        if made.signatures or _kept(folder, function.__name__):
            return made(*args)
        log.info("compiling %s", function.__name__)
        with stage(COMPILING):
            return made(*args)

    return cast(Function, call)


def _kept(folder: str, name: str) -> bool:
    """Whether a function of that name was compiled before, by numba's index file."""
    return bool(folder) and any(Path(folder).rglob(f"*.{name}-*.nbi"))


@cache
def _folder(source: str) -> str:
    """Return the cache folder of a file's functions, "" if nothing can be written."""
    here = Path(__file__).parent
    files = sorted({*here.glob("compil*.py"), *Path(source).parent.glob("compil*.py"),
                    Path(source)})
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in files)).hexdigest()[:16]
    home = os.path.expanduser("~")
    if not os.environ.get("XDG_CACHE_HOME") and home == "~":
        return ""    # a user unknown to the system has no home
    folder = Path(os.environ.get("XDG_CACHE_HOME") or Path(home, ".cache"), "ppmcal", digest)
    with suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return str(folder) if os.access(folder, os.W_OK) else ""
