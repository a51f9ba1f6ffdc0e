"""Plain data of a report: what was found in the folders, in the units of the files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Generic, TypeAlias, TypeVar

import numpy as np

from ppmcal.io.csv import Table
from ppmcal.io.results.commands import CommandsRecord
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.export import ExportRecord
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.results.record import Record
from ppmcal.io.results.scene_rows import FittedRows
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.io.results.simulation import ComparedMachines, TruthRecord
from ppmcal.io.results.stiffness import StiffnessRecord
from ppmcal.io.results.tolerances import TolerancesRecord
from ppmcal.io.results.validation import ValidationRecord
from ppmcal.io.results.workspace import WorkspaceRecord
from ppmcal.linalg import Array, Bools, Ints

R = TypeVar("R", bound=Record)
DesignRecord: TypeAlias = (SensitivityRecord | TolerancesRecord | StiffnessRecord | WorkspaceRecord
                | PlanRecord)


def shown(cell: str) -> str:
    """Return a cell of a CSV with six digits if it is a number."""
    try:
        return f"{float(cell):.6g}"
    except ValueError:
        return cell.strip()


@dataclass(frozen=True, eq=False)
class MeasuredRows:
    """Where the N rows of a residuals.csv stand in the files that were fitted.

    Attributes:
        tables: these files, without joint values.
        table, line: of each row (N,), from 0; -1 where unknown.
    """

    tables: tuple[Table, ...]
    table: Ints
    line: Ints

    def said(self, row: int) -> list[str]:
        """Return what the file says of a row, as it stands there: ``temperature 21.5``."""
        if self.table[row] < 0:
            return []
        table, line = self.tables[self.table[row]], int(self.line[row])
        cells = [(h, shown(table.text[h][line]) if h in table.text else
                  f"{table.numbers[h][line]:.6g}") for h in table.header
                 if h in table.text or h in table.numbers]
        return [f"{name} {cell}" for name, cell in cells if cell and cell != "nan"]


@dataclass(frozen=True)
class Identified(FittedRows):
    """Output of ``identify`` (or the fit behind ``diagnose``).

    Attributes:
        record: identification.json, with the parameters of parameters.csv where it has none.
        positions: measured x, y (N, 2) of the residual rows, nan where unknown; None where
            no measurement file with the right check sum was at hand.
        diagnosed: whether it is the fit behind a diagnosis in the same folder.
        next: the rows of next.csv, what to measure next; None without.
        measured: the residual rows in their own files; None where these are not at hand.
    """

    positions: Array | None = None
    diagnosed: bool = False
    next: Table | None = None
    measured: MeasuredRows | None = None

    @property
    def name(self) -> str:
        """The mechanism's name, or the folder."""
        return self.record.name or self.folder

    @property
    def freedoms(self) -> int:
        """Coordinates of the platform's pose, 0 where unknown."""
        return len(self.record.measured_volume)


@dataclass(frozen=True)
class Simulated:
    """Output of ``simulate``; ``digest`` is the SHA-256 of its measurements.csv.

    ``copies``: check sums of other files that hold the same measurements to round-off.
    """

    folder: str
    truth: TruthRecord | None
    measurements: Table | None
    digest: str = ""
    copies: tuple[str, ...] = ()

    def behind(self, one: Identified) -> bool:
        """Whether an identification used these measurements: it names the check sum of a file.

        A campaign that was simulated again elsewhere differs in its last digits: a copy.
        """
        inputs = one.record.provenance.inputs.values()
        return any(d in inputs for d in (self.digest, *self.copies) if d)


@dataclass(frozen=True)
class CheckedRows(Generic[R]):
    """Rows with a status each, whether they went well: commands.csv or kinematics.csv.

    Or any table without a chapter of its own, ``kind``: its name without an ending.
    """

    folder: str
    kind: str
    record: R
    table: Table | None = None

    @property
    def flagged(self) -> tuple[int, ...]:
        """Rows (from 0) whose status is not that all went well."""
        if self.table is None:
            return ()
        pairs = zip(self.table.words("status"), self.table.words("reason"), strict=True)
        return tuple(i for i, (s, r) in enumerate(pairs)
                     if (s.strip().lower() not in FINE if s.strip() else bool(r.strip())))

    @property
    def accepted(self) -> Bools:
        """The rows that went well (N,)."""
        out = np.ones(0 if self.table is None else self.table.size, dtype=bool)
        out[list(self.flagged)] = False
        return out


FINE = frozenset({"ok", "done", "good", "solved", "corrected", "compensated", "1", "true",
                  "other mode"})
"""Words by which a row's status says that there is nothing to look at."""


@dataclass(frozen=True)
class Diagnosed:
    """Output of ``diagnose``; ``next``: the rows of next.csv, None without."""

    folder: str
    record: DiagnosisRecord
    effects: Table | None
    residuals: Table | None = None
    next: Table | None = None


@dataclass(frozen=True)
class Held(Generic[R]):
    """Output that its record says all of: that of ``validate``, ``compare`` and ``export``."""

    folder: str
    record: R


@dataclass(frozen=True)
class Picture:
    """A PNG beside a record: its bytes and size in dots, or ``problem``: why it is not shown."""

    file: str
    caption: str
    png: bytes = b""
    size: tuple[int, int] = (0, 0)
    problem: str = ""


@dataclass(frozen=True)
class Designed:
    """Output of sensitivity, tolerances, stiffness, workspace or plan.

    Attributes:
        folder: where it was found; kind: the command.
        record: its JSON, empty if it was not there.
        rows: rows of each of its tables, by file.
        pictures: those that the record lists.
    """

    folder: str
    kind: str
    record: DesignRecord
    rows: Mapping[str, int]
    pictures: tuple[Picture, ...] = ()


@dataclass(frozen=True)
class ReportData:
    """Everything that the folders held; ``use``: what may be done with the model of a folder.

    What other chapters ask for has a field of its own; ``held`` has the rest by ``Kind.place``.
    """

    folders: tuple[str, ...]
    identified: tuple[Identified, ...] = ()
    diagnosed: tuple[Diagnosed, ...] = ()
    compensated: tuple[CheckedRows[CommandsRecord], ...] = ()
    simulated: tuple[Simulated, ...] = ()
    designed: tuple[Designed, ...] = ()
    validated: tuple[Held[ValidationRecord], ...] = ()
    exported: tuple[Held[ExportRecord], ...] = ()
    comparisons: tuple[ComparedMachines, ...] = ()
    held: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    use: Callable[[str], str] = lambda _: ""

    @classmethod
    def of(cls, folders: tuple[str, ...], entries: Mapping[str, tuple[Any, ...]]) -> ReportData:
        """Return what folders held, by the ``place`` of its kind."""
        places = {f.name for f in fields(cls)}
        own: dict[str, Any] = {k: v for k, v in entries.items() if k in places}
        return cls(folders, held={k: v for k, v in entries.items() if k not in places}, **own)
