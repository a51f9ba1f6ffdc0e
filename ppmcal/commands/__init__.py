"""What a person can ask of the program: one folder for each command, and nowhere a list of them.

A folder's docstring is the line in the list of commands, its ``ORDER`` the place there. Its module
``options`` has the :class:`~ppmcal.commands.spec.Command`: what it takes and how it is called; its
module ``run`` does the work. The command line, the Python face, ``verify``, completion and the docs
are made of these.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache
from types import ModuleType

from ppmcal.commands.spec import Command


@cache
def names() -> tuple[str, ...]:
    """Return the names of all commands, in the order of the work."""
    return tuple(sorted((m.name for m in pkgutil.iter_modules(__path__) if m.ispkg), key=order))


def order(name: str) -> int:
    """Return the place of a command in the list."""
    return int(_folder(name).ORDER)


def line(name: str) -> str:
    """Return what a command does, in a line."""
    return (_folder(name).__doc__ or "").strip()


def command(name: str) -> Command:
    """Return what a command takes."""
    found: Command = importlib.import_module(f"{__name__}.{name}.options").COMMAND
    return found


def _folder(name: str) -> ModuleType:
    return importlib.import_module(f"{__name__}.{name}")
