"""What a result says of where it is from: the function, its arguments and the files."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from numbers import Integral
from typing import Any

from ppmcal.commands.spec import Path_
from ppmcal.errors import BadInput
from ppmcal.io import provenance
from ppmcal.io.environment import one_thread
from ppmcal.io.folder import current, reading
from ppmcal.io.input_files import path_errors
from ppmcal.io.json import LARGEST_WHOLE

IN_MEMORY = "in_memory"
"""The key that an argument without a file is recorded under, with the name of its type."""
_CALL: ContextVar[tuple[str, dict[str, Any]] | None] = ContextVar("call", default=None)


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


def refuse_seed(seed: object) -> None:
    """Refuse what is not a seed, or one that its own record could not hold.

    Raises:
        BadInput: not a whole number from 0 to 2^53.
    """
    if seed is None or (isinstance(seed, Integral) and not isinstance(seed, bool)
                        and 0 <= int(seed) <= LARGEST_WHOLE):
        return
    raise BadInput(f"{str(seed)[:40]} is not a seed", "--seed",
                   f"Give a whole number from 0 to {LARGEST_WHOLE}")


def refuse_words(name: str, kind: str, value: Any) -> None:
    """Refuse what is not a number where an argument takes nothing else.

    Args:
        name: of the argument.
        kind: its annotation.
        value: as it was given.

    Raises:
        BadInput: with the name of the argument.
    """
    if value is None or kind.removesuffix(" | None") not in ("float", "int"):
        return
    with suppress(TypeError, ValueError):
        if not isinstance(value, str):
            float(value)
            return
    raise BadInput(f"{str(value)[:40]!r} is not a number",
                   f"--{name.replace('_', '-')}", "Give a bare number, without a unit")


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


def source_of(function: str, inputs: Sequence[Path_], seed: int | None) -> dict[str, Any]:
    """Return where a result comes from; the command as it was typed, or the function's name."""
    run = current()
    typed = run.typed or (
        "ppmcal " + shlex.join(sys.argv[1:]) if run.command else f"ppmcal.{function}()")
    own = dict.fromkeys(str(path) for path in inputs)
    call = _CALL.get() or (run.source.get("function", ""), run.source.get("options"))
    return provenance([*own, *sorted(set(run.read.values()) - {*own})], typed, seed, *call)
