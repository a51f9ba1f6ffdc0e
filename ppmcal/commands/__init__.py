"""What a person can ask of the program: one folder for each command, and nowhere a list of them.

A folder's docstring is the line in the list of commands, its ``ORDER`` the place there. Its module
``options`` has ``COMMAND``, the :class:`~ppmcal.commands.spec.Command`: what it takes and how it is
called. Its module ``run`` has ``run(asked)``, which does the work, and may have
``when_refused(error, asked, folder)``: what is left where there is no result, a
:class:`~ppmcal.commands.spec.Refusal` or None. The command line, the Python face, ``verify``,
completion and the docs are made of these.

A folder whose name would be a word of Python ends in an underscore, its command does not.
"""

from __future__ import annotations

import importlib
import os
from functools import cache

TYPE_CHECKING = False    # what the list of commands needs not loads nothing
if TYPE_CHECKING:
    from types import ModuleType

    from ppmcal.commands.spec import Command, Face


@cache
def names() -> tuple[str, ...]:
    """Return the names of all commands, in the order of the work."""
    return tuple(sorted(_folders(), key=lambda name: (int(_module(name).ORDER), name)))


def exists(name: str) -> bool:
    """Return whether there is such a command; loads none."""
    return name in _folders()


def line(name: str) -> str:
    """Return what a command does, in a line."""
    return (_module(name).__doc__ or "").strip()


@cache
def command(name: str) -> Command:
    """Return what a command takes."""
    found: Command = _module(name, ".options").COMMAND
    return found


def work(name: str) -> ModuleType:
    """Return the module that does the work of a command."""
    return _module(name, ".run")


@cache
def functions() -> dict[str, tuple[str, Face]]:
    """Return name -> command and face of all functions that commands have in Python."""
    return {face.name: (one, face) for one in names() for face in command(one).functions}


def folder(name: str) -> str:
    """Return the name of a command's folder."""
    return _folders()[name]


@cache
def _folders() -> dict[str, str]:
    return {one.rstrip("_"): one for place in __path__ for one in os.listdir(place)
            if os.path.isfile(os.path.join(place, one, "__init__.py"))}


def _module(name: str, within: str = "") -> ModuleType:
    return importlib.import_module(f"{__name__}.{folder(name)}{within}")
