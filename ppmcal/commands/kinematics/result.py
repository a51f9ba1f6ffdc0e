"""What the kinematics of a table gives."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from ppmcal.calibration.compensation import (
    ParameterCovariance,
    PoseRows,
    forward_sigma,
    independent,
    joint_sigma,
    left_joint_sigma,
    sigma_by_differences,
)
from ppmcal.commands.result import Result
from ppmcal.io.results.beside_model import of_other_values
from ppmcal.io.results.kinematics import (
    COVARIANCE,
    LOCKED,
    SIGMAS,
    TOLERANCES,
    KinematicsFiles,
    ModeColumns,
    ModelSigma,
    PoseFormat,
    kinematics_files,
    modes_sentence,
    solved_sentence,
)
from ppmcal.io.results.knowledge import KNOWLEDGE, knowledge_of, read_identification
from ppmcal.io.results.tables import joint_columns
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.tables import KinematicsTable
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration
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


MOST = 200
"""From so many rows on, what tolerances allow is reported."""
Solve = Callable[[Model], Array]


@dataclass(frozen=True, eq=False)
class CarriedKnowledge:
    """What is known of a machine's parameters, where that is from, and the files behind it."""

    knowledge: ParameterCovariance
    source: str
    files: tuple[str, ...] = ()


def carried(mechanism: Mechanism) -> CarriedKnowledge | None:
    """Return what a machine's file carries: a covariance beside it, sigmas, tolerances, or None.

    A nominal file is not taken for the machine of an identification.json that happens to lie
    beside it: only a file with sigmas was written by a calibration.

    Raises:
        BadInput: the identification.json beside a calibrated machine cannot be used.
    """
    sigma = {p.name: p.sigma for p in mechanism.parameters
             if p.sigma is not None and np.isfinite(p.sigma)}
    if sigma:
        beside = Path(mechanism.source).with_name(KNOWLEDGE)
        record = read_identification(beside) if mechanism.inputs and beside.is_file() else None
        if record is not None and not of_other_values(record, mechanism):
            return CarriedKnowledge(knowledge_of(record, mechanism, beside), COVARIANCE,
                                    (str(beside),))
        return CarriedKnowledge(independent(mechanism, sigma), SIGMAS)
    allowed = {p.name: p.prior_sigma for i, p in enumerate(mechanism.parameters)
               if i in mechanism.free and p.prior_sigma is not None}
    return CarriedKnowledge(independent(mechanism, allowed), TOLERANCES) if allowed else None


@dataclass(frozen=True, eq=False)
class SolvedRows:
    """Kinematics that were solved, and how they follow from the machine.

    ``at``: poses, joint values and conditions (N rows); ``registration``: what sees the platform,
    of the data set ``dataset``, if any; ``solve``: joint values and rates of a model (N, k) or
    (N, 2 k), for inverse kinematics and velocities.
    """

    which: str
    at: PoseRows
    registration: Registration
    dataset: str
    solve: Solve | None = None

    def first(self, most: int) -> SolvedRows:
        """Return at most so many rows, evenly spread, where none is solved again."""
        if self.solve is not None or len(self.at.q) <= most:
            return self
        some = np.linspace(0, len(self.at.q) - 1, most).astype(int)
        return replace(self, at=self.at.take(some))


def model_sigma(mechanism: Mechanism, solved: SolvedRows
                ) -> tuple[CarriedKnowledge | None, ModelSigma]:
    """Return what is known of a model, and how well that knows its kinematics.

    The latter as columns in file units, and as the entry of the JSON.
    """
    known = carried(mechanism)
    if known is None:
        return None, ModelSigma()
    if known.source == TOLERANCES:
        solved = solved.first(MOST)
    knowledge, columns = known.knowledge, dict[str, Array]()
    if solved.which == "forward":
        position, rotation = forward_sigma(Model(mechanism), solved.registration, solved.at,
                                           knowledge, solved.dataset)
        columns["sigma_position"] = position / mechanism.units.factor("length")
        if mechanism.motion.turns:
            columns["sigma_rotation"] = rotation / mechanism.units.factor("angle")
        return known, ModelSigma.of(mechanism, columns, known.source, solved.dataset or "base")
    k = len(mechanism.actuators)
    q = _joints(mechanism, solved, knowledge)
    columns |= joint_columns(mechanism, q[:, :k], "sigma_q_{}")
    if q.shape[1] > k:
        columns |= joint_columns(mechanism, q[:, k:], "sigma_rate_{}")
    return known, ModelSigma.of(mechanism, columns, known.source, "")


def _joints(mechanism: Mechanism, solved: SolvedRows, knowledge: ParameterCovariance) -> Array:
    """Return standard deviations of joint values, and of rates where they were asked for, SI."""
    model, short = Model(mechanism), mechanism.dependent > 0
    if solved.which == "inverse" and not short:
        return joint_sigma(model, solved.at, knowledge)
    assert solved.solve is not None
    found = sigma_by_differences(solved.solve, mechanism, knowledge)
    k = len(mechanism.actuators)
    left = left_joint_sigma(model, solved.at, knowledge)
    found[:, :k] = np.hypot(found[:, :k], left)
    if short:
        # a pose that names everything lies on this machine's surface alone
        near = joint_sigma(model, solved.at, knowledge)
        found[:, :k] = np.where(np.isnan(found[:, :k]), near, found[:, :k])
    return found
