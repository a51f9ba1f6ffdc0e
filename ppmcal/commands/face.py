"""The Python functions of a command, from what the command says that it takes."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import cache
from numbers import Integral
from pathlib import Path
from typing import Any

from ppmcal.commands import command, folder, functions, names, work
from ppmcal.commands.spec import CONSOLE, Arguments, Command, Face, Refusal, Taken, taken
from ppmcal.errors import BadInput, PpmcalError
from ppmcal.plain import LARGEST_WHOLE
from ppmcal.store.provenance import as_json, recording
from ppmcal.wording.progress import no_progress, reports_progress

WIDTH = 99
PROGRESS = inspect.Parameter("progress", inspect.Parameter.KEYWORD_ONLY, default=no_progress,
                             annotation="Progress")


@reports_progress
def carry_out(spec: Command, asked: Arguments, *, progress: Any = no_progress) -> Any:
    """Do the work of a command, and return its result, which holds the arguments.

    Raises:
        BadInput, NoResult: as the command says.
    """
    run = work(spec.name).run
    if not spec.recorded:
        return run(asked)
    options, unused = {}, asked.unused()
    for one in taken(spec.arguments, CONSOLE):
        value = getattr(asked, one.name)
        if one.name == "seed":
            _refuse_seed(value)
        _refuse_words(one.name, one.kind, value)
        if one.option.recorded and one.name not in unused:
            options[one.name] = as_json(value, one.value)
    with recording(recorded_as(spec), options):
        return run(asked)


def _refuse_seed(seed: object) -> None:
    """Refuse what is not a seed, or one that its own record could not hold.

    Raises:
        BadInput: not a whole number from 0 to 2^53.
    """
    if seed is None or (isinstance(seed, Integral) and not isinstance(seed, bool)
                        and 0 <= int(seed) <= LARGEST_WHOLE):
        return
    raise BadInput(f"{str(seed)[:40]} is not a seed", "--seed",
                   f"Give a whole number from 0 to {LARGEST_WHOLE}")


def _refuse_words(name: str, kind: str, value: Any) -> None:
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


def recorded_as(spec: Command) -> str:
    """Return what a result calls the function that it is from."""
    return f"{folder(spec.name)}.{spec.function}"


def recorded(name: str) -> Command | None:
    """Return the command that a result was made by, None where there is no such one."""
    for one in names():
        if folder(one) == name.partition(".")[0]:
            spec = command(one)
            return spec if spec.recorded and recorded_as(spec) == name else None
    return None


def refused(spec: Command, error: PpmcalError, asked: Arguments, out: Path | None
            ) -> Refusal | None:
    """Return what a command leaves in its folder where it has no result, None for nothing."""
    left = getattr(work(spec.name), "when_refused", None)
    found: Refusal | None = None if left is None else left(error, asked, out)
    return found


@cache
def function(name: str) -> Callable[..., Any]:
    """Return a function: it takes what the command takes, and ``progress``."""
    one, face = functions()[name]
    spec = command(one)
    names_of = {taken_as: known for known, (taken_as, _) in face.called.items()}

    def call(*args: Any, **given: Any) -> Any:
        bound = signature.bind(*args, **given).arguments
        progress = bound.pop("progress", no_progress)
        asked = spec.arguments(**face.given, **{names_of.get(k, k): v for k, v in bound.items()})
        return carry_out(spec, asked, progress=progress)

    signature = inspect.Signature(    # arguments, options by name, progress
        [*(_parameter(one, face) for one in _taken(spec, face)), PROGRESS],
        return_annotation=spec.result)
    call.__name__ = call.__qualname__ = name
    call.__module__ = "ppmcal"    # where processes find it
    call.__doc__ = document(spec, face)
    call.__signature__ = signature  # type: ignore[attr-defined]
    return call


def result_of(name: str) -> type | None:
    """Return the class of what a function returns, None where that is plain data."""
    one, _ = functions()[name]
    found: type | None = getattr(work(one), command(one).result, None)
    return found


def _taken(spec: Command, face: Face) -> Iterator[Taken]:
    for one in taken(spec.arguments, CONSOLE):
        if one.name not in (*face.given, *face.left_out):
            yield one


def _parameter(one: Taken, face: Face) -> inspect.Parameter:
    how, name = inspect.Parameter, face.called.get(one.name, (one.name,))[0]
    if one.option.argument and one.kind.startswith("tuple["):
        return how(name, how.VAR_POSITIONAL, annotation=one.base)
    by_name = not (one.option.argument or one.required)
    return how(name, how.KEYWORD_ONLY if by_name else how.POSITIONAL_OR_KEYWORD,
               annotation=one.kind, default=how.empty if one.required else one.value)


def document(spec: Command, face: Face) -> str:
    """Return the docstring of a function."""
    first, *others = face.about or spec.paragraphs
    parts = [spec.in_python(first, "a "), *map(spec.in_python, others)]
    about = "\n\n".join(map(_filled, parts))
    raised = re.split(r" (?=NoResult: )", face.raises or spec.raises)
    raises = "\n".join(_filled(one, "    ") for one in raised)
    return f"{about}\n\nArgs:\n{''.join(_lines(spec, face))}\nRaises:\n{raises}\n"


def _lines(spec: Command, face: Face) -> Iterator[str]:
    for one in _taken(spec, face):
        name, text = face.called.get(one.name, (one.name, one.option.text))
        yield _filled(f"{name}: {spec.in_python(text)}", "    ") + "\n"
    yield "    progress: called with a line of text now and then.\n"


def _filled(text: str, indent: str = "") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=indent,
                         subsequent_indent=indent + "    " * bool(indent),
                         break_on_hyphens=False)
