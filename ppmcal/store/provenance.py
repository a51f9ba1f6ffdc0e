"""Where results come from: inputs, command and options, and the arithmetic of the machine.

Libraries that multiply matrices pick their code by the processor and split sums by threads, so the
same program gives other last digits elsewhere. No names of hosts and no times are in it: two runs
on one machine write the same bytes.
"""

from __future__ import annotations

import ctypes
import importlib.util
import os
import platform
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ppmcal import __version__
from ppmcal.errors import BadInput
from ppmcal.store.inputs import content_of, current, path_errors, reading, track_input

IN_MEMORY = "in_memory"
"""The key that an argument without a file is recorded under, with the name of its type."""
_CALL: ContextVar[tuple[str, dict[str, Any]] | None] = ContextVar("call", default=None)
LOADED_ONLY = getattr(os, "RTLD_NOLOAD", 0)
"""Asks for a library that is loaded already, and loads none."""
AFFIXES = (("scipy_openblas_", "64_"), ("scipy_openblas_", ""), ("openblas_", "64_"),
           ("openblas_", ""))
"""What stands before and behind the names of OpenBLAS's functions in the wheels of NumPy, SciPy."""


@dataclass(frozen=True)
class Provenance:
    """Where results come from: version, SHA-256 of each input, command, options, arithmetic."""

    version: str = ""
    inputs: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    seed: int | None = None
    function: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)
    numpy: str = ""
    python: str = ""

    def inputs_of(self, source: str) -> list[str]:
        """Return the inputs that a data set came from: the very one, else its namesakes."""
        return [k for k in self.inputs if k == source] or [
            k for k in self.inputs if source and Path(k).name == Path(source).name]


@contextmanager
def recording(function: str, options: dict[str, Any]) -> Iterator[None]:
    """Let the provenance of what is found in the block hold a function and its arguments.

    Its sums run in one thread of BLAS, so that they are the same wherever it runs. ``verify``
    calls it again by its name, with the arguments that were recorded.
    """
    token = _CALL.set((function, options))
    try:
        with one_thread(), path_errors(), reading() as run:
            run.source.update(function=function, options=options)
            yield
    finally:
        _CALL.reset(token)


def as_json(value: Any, default: Any = None) -> Any:
    """Return an argument as JSON has it; a number in words, where a number goes, as that."""
    if isinstance(value, str) and isinstance(default, float):
        try:
            return float(value)
        except ValueError:
            return value
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, list | tuple):
        return [as_json(v) for v in value]
    if isinstance(value, Mapping) and all(isinstance(v, int | float) for v in value.values()):
        return dict(value)
    return {IN_MEMORY: type(value).__name__}


def source_of(function: str, inputs: Sequence[str | os.PathLike[str]], seed: int | None
              ) -> dict[str, Any]:
    """Return where a result comes from; the command as it was typed, or the function's name."""
    run = current()
    typed = run.typed or (
        "ppmcal " + shlex.join(sys.argv[1:]) if run.command else f"ppmcal.{function}()")
    own = dict.fromkeys(str(path) for path in inputs)
    call = _CALL.get() or (run.source.get("function", ""), run.source.get("options"))
    return provenance([*own, *sorted(set(run.read.values()) - {*own})], typed, seed, *call)


def provenance(inputs: Sequence[str | os.PathLike[str]], command: str, seed: int | None,
               function: str = "", options: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return where results come from: all that decides what is in them.

    Args:
        inputs: files that were read.
        command: as it was typed.
        seed: of what is drawn at random.
        function: that made the result, as ``verify`` knows it.
        options: all that it was called with, defaults too.
    """
    sums, run = {}, current()
    for path in inputs:
        track_input(path)
        sums[str(path)] = content_of(path, run)
        if not sums[str(path)]:
            raise BadInput("is not there any more, or cannot be read", str(path),
                           "Give the path of a readable file")
    return {"version": __version__, "inputs": sums, "command": command, "seed": seed,
            "function": function, "options": dict(options or {}), "environment": environment(),
            "numpy": np.__version__, "python": platform.python_version()}


def origin_comment(source: Mapping[str, Any]) -> str:
    """Return the provenance of a file that stands alone, as comments at the head of a YAML file."""
    lines = [f"made by ppmcal {source['version']}: {source['command']}",
             *(f"from {path}, sha256 {digest}" for path, digest in source["inputs"].items()),
             f"with Python {source['python']}, NumPy {source['numpy']}"]
    return "".join(f"# {_on_one_line(line)}\n" for line in lines)


def _on_one_line(text: str) -> str:
    """Return text without what would end a comment: a name may have a line break in it."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii")
                   for c in text)


# ---- arithmetic


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
