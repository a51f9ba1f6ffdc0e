"""What the shell completes, as options and arguments say it; files it completes by itself.

Where a machine cannot be read there is nothing to complete.
"""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterable

import click


def completed(place: str) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return what completes a word with names.

    Args:
        place: ``module:name`` of the names, or of a function that returns them, of the machine
            that was named before where it takes one.
    """
    def complete(context: click.Context, _: click.Parameter, begun: str) -> list[str]:
        from ppmcal.errors import PpmcalError

        try:
            return sorted(n for n in _names(place, context) if n.lower().startswith(begun.lower()))
        except (PpmcalError, OSError):
            return []

    return complete


def _names(place: str, context: click.Context) -> Iterable[str]:
    module, _, name = place.partition(":")
    found = getattr(importlib.import_module(module), name)
    if not callable(found):
        return found    # type: ignore[no-any-return]
    if not inspect.signature(found).parameters:
        return found()    # type: ignore[no-any-return]
    # an option that waits for its value leaves the words before it as they are
    own = [p.name or "" for p in context.command.params if isinstance(p, click.Argument)]
    words = [*map(context.params.get, own[:1]), *context.args]
    machine = next((word for word in words if word), None)
    return found(machine) if machine else []
