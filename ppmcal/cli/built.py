"""The commands of the command line, from what they say that they take."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ppmcal.cli import completion
from ppmcal.cli.common import (
    FILE,
    FOLDER,
    MODEL,
    Console,
    console_options,
    examples,
    finish,
    out_option,
    plain_table,
)
from ppmcal.commands import command
from ppmcal.commands.spec import Command, Taken, taken

KINDS: dict[str, Any] = {
    "bool": bool, "float": float, "int": int, "str": str, "Path_": FILE, "Table": FILE,
    "Machine": MODEL}
"""Types of values by the annotation of a field."""


def built(name: str) -> click.Command:
    """Return a command for the command line."""
    spec = command(name)
    every = list(taken(spec.arguments))
    body: Any = console_options(_body(spec))
    for one in reversed([one for one in every if one.option.common]):
        body = _asked(one)(body)
    if spec.out:
        body = out_option(spec.out, spec.replace)(body)
    for one in reversed([one for one in every if not one.option.common]):
        body = _asked(one)(body)
    found: click.Command = click.command(
        name, epilog=examples(*spec.examples), help="\n\n".join(spec.help()))(body)
    return found


def _body(spec: Command) -> Any:
    folders = [one.name for one in taken(spec.arguments) if one.several and one.option.argument]

    def body(console: Console, out: Path | None = None, **given: Any) -> None:
        from ppmcal.commands.face import function

        many = [value for name in folders for value in given.pop(name)]
        result = function(spec.name)(*many, **given)
        written = [] if out is None else result.save(out)
        if console.speaks:
            show(result, console)
        if out is not None:
            finish(out, [p.name for p in written], console)
        console.summary(result.summary())
        raise click.exceptions.Exit(result.exit_code)

    return body


def show(result: Any, console: Console) -> None:
    """Print what a person wants to know of a result, then what needs a look."""
    from ppmcal.wording.tables import ShortTable

    for part in result.told():
        if isinstance(part, ShortTable):
            console.table(plain_table(part.heads, part.rows, part.right))
        else:
            console.say(part)
    console.warn_rows(result.warnings, result.row_failures)


def _asked(one: Taken) -> Any:
    """Return the argument or option of a field."""
    how, kind = one.option, _kind(one)
    if how.argument:
        return click.argument(one.name, metavar=how.metavar, type=kind,
                              nargs=-1 if one.several else 1, required=True)
    more: dict[str, Any] = {"help": how.text, "default": one.value}
    if one.kind == "bool":
        more["is_flag"] = True
    else:
        more |= {"type": kind, "metavar": how.metavar or None, "show_default": how.shown,
                 "multiple": one.several}
    if how.complete:
        more["shell_complete"] = getattr(completion, how.complete)
    flags = how.flags or ("--" + one.name.replace("_", "-"),)
    return click.option(*flags, one.name, **more)


def _kind(one: Taken) -> Any:
    """Return the type of a value."""
    how = one.option
    if how.choices:
        return click.Choice(how.choices)
    if how.least is not None or how.most is not None:
        return click.IntRange(how.least, how.most)
    return FOLDER if how.folder else KINDS[one.base]
