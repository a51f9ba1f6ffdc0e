"""What besides inputs and options may change the last digits of a result: the machine's arithmetic.

Libraries that multiply matrices pick their code by the processor and split sums by threads, so the
same program gives other last digits elsewhere. No names of hosts and no times are in it: two runs
on one machine write the same bytes.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import platform
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

LOADED_ONLY = getattr(os, "RTLD_NOLOAD", 0)
"""Asks for a library that is loaded already, and loads none."""
AFFIXES = (("scipy_openblas_", "64_"), ("scipy_openblas_", ""), ("openblas_", "64_"),
           ("openblas_", ""))
"""What stands before and behind the names of OpenBLAS's functions in the wheels of NumPy, SciPy."""


def environment() -> dict[str, str | int]:
    """Return versions of Python and libraries, BLAS with its kernel and threads, and processor."""
    return {**_fixed(), **_blas_of("numpy")}


@cache
def _fixed() -> dict[str, str | int]:
    """Return what stays as long as the process runs."""
    built: Any = np.show_config(mode="dicts")
    blas = built.get("Build Dependencies", {}).get("blas", {})
    simd = built.get("SIMD Extensions", {})
    return {"python": f"{platform.python_implementation()} {platform.python_version()}",
            "numpy": np.__version__, "scipy": version_of("scipy"), "numba": version_of("numba"),
            "system": platform.system(), "machine": platform.machine(), "libc": _libc(),
            "cpu": " ".join([*simd.get("baseline", ()), *simd.get("found", ())]),
            "blas": f"{blas.get('name', 'unknown')} {blas.get('version', '')}".strip()}


def version_of(package: str) -> str:
    """Return the version of a package without loading it, empty where it is not installed."""
    if (module := sys.modules.get(package)) is not None:
        return str(getattr(module, "__version__", ""))
    with suppress(ImportError, ValueError):
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.origin is not None:
            named = Path(spec.origin).parents[1].glob(f"{package}-*.dist-info")
            return max((p.name.split("-")[1].removesuffix(".dist") for p in named), default="")
    return ""


def _libc() -> str:
    try:
        return os.confstr("CS_GNU_LIBC_VERSION") or ""
    except (AttributeError, OSError, ValueError):
        return ""


def _libraries(package: str) -> list[Any]:
    """Return the OpenBLAS of a package, if it is loaded and came with it."""
    module = sys.modules.get(package)
    home = Path(str(getattr(module, "__file__", "") or "."))
    found = []
    for path in sorted(home.parents[1].glob(f"{package}.libs/*openblas*")) if module else []:
        with suppress(OSError):
            found.append(ctypes.CDLL(str(path), mode=LOADED_ONLY))
    return found


def _function(library: Any, name: str) -> Any:
    for before, behind in AFFIXES:
        with suppress(AttributeError):
            return getattr(library, f"{before}{name}{behind}")
    return None


def _blas_of(package: str) -> dict[str, str | int]:
    """Return the kernel and the threads of a package's OpenBLAS, nothing of another library."""
    found: dict[str, str | int] = {}
    for library in _libraries(package):
        kernel, threads = (_function(library, n) for n in ("get_corename", "get_num_threads"))
        if kernel is not None and threads is not None:
            kernel.restype = ctypes.c_char_p
            found = {"blas_kernel": (kernel() or b"").decode(), "blas_threads": int(threads())}
    return found


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep the OpenBLAS of NumPy and SciPy to one thread: sums in one order, wherever it runs.

    More of them slow the small matrices of a fit down.
    """
    before = []
    for library in (*_libraries("numpy"), *_libraries("scipy")):
        get, put = (_function(library, n) for n in ("get_num_threads", "set_num_threads"))
        if get is not None and put is not None and get() != 1:
            before.append((put, get()))
            put(1)
    try:
        yield
    finally:
        for put, threads in before:
            put(threads)
