"""The Python function of a command, from what the command says that it takes."""

from __future__ import annotations

import importlib
import inspect
import textwrap
from collections.abc import Callable, Iterator
from functools import cache
from typing import Any

from ppmcal.api.inputs import recorded
from ppmcal.commands import command
from ppmcal.commands.spec import Command, Taken, taken
from ppmcal.wording.progress import heard, silent

WIDTH = 99
PROGRESS = inspect.Parameter("progress", inspect.Parameter.KEYWORD_ONLY, default=silent,
                             annotation="Progress")


@cache
def function(name: str) -> Callable[..., Any]:
    """Return the function of a command: it takes what the command takes, and ``progress``."""
    spec = command(name)
    module, _, work = spec.run.partition(":")

    def call(*args: Any, **given: Any) -> Any:
        bound = signature.bind(*args, **given).arguments
        bound.pop("progress", None)
        return getattr(importlib.import_module(module), work)(spec.arguments(**bound))

    signature = signature_of(spec)
    call.__name__ = call.__qualname__ = name
    call.__module__ = f"ppmcal.commands.{name}"
    call.__doc__ = document(spec)
    call.__signature__ = signature  # type: ignore[attr-defined]
    return recorded(heard(call)) if spec.recorded else heard(call)


def signature_of(spec: Command) -> inspect.Signature:
    """Return the signature: arguments, then options by name, then ``progress``."""
    return inspect.Signature([*map(_parameter, taken(spec.arguments)), PROGRESS],
                             return_annotation=spec.result)


def _parameter(one: Taken) -> inspect.Parameter:
    how = inspect.Parameter
    if one.option.argument and one.kind.startswith("tuple["):
        return how(one.name, how.VAR_POSITIONAL, annotation=one.base)
    return how(one.name, how.POSITIONAL_OR_KEYWORD if one.option.argument else how.KEYWORD_ONLY,
               annotation=one.kind, default=how.empty if one.required else one.value)


def document(spec: Command) -> str:
    """Return the docstring of the function."""
    about = "\n\n".join(map(_filled, spec.help(python=True)))
    return f"{about}\n\nArgs:\n{''.join(_lines(spec))}\nRaises:\n    {spec.raises}\n"


def _lines(spec: Command) -> Iterator[str]:
    for one in taken(spec.arguments):
        yield _filled(f"{one.name}: {one.option.text}", "    ") + "\n"
    yield "    progress: called with a line of text now and then.\n"


def _filled(text: str, indent: str = "") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=indent,
                         subsequent_indent=indent + "    " * bool(indent),
                         break_on_hyphens=False)
