"""A mechanism file to start from, with its scenario beside it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.init.options import InitArguments
from ppmcal.errors import BadInput
from ppmcal.io.templates import find_template, for_editors, templates
from ppmcal.store.output import Output
from ppmcal.wording.told import WIDTH, CommandLine, ShortTable, Told


@dataclass(frozen=True)
class Template:
    """A file to start from, or all that there are.

    Attributes:
        source: the mechanism file that comes with the program; None: the kinds are listed.
        target: what is written, and ``second`` its scenario.
    """

    exit_code: ClassVar[int] = 0
    warnings: ClassVar[tuple[str, ...]] = ()
    row_failures: ClassVar[tuple[str, ...]] = ()

    source: Path | None
    target: Path = Path()
    second: Path = Path()

    def told(self) -> Iterator[Told]:
        """Yield the kinds, where none was asked for."""
        if self.source is None:
            yield ShortTable(["KIND", "machine"], [list(pair) for pair in templates().items()])
            yield "Write one with: ppmcal init KIND"

    def write(self, _: InitArguments) -> list[Path]:
        """Write the files, all of them or none; return their paths."""
        if self.source is None:
            return []
        scenario = self.source.parent / "scenarios" / self.source.name
        output = Output(self.target.parent, loose=True)
        output.add(self.target.name, for_editors(self.source, "mechanism", self.target.stem))
        if scenario.exists():
            output.add(self.second.name, for_editors(scenario, "scenario", self.target.stem))
        return output.write()

    def finished(self, written: Sequence[Path], _: InitArguments) -> Iterator[Told]:
        """Yield where they are, and what comes next."""
        yield f"Written: {', '.join(map(str, written))}"
        head, words = f"Next: put your numbers into {self.target}, then:", [
            "ppmcal", "check", self.target]
        if len(" ".join(map(str, [head, *words]))) > WIDTH:
            yield head
            head = "   "
        yield CommandLine(head, words)

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        return {"kinds": templates()} if self.source is None else {}

    def summary_of(self, written: Sequence[Path]) -> Mapping[str, Any]:
        """Return the files that were written."""
        return {"written": [str(p) for p in written]}


def run(asked: InitArguments) -> Template:
    """Return the file of a kind of machine.

    Raises:
        BadInput: there is no such kind, or a file is there already.
    """
    if asked.kind is None:
        return Template(None)
    path = find_template(asked.kind)
    target = Path(asked.out or path.name)
    second = target.with_name(f"{target.stem}.scenario.yaml")
    for place in (target, second):
        if place.exists() and not asked.force:
            raise BadInput("exists already", str(place), "Give another --out, or --force")
    return Template(path, target, second)
