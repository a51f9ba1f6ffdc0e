"""What commands share: options, console, exit codes."""

from __future__ import annotations

import functools
import logging
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

from ppmcal.cli.display import aside, remarks, shortened, shown, wrapped
from ppmcal.errors import printable
from ppmcal.notes import FINDING, NOTE, level_of
from ppmcal.wording import MOST, collapse_similar
from ppmcal.wording.told import WIDTH, CommandLine, CopiedLines, Findings, ShortTable, Told

if TYPE_CHECKING:
    from rich.table import Table

F = TypeVar("F", bound=Callable[..., Any])
WORDS, LEAST = 7, 16
"""Columns of a table that words can do with, and that a name is left at least."""
FILE = click.Path(dir_okay=False, path_type=Path)
MODEL = click.Path(path_type=Path)
"""A mechanism file, or the folder of a result that holds one."""
FOLDER = click.Path(file_okay=False, path_type=Path)


class FiniteRange(click.FloatRange):
    """A range of floats without nan and inf."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None
                ) -> float:
        """Return the number, or fail."""
        number = float(super().convert(value, param, ctx))
        if not math.isfinite(number):
            self.fail(f"{value} is not a finite number.", param, ctx)
        return number


def examples(*lines: str) -> str:
    """Return the end of a command's help: lines to copy, which the tests run."""
    # \b keeps click from filling the lines
    return "\b\nExamples:\n" + "".join(f"  {line}\n" for line in lines)


def _with(options: Sequence[Callable[[F], F]], body: F) -> F:
    """Return the body of a command with options, in their order."""
    return functools.reduce(lambda one, option: option(one), reversed(options), body)


def console_options(function: F, data: bool = False) -> F:
    """Return the options ``--quiet``, ``--verbose`` and ``--json``.

    The command's body gets ``console``, unless it prints ``data`` and nothing else: then
    ``--verbose`` is the one option. While it runs, what the layers below it say of their work is
    shown on standard error.
    """
    @functools.wraps(function)
    def body(*, verbose: int, quiet: bool = False, as_json: bool = False, **options: Any) -> Any:
        if quiet and verbose:
            raise click.UsageError("--quiet and --verbose contradict each other: give one.")
        with _under_way(quiet, verbose):
            return function(**options) if data else function(
                console=Console(quiet, as_json), **options)

    quiet_option, verbose_option, json_option = (
        click.option("-q", "--quiet", is_flag=True, help="Print nothing but errors."),
        click.option("-v", "--verbose", count=True, help="Say on standard error what was read, "
                     "decided and how long it took; -vv: each iteration too."),
        click.option("--json", "as_json", is_flag=True,
                     help="Print the summary as one JSON object."))
    return _with([verbose_option] if data else [quiet_option, verbose_option, json_option],
                 cast(F, body))


@contextmanager
def _under_way(quiet: bool, verbose: int) -> Iterator[None]:
    """Show progress and remarks of the command that is about to run."""
    from ppmcal.commands import command

    context = click.get_current_context()
    with shown(command(context.command.name or "").shares, quiet), remarks(verbose):
        _say_defaults(context)
        yield


def _say_defaults(context: click.Context) -> None:
    """Log the options that were not given."""
    taken = [f"{option.opts[-1]} {value}" for option in context.command.params
             for value in [context.params.get(option.name or "")]
             if isinstance(option, click.Option) and value not in (None, False, (), 0)
             and context.get_parameter_source(option.name or "")
             == click.core.ParameterSource.DEFAULT]
    if taken:
        logging.getLogger("ppmcal.cli").info("defaults taken: %s", ", ".join(taken))


def _refuse_force(_: click.Context, __: click.Parameter, given: bool) -> None:
    """Refuse an option that was two (UsageError)."""
    if given:
        raise click.UsageError("--force is two options here: --overwrite replaces files, "
                               "--regardless lifts a refusal.")


def as_run(function: F, replace: str = "") -> F:
    """Run a command's body as one run of :mod:`ppmcal.store.folder`: what it reads stays.

    Args:
        function: the body.
        replace: the option to write into ``out`` where other files are, as ``force``  [default: it
            writes single files].
    """
    @functools.wraps(function)
    def body(**options: Any) -> Any:
        from ppmcal.store.folder import running

        name = click.get_current_context().command.name or ""
        folder, force = ((options["out"], options.pop("force")) if replace else
                         (None, bool(options.get("force"))))
        with running(name, folder, force, option=replace or "--force"):
            return function(**options)

    return cast(F, body)


def out_option(default: str, replace: str) -> Callable[[F], F]:
    """Return the options ``--out``, with a default folder, and ``replace``, of one run."""
    options = [
        click.option("--out", type=FOLDER, default=default, show_default=True,
                     help="Folder for the results."),
        click.option(*dict.fromkeys((replace, "--overwrite")), "force", is_flag=True,
                     help="Write even where files are that this command did not write, or "
                     "that were edited since; inputs are never replaced.")]
    if replace != "--force":
        options.append(click.option(
            "--force", "was_two", is_flag=True, hidden=True, expose_value=False,
            callback=_refuse_force, help="--overwrite, or --regardless."))
    return lambda function: _with(options, as_run(function, replace))


class Console:
    """Prints for people on standard output, and JSON on demand."""

    def __init__(self, quiet: bool, as_json: bool) -> None:
        """Remember how to print."""
        self.quiet, self.as_json = quiet, as_json

    @property
    def speaks(self) -> bool:
        """Whether text for people is wanted."""
        return not self.quiet and not self.as_json

    def say(self, text: str = "") -> None:
        """Print one paragraph, wrapped at 80 columns; no name of a file is broken."""
        if self.speaks:
            with aside():
                click.echo(wrapped(_told(text), map(_told, sys.argv)))

    def say_lines(self, lines: Sequence[str]) -> None:
        """Print lines to be copied, none of them broken: half a line is another one."""
        if self.speaks:
            with aside():
                for line in lines:
                    click.echo(f"    {_told(line)}".rstrip())

    def say_command(self, head: str, words: Sequence[object]) -> None:
        """Print a command to be copied: longer than a line, it goes on behind a backslash."""
        lines = [head]
        for word in (shlex.quote(str(w)) for w in words):
            if len(lines[-1]) + len(word) > WIDTH - 3:
                lines[-1] += " \\"
                lines.append("   ")
            lines[-1] += f" {word}"
        self.say("\n".join(lines))

    def tell(self, part: Told) -> None:
        """Print a part of what a result says."""
        if isinstance(part, ShortTable):
            self.table(plain_table(part.heads, part.rows, part.right))
        elif isinstance(part, Findings):
            self.warn(part.sentences)
        elif isinstance(part, CommandLine):
            self.say_command(part.head, part.words)
        elif isinstance(part, CopiedLines):
            self.say_lines(part.lines)
        else:
            self.say(part)

    def warn(self, findings: Sequence[str]) -> None:
        """Print what the user must look at, then what is good to know, each fact once."""
        for level, mark in ((FINDING, "! "), (NOTE, "")):
            own = [f for f in findings if level_of(f) == level]
            for finding in collapse_similar(own, "all with --json"):
                self.say(f"{mark}{finding}")

    def warn_rows(self, findings: Sequence[str], rows: Sequence[str]) -> None:
        """Print findings, then what is wrong with rows: each reason once, of many three."""
        self.warn(findings)
        lines = collapse_similar(rows, "see status and reason")
        more = len(lines) - MOST
        for line in [f"{len(rows)} rows: {'; '.join(lines[:MOST])}; and {more} more, see status "
                     "and reason"] if more > 0 else lines:
            self.say(f"! {line}")

    def table(self, table: Table) -> None:
        """Print a table."""
        if self.speaks:
            with aside():
                self.rich.print(table)

    @functools.cached_property
    def rich(self) -> Any:
        """The rich console, at most 80 columns wide."""
        from rich.console import Console as Rich

        # names may have brackets and colons, which are not mark-up
        return Rich(width=WIDTH, soft_wrap=False, markup=False, emoji=False)

    def summary(self, content: Mapping[str, Any]) -> None:
        """Print the summary where ``--json`` asks for it."""
        if self.as_json:
            from ppmcal.plain import json_text

            with aside():
                # what UTF-8 cannot hold, as JSON has it
                text = json_text(content).encode("utf-8", "backslashreplace").decode()
                click.echo(text, nl=False)


def _told(text: str) -> str:
    """Return text as standard output can have it; bytes of a file's name stay where they can."""
    return printable(text, raw=getattr(sys.stdout, "errors", "") == "surrogateescape")


def plain_table(headings: Sequence[str], rows: Sequence[Sequence[str]],
                right: Sequence[int] = ()) -> Table:
    """Return a plain table of 80 columns; the columns ``right`` are numbers, right-aligned.

    Names, in the first column, are cut in the middle where they are too long, and words wrap;
    numbers stay whole.
    """
    rows = [[_told(cell) for cell in row] for row in rows]
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="")
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(len(headings))]
    words = [max((len(w) for text in (heading, *(row[i] for row in rows if i not in right))
                  for w in text.split()), default=0) for i, heading in enumerate(headings)]
    taken = sum(max(width if i in right else min(width, WORDS), word)
                for i, (width, word) in enumerate(zip(widths, words, strict=True)) if i)
    first = max(WIDTH + 1 - 3 * len(headings) - taken, LEAST)
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if i in right else "left", overflow="fold",
                         no_wrap=i == 0,
                         min_width=max(widths[i], words[i]) if i in right else None)
    for name, *rest in rows:
        table.add_row(shortened(name, first), *rest)
    return table
