"""What the page makes of ``kinematics``: how many rows were solved, and the machine's motion."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial

from ppmcal.io.results.kinematics import (
    KINEMATICS_TABLE,
    KinematicsRecord,
    modes_sentence,
    solved_sentence,
)
from ppmcal.plotting.canvas import Drawing
from ppmcal.report.checked_rows import attention, refused, summed_up
from ppmcal.report.html import count, figures, paragraph
from ppmcal.report.kind import Folder, Kind
from ppmcal.report.kinematics_figures import kinematics_figures
from ppmcal.report.kinematics_motion import is_shown
from ppmcal.report.other import scalars
from ppmcal.report.records import CheckedRows
from ppmcal.report.section import Section, filled

CHAPTERS = {"path": "Path", "pose": "Pose", "joints": "Joints", "rates": "Rates",
            "singularity": "Distance to singularity"}


def _of_kinematics(rows: CheckedRows) -> dict[str, list[Drawing]]:
    record, columns = rows.record, rows.table
    return kinematics_figures(record, columns) if (
        isinstance(record, KinematicsRecord) and columns is not None) else {}


def kinematics_section(rows: CheckedRows) -> Section:
    """Return how many rows were solved, and those that were not."""
    size = rows.table.size if rows.table is not None else 0
    done = size - len(rows.flagged)
    text, parts = f"{solved_sentence(done, size)}." if size else "", []
    if isinstance(rows.record, KinematicsRecord):
        modes = rows.record.modes
        if modes is not None:
            said = modes_sentence(modes, rows.record.mode_method, rows.record.all_modes)
            text = (f"{count(sum(modes), 'pose')} in {count(len(modes), 'row')} of "
                    f"joint values. {said} The machine's own is drawn.")
        drawn = _of_kinematics(rows)
        parts = [Section(CHAPTERS[name], figures(drawings), count(len(drawings), "picture"),
                         folded=name in ("pose", "rates")) for name, drawings in drawn.items()]
    return Section("Kinematics", paragraph(text) + scalars(rows.record.entries()), rows.folder,
                   parts=filled([*parts, refused(rows)]))


def _kinematics_of(folder: Folder) -> Iterator[CheckedRows]:
    if folder.has("kinematics.csv", "kinematics.json"):
        yield CheckedRows(folder.name, "kinematics", folder.record(KinematicsRecord), folder.table(
            KINEMATICS_TABLE, is_shown))


KINEMATICS: Kind[CheckedRows] = Kind(
    "kinematics", "kinematics", "kinematics", 80, ("kinematics.csv", "kinematics.json"),
    _kinematics_of, lambda r, _: [(f"Kinematics in {r.folder}", partial(kinematics_section, r))],
    summed_up, lambda r: [("kinematics", r.record)], attention, lambda r, _: _of_kinematics(r))
