"""The commands of the command line, from what they say that they take."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from ppmcal.cli.common import (
    FILE,
    FOLDER,
    MODEL,
    Console,
    FiniteRange,
    as_run,
    console_options,
    examples,
    out_option,
)
from ppmcal.commands import command
from ppmcal.commands.spec import PYTHON, Arguments, Command, Script, Taken, flags, taken
from ppmcal.errors import PpmcalError

KINDS: dict[str, Any] = {
    "bool": bool, "float": float, "int": int, "str": str, "Path_": FILE, "Table": FILE,
    "Measurements": FILE, "Machine": MODEL}
"""Types of values by the annotation of a field."""


def built(name: str) -> click.Command:
    """Return a command for the command line."""
    spec = command(name)
    every = list(taken(spec.arguments, PYTHON))
    body = _printing(spec) if spec.data else _whole(spec)
    for one in reversed([one for one in every if one.option.common]):
        body = _asked(spec, one)(body)
    if spec.out:
        body = out_option(spec.out, spec.replace)(body)
    for one in reversed([one for one in every if not one.option.common]):
        body = _asked(spec, one)(body)
    said = "\n\n".join(map(spec.said, spec.paragraphs))
    found: click.Command = click.command(name, epilog=examples(*spec.examples), help=said)(body)
    return found


def _printing(spec: Command) -> Any:
    """Return the body of a command that prints data for programs, and nothing else."""
    def body(**given: Any) -> None:
        from ppmcal.commands.face import carry_out

        found = carry_out(spec, _arguments(spec, given))
        click.echo(json.dumps(found, indent=1, ensure_ascii=False))

    return console_options(body, data=True)


def _whole(spec: Command) -> Any:
    """Return the body of a command that has a result."""
    def body(console: Console, **given: Any) -> None:
        out: Path | None = given.pop("out") if spec.out else None
        asked = _arguments(spec, given if out is None else {**_of_folder(spec, out), **given})
        with _left(spec, asked, out, console):
            from ppmcal.commands.face import carry_out

            result = carry_out(spec, asked)
        if isinstance(result, Script):
            _run(result, console)
            return
        written = [] if out is None else result.save(out)
        if console.speaks:
            show(result, console)
        written += result.write(asked) if spec.files else []
        for part in result.finished(written, asked) if written else ():
            console.tell(part)
        console.summary({**result.summary(), **(result.summary_of(written) if written else {})})
        raise click.exceptions.Exit(result.exit_code)

    return console_options(as_run(body) if spec.files else body)


def _of_folder(spec: Command, out: Path) -> dict[str, Any]:
    """Return those of the arguments that say where results go, which Python has as arguments."""
    from ppmcal.store.inputs import current

    known = {"out": out, "force": current().force}
    return {one.name: known[one.name] for one in taken(spec.arguments)
            if one.option.only == PYTHON and one.name in known}


def _arguments(spec: Command, given: Mapping[str, Any]) -> Arguments:
    """Return what was asked for.

    Raises:
        click.UsageError: options do not go together, or a value of one cannot be read.
    """
    context, values = click.get_current_context(), dict(given)
    typed = {name for name in given if context.get_parameter_source(name)
             == click.core.ParameterSource.COMMANDLINE}
    for one in taken(spec.arguments):
        if one.option.reads is not None:
            try:
                values[one.name] = one.option.reads(values[one.name])
            except ValueError as error:
                raise click.UsageError(str(error)) from None
        elif values.get(one.name) in (None, ()) and not one.required:
            values.pop(one.name, None)    # the default of Python
    asked = spec.arguments(**values)
    if wrong := asked.misuse(typed):
        raise click.UsageError(wrong)
    return asked.completed()


@contextlib.contextmanager
def _left(spec: Command, asked: Arguments, out: Path | None, console: Console) -> Iterator[None]:
    """Show what the command leaves where it has no result."""
    try:
        yield
    except PpmcalError as error:
        from ppmcal.commands.face import refused

        found = refused(spec, error, asked, out)
        if found is not None:
            where = [f"Written to {out}: {', '.join(found.written)}"] if found.written else []
            for line in (*found.told, *where):
                console.say(line)
            if found.summary is not None:
                console.summary(found.summary)
        raise


def show(result: Any, console: Console) -> None:
    """Print what a person wants to know of a result, then what needs a look."""
    for part in result.told():
        console.tell(part)
    console.warn_rows(result.warnings, result.row_failures)


def _run(script: Script, console: Console) -> None:
    """Run the commands of a script in this process; findings (exit code 1) do not stop it."""
    from ppmcal.wording.progress import stage

    codes, replace = {}, click.get_current_context().params["force"]
    for number, step in enumerate(script.steps, 1):
        name, *words = step.words
        spec = command(name)
        if replace and spec.out:
            words.append(spec.replace)
        console.say(f"\n[{number}/{len(script.steps)}] {step.question}")
        console.say(f"$ ppmcal {' '.join([name, *words])}\n")
        with stage(name):
            code = built(name).main(args=words if console.speaks else [*words, "--quiet"],
                                    prog_name=f"ppmcal {name}", standalone_mode=False)
        codes[name] = code if isinstance(code, int) else 0
    console.say(f"\n{script.end}")
    console.summary({**script.summary, "exit_codes": codes})


def _asked(spec: Command, one: Taken) -> Any:
    """Return the argument or option of a field."""
    how, kind = one.option, _kind(one)
    more: dict[str, Any] = {}
    if how.complete:
        more["shell_complete"] = completed(how.complete)
    if how.argument:
        return click.argument(one.name, metavar=how.metavar or None, type=kind,
                              nargs=-1 if one.several else 1, required=one.required, **more)
    more["help"] = spec.said(how.text)
    if not one.required:
        python = None if one.value in ("", ()) else one.value
        more["default"] = python if how.typed is None else how.typed
    if one.kind == "bool":
        more["is_flag"] = True
    else:
        more |= {"type": kind, "metavar": how.metavar or None, "multiple": one.several,
                 "required": one.required}
    if how.shown:
        more["show_default"] = True
    if how.prints:
        more |= {"is_eager": True, "expose_value": False, "callback": _printed(how.prints)}
    return click.option(*(how.flags or flags(one)), one.name, **more)


def _printed(lines: Callable[[], Iterable[str]]) -> Callable[..., None]:
    """Return the callback of an option that prints lines and leaves."""
    def callback(context: click.Context, _: click.Parameter, given: bool) -> None:
        if given and not context.resilient_parsing:
            for line in lines():
                click.echo(line)
            context.exit()

    return callback


def _kind(one: Taken) -> Any:
    """Return the type of a value."""
    how = one.option
    if how.choices:
        return click.Choice(how.choices)
    bare = (how.folder and FOLDER) or KINDS[one.base]
    if how.least is None and how.most is None:
        return bare
    if bare is float:
        return FiniteRange(how.least, how.most, min_open=how.above)
    low, high = (None if end is None else int(end) for end in (how.least, how.most))
    return click.IntRange(low, high)


# ---- what the shell completes; files it completes by itself


def completed(place: str) -> Callable[[click.Context, click.Parameter, str], list[str]]:
    """Return what completes a word with names, none where a machine cannot be read.

    Args:
        place: ``module:name`` of the names, or of a function that returns them, of the machine
            that was named before where it takes one.
    """
    def complete(context: click.Context, _: click.Parameter, begun: str) -> list[str]:
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
