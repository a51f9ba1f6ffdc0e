"""What a command takes: one class of arguments, from which every way to call it is made.

No NumPy here, nor in a module that declares a command: ``--help`` needs them.
"""

from __future__ import annotations

import dataclasses
import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Self

Path_ = str | os.PathLike[str]
Machine = Any
"""A mechanism, the path of its file or of a folder that has one, or what such a file holds."""
CalibratedMachine = Any
"""What identify or diagnose returned; see :mod:`ppmcal.commands.result`."""
Measurements = Any
"""Data sets, paths of their files, or a mixture."""
Table = Any
"""A table: the path of its file, a data frame, or a mapping of columns."""
CONSOLE, PYTHON = "the command line", "Python"
"""Where a field may be asked for alone."""


@dataclass(frozen=True)
class Option:
    """How a field of a class of arguments is asked for.

    Attributes:
        help: what it is, as the command line and the docs of the Python face say it; or a
            function that returns it, where other packages have a say.
        flags: on the command line, where they are not ``--name``; empty for an argument.
        metavar: what stands for its value there.
        otherwise: what is taken where nothing is given, in words.
        choices: what it may be.
        least, most: ends of a range of numbers, None where it has none; ``above``: the least
            value itself is out.
        shown: whether the command line says the default.
        complete: ``module:name`` of what the shell completes it with; see
            :func:`ppmcal.cli.built.completed`.
        argument: whether it is an argument, and not an option; ``words``: what it is called in
            Python's docs and in refusals, without an article, where that is not its name.
        key: what it is as a key of a file, where that is said in other words.
        folder: whether a path is of a folder.
        common: whether other commands have it too, so that it stands behind those of its own.
        only: :data:`CONSOLE` or :data:`PYTHON`, where it is asked for there alone.
        kind: of one value on the command line, where the annotation is wider; ``several``: whether
            it may be given several times there, where the annotation does not say it.
        typed: default on the command line, where it is another one.
        reads: makes the value of the words of the command line; ValueError: what is wrong.
        prints: returns the lines that are all that the command prints where this option is given.
        recorded: whether it decides what is found, and not how long it takes or what is replaced.
    """

    help: str | Callable[[], str]
    flags: tuple[str, ...] = ()
    metavar: str = ""
    otherwise: str = ""
    choices: tuple[str, ...] = ()
    least: float | None = None
    most: float | None = None
    above: bool = False
    shown: bool = False
    complete: str = ""
    argument: bool = False
    words: str = ""
    key: str = ""
    folder: bool = False
    common: bool = False
    only: str = ""
    kind: str = ""
    several: bool | None = None
    typed: Any = None
    reads: Callable[[Sequence[str]], Any] | None = None
    prints: Callable[[], Iterator[str]] | None = None
    recorded: bool = True

    @property
    def text(self) -> str:
        """What it is, with what is taken where nothing is given."""
        said = self.help() if callable(self.help) else self.help
        return f"{said}  [default: {self.otherwise}]." if self.otherwise else said


def option(default: Any, help: str | Callable[[], str], *flags: str, **more: Any) -> Any:
    """Return a field of a class of arguments, ``default`` where nothing is given."""
    return field(default=default, metadata={"option": Option(help, flags, **more)})


def needed(help: str, *flags: str, **more: Any) -> Any:
    """Return a field that has to be given, as an option of the command line."""
    return field(metadata={"option": Option(help, flags, **more)})


def argument(metavar: str, help: str | Callable[[], str], default: Any = dataclasses.MISSING,
             **more: Any) -> Any:
    """Return a field that is an argument of the command."""
    return field(default=default,
                 metadata={"option": Option(help, metavar=metavar, argument=True, **more)})


def mechanism() -> Any:
    """Return the argument ``mechanism``."""
    return argument("MECH", "The machine, or its file.", words="machine")


def measurements(default: Any = dataclasses.MISSING) -> Any:
    """Return the argument ``data``."""
    required = default is dataclasses.MISSING
    return argument("DATA..." if required else "[DATA]...",
                    "Data sets, or paths of measurement files.", default, several=True)


PARAMETERS = "ppmcal.commands.inputs:parameters_of"
EFFECTS = "ppmcal.model.effects:effect_kinds"
"""What names of parameters and of effects are completed with."""


def seed(default: int | None = 0) -> Any:
    """Return the field ``seed``."""
    return option(default, "Seed of everything drawn at random.", least=0, common=True,
                  key="Of everything drawn at random.")


def cores() -> Any:
    """Return the field ``cores`` of work that processes share."""
    return option(None, "Processes to run in", otherwise="all processors", least=1, common=True,
                  recorded=False)


def scheduler() -> Any:
    """Return the field ``scheduler`` of work that processes share."""
    return option(None, "Run on the cluster of this dask scheduler, such as tcp://10.0.0.5:8786.",
                  "--scheduler", "--dask", metavar="ADDRESS", common=True, recorded=False)


def tool(otherwise: str = "the platform's origin") -> Any:
    """Return the field ``tool``."""
    return option(None, "Tool point in platform axes", metavar="X,Y,Z", otherwise=otherwise)


def grid() -> Any:
    """Return the field ``grid``."""
    return option(None, "Coordinates of the map with range and levels, such as x=-300:300:41,y",
                  metavar="NAME[=LOW:HIGH[:COUNT]],...",
                  otherwise="the first two, as far as home can go")


def metric() -> Any:
    """Return the field ``metric``."""
    return option(None, "An angle of sigma/LENGTH counts like a length of sigma", metavar="LENGTH",
                  otherwise="the platform joints' rms distance")


def regardless(lifted: str, key: str = "") -> Any:
    """Return the field ``regardless``, which lifts the refusals ``lifted`` and no other."""
    return option(False, f"Lift the refusal of {lifted}, and no other; ends with exit code 1 where "
                  "there was one.", key=key)


def leave_out() -> Any:
    """Return the field ``leave_out``, which goes with :func:`two_holdouts`."""
    return option("", "Predict each session (label of a column `session`, or files of one "
                  "campaign) by the others, in place of held-out poses.", choices=("session",),
                  words="part to leave out", key="Predict each session by the others.")


def two_holdouts(chosen: str, typed: Collection[str]) -> str:
    """Return why --holdout does not go beside --leave-out, which takes its place."""
    return ("--leave-out session takes the place of --holdout: give one."
            if chosen and "holdout" in typed else "")


class Arguments:
    """What a command takes: its subclasses are frozen dataclasses of these fields."""

    def misuse(self, typed: Collection[str]) -> str:
        """Return why options do not go together, ``typed`` being those given; empty if they do.

        Of the command line alone, which knows what was given and what is a default.
        """
        return ""

    def unused(self) -> Collection[str]:
        """Return the names of options that decide nothing here, and are not recorded."""
        return ()

    def completed(self) -> Self:
        """Return the arguments of a command line with what follows from them for others."""
        return self


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
        if self.option.several is not None:
            return self.option.several
        return self.value == () or self.kind.startswith(("Sequence[", "tuple["))

    @property
    def base(self) -> str:
        """The kind of one value of it on the command line."""
        if self.option.kind:
            return self.option.kind
        inner = re.match(r"(?:Sequence|tuple)\[(\w+)", self.kind)
        return inner[1] if inner else self.kind.partition(" | ")[0]


def taken(arguments: type[Arguments], without: str = "") -> Iterator[Taken]:
    """Yield the fields of a class of arguments, but for those of ``without`` alone."""
    for f in dataclasses.fields(arguments):  # type: ignore[arg-type]
        if not without or f.metadata["option"].only != without:
            yield Taken(f.name, str(f.type), f.default, f.metadata["option"])


@dataclass(frozen=True)
class Face:
    """A Python function: the command, or the command with some arguments given.

    Attributes:
        name: of the function.
        about: the paragraphs of its docstring, where they are not those of the command.
        given: arguments that it does not take, and their values.
        called: argument -> name and docs of it in this function, where they are others.
        left_out: options that it does not take.
        raises: where it is not as of the command.
    """

    name: str
    about: tuple[str, ...] = ()
    given: Mapping[str, Any] = field(default_factory=dict)
    called: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    raises: str = ""


@dataclass(frozen=True)
class Command:
    """A command: its arguments, how its help tells it, and where its work is done.

    Attributes:
        name: on the command line.
        arguments: the class of what it takes.
        about: the paragraphs of its help, or functions that return them; ``{mechanism}`` stands
            for that argument.
        examples: lines to copy, which the tests run.
        result: the class of what it returns, in its module ``run``; empty where no function of
            Python is the command.
        record: what ``ppmcal schema`` calls the JSON file that it writes, and the record that is
            in it, as ``module:class``.
        python: the name of that function, where it is another one; it is recorded.
        faces: Python functions that it has  [default: the one].
        raises: of the Python function.
        out: the folder that results go to by default, empty where it writes none; ``replace``: the
            option to write where other files are.
        files: whether it writes single files among the user's own, as its arguments say.
        data: whether it prints what it returns as JSON, and nothing else.
        script: whether it runs other commands, one after the other.
        recorded: whether results hold the arguments, so that ``verify`` can make them again.
        shares: of the time that each stage takes: CPU seconds of a run that is long enough to show
            a time left; only their proportions count.
    """

    name: str
    arguments: type[Arguments]
    about: tuple[str | Callable[[], str], ...]
    examples: tuple[str, ...]
    result: str = ""
    record: tuple[str, str] | tuple[()] = ()
    python: str = ""
    faces: tuple[Face, ...] = ()
    raises: str = "BadInput: anything wrong in the files or options."
    out: str = ""
    replace: str = "--force"
    files: bool = False
    data: bool = False
    script: bool = False
    recorded: bool = True
    shares: Mapping[str, float] = field(default_factory=dict)

    @property
    def paragraphs(self) -> list[str]:
        """The paragraphs of its help."""
        return [one() if callable(one) else one for one in self.about]

    @property
    def function(self) -> str:
        """The name of its function, which is recorded."""
        return self.python or self.name

    @property
    def functions(self) -> tuple[Face, ...]:
        """The functions of the Python face."""
        return self.faces or ((Face(self.function),) if self.result else ())

    def said(self, text: str) -> str:
        """Return a text of the help with the arguments as the command line calls them."""
        for one in taken(self.arguments):
            if one.option.argument:
                text = text.replace(f"{{{one.name}}}", one.option.metavar.strip("[]."))
        return text

    def in_python(self, text: str, article: str = "the ") -> str:
        """Return a text of the help with arguments in words and options by their names."""
        for one in taken(self.arguments):
            for flag in flags(one):
                text = re.sub(rf"(?<![\w-]){flag}(?![\w-])", f"``{one.name}``", text)
            words = f"{article}{one.option.words}" if one.option.words else f"``{one.name}``"
            if one.option.argument:
                text = text.replace(f"{{{one.name}}}", words)
        return text


def flags(one: Taken) -> tuple[str, ...]:
    """Return what an option is called on the command line."""
    own = one.option.flags or ("--" + one.name.replace("_", "-"),)
    return tuple(word for flag in own for word in flag.split("/"))


@dataclass(frozen=True)
class Refusal:
    """What a command leaves where it has no result.

    Attributes:
        summary: what ``--json`` prints, None for nothing.
        written: names of files in its folder.
        told: what it says besides.
    """

    summary: Mapping[str, Any] | None = None
    written: tuple[str, ...] = ()
    told: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """A command line that a script runs, and what it answers."""

    question: str
    words: tuple[str, ...]


@dataclass(frozen=True)
class Script:
    """Command lines that are run one after the other.

    Attributes:
        steps: in their order.
        end: said at the end.
        summary: what ``--json`` prints, besides the exit codes.
    """

    steps: tuple[Step, ...]
    end: str
    summary: Mapping[str, Any]
