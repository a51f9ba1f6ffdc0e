"""What the shell completes: kinds of machines and effects, formats, files, parameters.

Files it completes by itself. Where a machine cannot be read there is nothing to complete.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import click

Complete = Callable[[click.Context, click.Parameter, str], list[str]]


def _from(names: Callable[[click.Context], Iterable[str]]) -> Complete:
    def complete(context: click.Context, _: click.Parameter, begun: str) -> list[str]:
        from ppmcal.errors import PpmcalError

        try:
            return sorted(n for n in names(context) if n.lower().startswith(begun.lower()))
        except (PpmcalError, OSError):
            return []

    return complete


def _machines(_: click.Context) -> Iterable[str]:
    from ppmcal.io.templates import templates

    return templates()


def _imports(_: click.Context) -> Iterable[str]:
    from ppmcal.api.import_ import FORMATS

    return FORMATS


def _exports(_: click.Context) -> Iterable[str]:
    from ppmcal.controllers.export import formats

    return formats()


def _schemas(_: click.Context) -> Iterable[str]:
    from ppmcal.api.schema import RESULTS
    from ppmcal.io.json_schema import FILES

    return [*FILES, *RESULTS]


def _effects(_: click.Context) -> Iterable[str]:
    from ppmcal.model.effects import effect_kinds

    return effect_kinds()


def _parameters(context: click.Context) -> Iterable[str]:
    from ppmcal.api.inputs import load

    # an option that waits for its value leaves the words before it as they are
    words = [context.params.get("mech"), *context.args]
    machine = next((word for word in words if word), None)
    return load(machine).names if machine else []


machines, imports, exports = _from(_machines), _from(_imports), _from(_exports)
schemas, effects, parameters = _from(_schemas), _from(_effects), _from(_parameters)
