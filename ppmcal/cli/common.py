"""What commands share: options, console, exit codes."""

from __future__ import annotations

import functools
import math
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, cast

import click

if TYPE_CHECKING:
    from rich.table import Table

    from ppmcal.model.mechanism import Mechanism

F = TypeVar("F", bound=Callable[..., Any])
WIDTH = 80
FILE = click.Path(dir_okay=False, path_type=Path)
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


quiet_option = click.option("--quiet", is_flag=True, help="Print nothing but errors.")
json_option = click.option("--json", "as_json", is_flag=True,
                           help="Print the summary as one JSON object.")
seed_option = click.option("--seed", type=click.IntRange(min=0), default=None,
                           help="Seed of everything drawn at random.")
force_option = click.option("--force", is_flag=True,
                            help="Write even where files are that this command did not write, or "
                            "that were edited since; inputs are never replaced.")


def out_option(default: str) -> Callable[[F], F]:
    """Return the options ``--out``, with a default folder, and ``--force``.

    The command's body runs as one run of :mod:`ppmcal.io.folder`: what it reads is never
    replaced, and what it did not write only with ``--force``.
    """
    def decorate(function: F) -> F:
        @functools.wraps(function)
        def body(*args: Any, out: Path, force: bool, **options: Any) -> Any:
            from ppmcal.io.folder import running

            name = click.get_current_context().command.name or ""
            with running(name, out, force):
                return function(*args, out=out, **options)

        return folder(force_option(cast(F, body)))

    folder = click.option("--out", type=FOLDER, default=default, show_default=True,
                          help="Folder for the results.")
    return decorate


class Console:
    """Prints for people on standard output, progress on standard error, JSON on demand."""

    def __init__(self, quiet: bool, as_json: bool) -> None:
        """Remember how to print."""
        self.quiet, self.as_json = quiet, as_json
        self._rich: Any = None

    @property
    def speaks(self) -> bool:
        """Whether text for people is wanted."""
        return not self.quiet and not self.as_json

    def say(self, text: str = "") -> None:
        """Print one paragraph, wrapped at 80 columns."""
        if self.speaks:
            self.rich.print(text, markup=False, highlight=False)

    def say_command(self, head: str, words: Sequence[object]) -> None:
        """Print a command to be copied: longer than a line, it goes on behind a backslash."""
        lines = [head]
        for word in (shlex.quote(str(w)) for w in words):
            if len(lines[-1]) + len(word) > WIDTH - 3:
                lines[-1] += " \\"
                lines.append("   ")
            lines[-1] += f" {word}"
        self.say("\n".join(lines))

    def warn(self, findings: Sequence[str]) -> None:
        """Print what the user must look at."""
        for finding in findings:
            self.say(f"! {finding}")

    def warn_rows(self, findings: Sequence[str], rows: Sequence[str]) -> None:
        """Print findings, then what is wrong with rows, the first ten of them."""
        self.warn([*findings, *rows[:10]])
        if len(rows) > 10:
            self.say(f"... and {len(rows) - 10} more rows, see status and reason.")

    def table(self, table: Table) -> None:
        """Print a table."""
        if self.speaks:
            self.rich.print(table)

    @property
    def rich(self) -> Any:
        """The rich console, at most 80 columns wide."""
        if self._rich is None:
            from rich.console import Console as Rich

            self._rich = Rich(width=WIDTH, soft_wrap=False)
        return self._rich

    def summary(self, content: Mapping[str, Any]) -> None:
        """Print the summary where ``--json`` asks for it."""
        if self.as_json:
            from ppmcal.io import json_text

            click.echo(json_text(content), nl=False)

    @contextmanager
    def progress(self, what: str) -> Iterator[Callable[[str], None]]:
        """Show a line of progress on standard error while something long runs."""
        if self.quiet or not sys.stderr.isatty():
            yield lambda text: None
            return
        from rich.console import Console as Rich

        with Rich(stderr=True, width=80).status(what) as status:
            yield lambda text: status.update(f"{what}: {text}")


def plain_table(headings: Sequence[str], rows: Sequence[Sequence[str]],
                right: Sequence[int] = ()) -> Table:
    """Return a plain table; the columns ``right`` are right-aligned."""
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="right" if i in right else "left",
                         overflow="fold", no_wrap=i == 0)
    for row in rows:
        table.add_row(*row)
    return table


def number(value: float | None, digits: int = 4) -> str:
    """Return a number for people, ``-`` for none."""
    return "-" if value is None else f"{value:.{digits}g}"


def effects_words(mechanism: Mechanism) -> list[str]:
    """Return that an analysis of geometry leaves the file's effects out, if it has any."""
    kinds = ", ".join(dict.fromkeys(e.kind.name for e in mechanism.effects))
    return [f"Geometry only: the file's effects ({kinds}) are left out."] if kinds else []


def input_columns(path: Path) -> tuple[tuple[str, ...], list[Any]]:
    """Return header and columns of a table as it stands, to be repeated in the output."""
    from ppmcal.io import read_table

    raw = read_table(path, loose=lambda _: True)
    return raw.header, [raw.numbers.get(h, raw.text.get(h)) for h in raw.header]


def command_line() -> str:
    """Return the command as it was typed, for provenance."""
    return "ppmcal " + shlex.join(sys.argv[1:])


def finish(out: Path, names: Sequence[str], console: Console) -> None:
    """Say where the results are."""
    console.say(f"Written to {out}: {', '.join(names)}")


def leave(findings: bool) -> None:
    """Exit with 1 where the user must look at something."""
    if findings:
        raise click.exceptions.Exit(1)


if TYPE_CHECKING:
    from ppmcal.model.dataset import Dataset
    from ppmcal.model.mechanism import Mechanism


def load(mech: Path, data: tuple[Path, ...], patterns: tuple[str, ...]
         ) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Read machine and data; ``patterns`` replace the file's choice of free parameters."""
    import numpy as np

    from ppmcal.errors import unknown
    from ppmcal.io import read_mechanism
    from ppmcal.kinematics.effect_response import with_strokes
    from ppmcal.model.parameters import unmatched

    mechanism = read_mechanism(mech)
    if patterns == ("none",):
        mechanism = mechanism.with_free([])
    elif patterns:
        for pattern in unmatched(mechanism.parameters, patterns):
            raise unknown("parameter", pattern, mechanism.names, "--free")
        mechanism = mechanism.with_free(patterns)
    datasets = readable(mechanism, data)
    if mechanism.effects and datasets:
        mechanism = with_strokes(mechanism, np.concatenate([d.q for d in datasets]))
        for d in datasets:
            _recorded(mechanism, d)
    return mechanism, datasets


def _recorded(mechanism: Mechanism, data: Dataset) -> None:
    """Refuse data without a column that the machine's effects depend on."""
    from ppmcal.errors import BadInput
    from ppmcal.kinematics.effect_response import environment_of, missing_columns

    missing = missing_columns(mechanism, environment_of(mechanism, data))
    if missing:
        raise BadInput(f"the effects of {mechanism.source} depend on {', '.join(missing)}, which "
                       "is not there", f"{data.source}: header",
                       f"Add the column {missing[0]}, or take the effect out")


def readable(mechanism: Mechanism, paths: Sequence[Path]) -> tuple[Dataset, ...]:
    """Read measurements, with joints."""
    from ppmcal.io import read_campaign
    from ppmcal.kinematics.tables import with_joints

    datasets = read_campaign(list(paths), mechanism)
    return tuple(with_joints(mechanism, d) for d in datasets)


@contextmanager
def unit_findings_told(mechanism: Mechanism, datasets: Sequence[Dataset]) -> Iterator[list[str]]:
    """Yield what `check` says of units and limits; a fit that fails inside says it too."""
    from ppmcal.errors import PpmcalError
    from ppmcal.io import unit_findings

    found = unit_findings(mechanism, datasets)
    try:
        yield found
    except PpmcalError as error:
        mend = " ".join([*found, error.mend]).strip()
        raise type(error)(error.what, error.where, mend) from None


def started(mechanism: Mechanism, start: Path) -> tuple[Mechanism, list[str]]:
    """Return the machine with the free values of an earlier calibration, and what was odd."""
    from ppmcal.io import read_mechanism

    other = read_mechanism(start)
    notes = same_machine(mechanism, other, start)
    found = dict(zip(other.names, other.values.tolist(), strict=True))
    g = mechanism.values.copy()
    for p in mechanism.free:
        g[p] = found.get(mechanism.names[p], g[p])
    return mechanism.with_values(g), notes


def same_machine(mechanism: Mechanism, other: Mechanism, source: Path) -> list[str]:
    """Return which fixed values differ between a machine and an earlier file of it.

    Raises:
        BadInput: the limbs are not the same.
    """
    from ppmcal.errors import BadInput

    kinds = [{limb.name: limb.kind.name for limb in m.limbs} for m in (mechanism, other)]
    if kinds[0] != kinds[1]:
        raise BadInput("is of another machine: its limbs are not those of "
                       f"{mechanism.source}", str(source),
                       "Give the identified.yaml of an earlier calibration of this machine")
    found = dict(zip(other.names, other.values.tolist(), strict=True))
    free = {mechanism.names[p] for p in mechanism.free}
    apart = [name for i, name in enumerate(mechanism.names)
             if name not in free and found.get(name, mechanism.values[i]) != mechanism.values[i]]
    if not apart:
        return []
    return [f"{len(apart)} fixed value{'s' if len(apart) > 1 else ''} are not as in {source}: "
            f"{', '.join(apart[:3])}{' ...' if len(apart) > 3 else ''}"]
