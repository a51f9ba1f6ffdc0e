"""What a command takes: one class of arguments, from which every way to call it is made.

No NumPy here, nor in a module that declares a command: ``--help`` needs them.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

Path_ = str | os.PathLike[str]
Machine = Any
"""A mechanism, the path of its file or of a folder that has one, or what such a file holds."""
Table = Any
"""A table: the path of its file, a data frame, or a mapping of columns."""


@dataclass(frozen=True)
class Option:
    """How a field of a class of arguments is asked for.

    Attributes:
        help: what it is, as the command line and the docs of the Python face say it.
        flags: on the command line, where they are not ``--name``; empty for an argument.
        metavar: what stands for its value there.
        otherwise: what is taken where nothing is given, in words.
        choices: what it may be.
        least, most: ends of a range of whole numbers, None where it has none.
        shown: whether the command line says the default.
        complete: what the shell completes it with.
        argument: whether it is an argument, and not an option; ``words``: what Python's docs call
            it, where the command line has its metavar.
        folder: whether a path is of a folder.
        common: whether other commands have it too, so that it stands behind those of its own.
    """

    help: str
    flags: tuple[str, ...] = ()
    metavar: str = ""
    otherwise: str = ""
    choices: tuple[str, ...] = ()
    least: int | None = None
    most: int | None = None
    shown: bool = False
    complete: str = ""
    argument: bool = False
    words: str = ""
    folder: bool = False
    common: bool = False

    @property
    def text(self) -> str:
        """What it is, with what is taken where nothing is given."""
        return f"{self.help}  [default: {self.otherwise}]." if self.otherwise else self.help


def option(default: Any, help: str, *flags: str, **more: Any) -> Any:
    """Return a field of a class of arguments, ``default`` where nothing is given."""
    return field(default=default, metadata={"option": Option(help, flags, **more)})


def argument(metavar: str, help: str, **more: Any) -> Any:
    """Return a field that is an argument of the command."""
    return field(metadata={"option": Option(help, metavar=metavar, argument=True, **more)})


def mechanism() -> Any:
    """Return the argument ``mechanism``."""
    return argument("MECH", "The machine, or its file.", words="a machine")


def seed() -> Any:
    """Return the field ``seed``."""
    return option(0, "Seed of everything drawn at random.", least=0, common=True)


def cores() -> Any:
    """Return the field ``cores`` of work that processes share."""
    return option(None, "Processes to run in", otherwise="all processors", least=1, common=True)


def scheduler() -> Any:
    """Return the field ``scheduler`` of work that processes share."""
    return option(None, "Run on the cluster of this dask scheduler, such as tcp://10.0.0.5:8786.",
                  "--scheduler", "--dask", metavar="ADDRESS", common=True)


class Arguments:
    """What a command takes: its subclasses are frozen dataclasses of these fields."""


@dataclass(frozen=True)
class Taken:
    """One field of a class of arguments: name, annotation as it is written, default, and how."""

    name: str
    kind: str
    value: Any
    option: Option

    @property
    def required(self) -> bool:
        """Whether it has to be given."""
        return self.value is dataclasses.MISSING

    @property
    def several(self) -> bool:
        """Whether it may be given several times."""
        return self.kind.startswith(("Sequence[", "tuple["))

    @property
    def base(self) -> str:
        """The kind of one value of it on the command line."""
        inner = re.sub(r"^(?:Sequence|tuple)\[(.*?)(?:, \.\.\.)?\]$", r"\1",
                       self.kind.removesuffix(" | None"))
        return inner.partition(" | ")[0]


def taken(arguments: type[Arguments]) -> Iterator[Taken]:
    """Yield the fields of a class of arguments."""
    for f in dataclasses.fields(arguments):  # type: ignore[arg-type]
        yield Taken(f.name, str(f.type), f.default, f.metadata["option"])


@dataclass(frozen=True)
class Command:
    """A command: its arguments, how its help tells it, and where its work is done.

    Attributes:
        name: on the command line, and of the Python function.
        arguments: the class of what it takes.
        about: the paragraphs of its help; ``{mechanism}`` stands for that argument.
        examples: lines to copy, which the tests run.
        result: the class of what it returns, in its module ``run``.
        raises: of the Python function.
        out: the folder that results go to by default, empty where it writes none; ``replace``: the
            option to write where other files are.
        recorded: whether results hold the arguments, so that ``verify`` can make them again.
        shares: of the time that each stage takes: CPU seconds of a run that is long enough to show
            a time left; only their proportions count.
    """

    name: str
    arguments: type[Arguments]
    about: tuple[str, ...]
    examples: tuple[str, ...]
    result: str
    raises: str = "BadInput: anything wrong in the files or options."
    out: str = ""
    replace: str = "--force"
    recorded: bool = True
    shares: Mapping[str, float] = field(default_factory=dict)

    @property
    def run(self) -> str:
        """``module:function`` that takes the arguments and returns the result."""
        return f"ppmcal.commands.{self.name}.run:run"

    def help(self, python: bool = False) -> list[str]:
        """Return the paragraphs of its help with the arguments' names, in Python in words."""
        called = {one.name: _words(one.option, python) for one in taken(self.arguments)
                  if one.option.argument}
        return [part.format(**called) for part in self.about]


def _words(how: Option, python: bool) -> str:
    return how.words if python and how.words else how.metavar.removesuffix("...")
