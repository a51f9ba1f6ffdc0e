"""What the kinematics of a table gives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

from ppmcal.commands.result import Result
from ppmcal.io.results.kinematics import (
    LOCKED,
    KinematicsFiles,
    ModeColumns,
    PoseFormat,
    kinematics_files,
    modes_sentence,
    solved_sentence,
)
from ppmcal.io.results.kinematics_uncertainty import ModelSigma
from ppmcal.kinematics.tables import (
    KinematicsTable,
)
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import pluralize
from ppmcal.wording.told import Told


@dataclass(frozen=True, eq=False, repr=False)
class KinematicsResult(Result):
    """Kinematics of N rows.

    Attributes:
        mechanism: the machine; which: ``inverse``, ``forward`` or ``velocity``.
        table: joint values, poses, rates, conditioning, status and reason of each row, SI.
        form: tool point, measured poses and convention of rotations in the files.
        given: header and columns of the table as it was given; with all assembly modes, repeated
            for each of them.
        modes: which assembly mode each row is, where all of them were asked for.
        sure: how well the model itself is known: standard deviations, file units.
        pictures: whether pictures are among the files.
    """

    COMMAND: ClassVar[str] = "kinematics"
    TABLE: ClassVar[str] = "kinematics.csv"

    mechanism: Mechanism
    which: str
    table: KinematicsTable
    form: PoseFormat
    given: tuple[tuple[str, ...], tuple[Any, ...]]
    modes: ModeColumns | None = None
    sure: ModelSigma = field(default_factory=ModelSigma)
    pictures: bool = False

    @property
    def q(self) -> Array:
        """Joint values (N, k), m and rad."""
        return self.table.q

    @property
    def pose(self) -> Array:
        """Poses (N, 6): x, y, z in m, rotation vector in rad; of the tool if there is one."""
        return self.table.pose if self.form.pose is None else self.form.pose

    @property
    def failed(self) -> list[tuple[int, str, str]]:
        """Rows (from 1) that are not ok, each with status and reason.

        With all assembly modes, rows of joint values at which the machine's own one is not ok.
        """
        pairs = (zip(self.table.status, self.table.reason, strict=True) if self.modes is None
                 else self.modes.status)
        return [(n + 1, s, r) for n, (s, r) in enumerate(pairs) if s != "ok"]

    @property
    def asked(self) -> int:
        """How many rows the table has."""
        return len(self.table.status if self.modes is None else self.modes.status)

    @cached_property
    def _made(self) -> KinematicsFiles:
        header, columns = self.given
        return kinematics_files(self.mechanism, self.table, header, list(columns), self.which,
                                self.provenance, self.form, self.modes, self.sure)

    @property
    def gimbal_lock(self) -> int:
        """How many rows have only two of their three Euler angles determined."""
        return self._made.locked

    def files(self) -> Mapping[str, str | bytes]:
        """Return kinematics.csv, kinematics.json and, where wanted, pictures."""
        if not self.pictures:
            return self._made.texts()
        from ppmcal.report.figure_files import kinematics_pictures

        return {**self._made.texts(), **kinematics_pictures(
            self._made.record, self._made.columns, self.mechanism.name)}

    @property
    def row_failures(self) -> Sequence[str]:
        """Sentences on rows that are not ok."""
        return [Note(f"row {n}: {s}: {r}") for n, s, r in self.failed]

    @property
    def exit_code(self) -> int:
        """3 where no row has a result."""
        failed = self.failed
        if failed and len(failed) == self.asked and all(
                status in ("not converged", "singular") for _, status, _ in failed):
            return 3
        return super().exit_code

    def told(self) -> Iterator[Told]:
        """Yield how many rows are ok, and of how many an angle is not determined."""
        yield self.headline()
        if self.gimbal_lock:
            yield f"{pluralize(self.gimbal_lock, 'row')}: {LOCKED}."

    def summary(self) -> Mapping[str, Any]:
        """Return what ``--json`` prints."""
        lines = {} if self.modes is None else {"modes": len(self.table.status)}
        return {"format": "ppmcal/kinematics-summary/1", "rows": self.asked,
                "not_ok": len(self.failed), **lines, "gimbal_lock": self.gimbal_lock,
                "provenance": self.provenance}

    def headline(self) -> str:
        """Return how many rows are ok, and how sure they are."""
        more = "" if self.modes is None else (
            f" {modes_sentence(self.modes.counts, self.modes.method, self.modes.complete)}")
        return (f"{self.mechanism.name}: {self.which} kinematics, "
                f"{solved_sentence(self.asked - len(self.failed), self.asked)}.{more} "
                f"{self.sure.entry.words()}")
