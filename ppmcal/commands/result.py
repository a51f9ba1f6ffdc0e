"""What every function of the Python face returns: a result that shows and saves itself."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from ppmcal.calibration.validation import Identification
from ppmcal.errors import unknown
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import has_findings
from ppmcal.store.folder import running
from ppmcal.store.inputs import current, path_errors, track_input
from ppmcal.store.output import Content, Output
from ppmcal.store.provenance import one_thread
from ppmcal.wording.progress import stage
from ppmcal.wording.told import Told

if TYPE_CHECKING:
    from ppmcal.calibration.compensation import Readings
    from ppmcal.io.results.batch import CampaignQuantity

Progress = Callable[[str], None]
SHOWN = 20
"""Rows that a notebook shows of a table."""


@dataclass(frozen=True, eq=False)
class Result:
    """What one command found.

    Attributes:
        provenance: version, SHA-256 of each input file, command and seed.
        findings: sentences that the user must look at, and notes that are good to know; their
            level says which.
    """

    COMMAND: ClassVar[str]
    TABLE: ClassVar[str]
    """The file whose rows stand for the result."""
    UNTOLD: ClassVar[tuple[str, ...]] = ()
    """Keys of the record that ``--json`` leaves out."""

    provenance: Mapping[str, Any]
    findings: tuple[str, ...]

    def files(self) -> Mapping[str, Content]:
        """Return name -> content of the files that the command writes; a long table as lines."""
        raise NotImplementedError

    @property
    def row_failures(self) -> Sequence[str]:
        """Sentences on rows that have no result."""
        return ()

    @property
    def warnings(self) -> list[str]:
        """What needs a look, and what the machine's file leaves to the program."""
        machine = getattr(self, "mechanism", None)
        left = machine.findings if isinstance(machine, Mechanism) else ()
        return list(dict.fromkeys([*left, *self.findings]))

    def remarks(self) -> Sequence[str]:
        """Return every sentence besides the result itself; their levels give the exit code."""
        return [*self.findings, *self.row_failures]

    @property
    def has_findings(self) -> bool:
        """Whether a remark is a finding."""
        return has_findings(self.remarks())

    @property
    def exit_code(self) -> int:
        """The exit code of the command."""
        return int(self.has_findings)

    @property
    def verdict(self) -> str:
        """How it ended, in a word of the table of a batch."""
        return "done"

    def quantities(self) -> Iterator[CampaignQuantity]:
        """Yield what the table of a batch has of it."""
        return iter(())

    def told(self) -> Iterator[Told]:
        """Yield what a person wants to know, the most important first."""
        yield self.headline()

    def finished(self, written: Sequence[Path], asked: Any) -> Iterator[Told]:
        """Yield where the files are, and what may be done with them.

        Args:
            written: their paths.
            asked: the arguments of the command.
        """
        yield f"Written to {written[0].parent}: {', '.join(p.name for p in written)}"

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        entries: Mapping[str, Any] = self.record.entries()  # type: ignore[attr-defined]
        return {k: v for k, v in entries.items() if k not in self.UNTOLD}

    def summary_of(self, written: Sequence[Path]) -> Mapping[str, Any]:
        """Return what ``--json`` prints of the files that were written, besides the rest."""
        return {}

    def headline(self) -> str:
        """Return the result in a line."""
        record = self.record  # type: ignore[attr-defined]
        first = str(record.summary[0])
        return first if first.startswith(f"{record.name}: ") else f"{record.name}: {first}"

    def save(self, folder: str | os.PathLike[str], force: bool = False) -> list[Path]:
        """Write the command's files into a folder, all of them or none; return their paths.

        Args:
            folder: made if it is not there.
            force: replace what this command did not write; inputs are never replaced.

        Raises:
            BadInput: the folder holds other files, or an input of this result.
        """
        own = nullcontext() if current().command else running(self.COMMAND, Path(folder), force)
        with one_thread(), path_errors(), stage("writing the results"), own:
            for path in self.provenance.get("inputs", {}):
                track_input(path)
            current().source.update(self.provenance)
            output = Output(folder)
            for name, content in self.files().items():
                output.add(name, content)
            return output.write()

    def to_frame(self, file: str = "") -> Any:
        """Return a table of the result, in the units of its file.

        Args:
            file: one of the CSV files that :meth:`save` writes  [default: the main one].

        Returns:
            A pandas data frame, or, where pandas is not installed, a dict from column to (N,)
            values.
        """
        tables = self.tables()
        name = file or self._main(tables)
        if name not in tables:
            raise unknown("table", name, tables)
        return framed(tables[name])

    def _main(self, tables: Mapping[str, Content]) -> str:
        """Return the table that stands for the result, the first where that one is not there."""
        return self.TABLE if self.TABLE in tables else next(iter(tables), self.TABLE)

    def tables(self) -> Mapping[str, Content]:
        """Return those of the files that are tables."""
        return {k: v for k, v in self.files().items() if k.endswith(".csv")}

    def __repr__(self) -> str:
        """Return the result in a line."""
        more = f"; {len(self.findings)} findings" if self.findings else ""
        return f"<ppmcal {self.COMMAND}: {self.headline()}{more}>"

    def _repr_html_(self) -> str:
        """Return the headline, findings and the first rows of the main table for a notebook."""
        from ppmcal.report.html import bullets, csv_cell, paragraph, table

        tables = self.tables()
        header, *rows = _rows(tables.get(self._main(tables), "")) or [[]]
        more = f"{len(rows) - SHOWN} more rows" if len(rows) > SHOWN else ""
        return (paragraph(f"ppmcal {self.COMMAND}: {self.headline()}") + bullets(self.findings)
                + table("", header, [[csv_cell(c) for c in row] for row in rows[:SHOWN]])
                + paragraph(more))


@runtime_checkable
class CalibratedMachine(Protocol):
    """A result with a machine that was fitted: what ``compensate`` takes besides files."""

    @property
    def mechanism(self) -> Mechanism:
        """The fitted machine."""
        ...

    @property
    def identification(self) -> Identification:
        """Its fit, with covariance and measured volume."""
        ...

    @property
    def readings(self) -> Readings:
        """Other readings of the same measurements."""
        ...


def framed(content: Content) -> Any:
    """Return a CSV as a pandas data frame, or as a dict of columns without pandas."""
    try:
        import pandas
    except ImportError:
        header, *rows = _rows(content)
        return {name: _column([row[i] for row in rows]) for i, name in enumerate(header)}
    return pandas.read_csv(io.StringIO(_text(content)))


def _column(cells: list[str]) -> Any:
    """Return cells as numbers (N,), nan where empty, or as words where one is none."""
    try:
        return np.array([float(c) if c else np.nan for c in cells])
    except ValueError:
        return np.array(cells, dtype=object)


def _rows(content: Content) -> list[list[str]]:
    return list(csv.reader(io.StringIO(_text(content))))


def _text(content: Content) -> str:
    return content.decode() if isinstance(content, bytes) else str(content)
