"""Reading what is worked out before anything is measured: records, row counts, pictures.

Sensitivity, tolerances, stiffness, workspace and measuring plans write one form of record:
sentences, tables and the captions of their pictures, beside numbers of their own.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from pathlib import Path

from ppmcal.codec import AGAIN
from ppmcal.errors import BadInput
from ppmcal.io.results.plan import PlanRecord
from ppmcal.io.results.sensitivity import SensitivityRecord
from ppmcal.io.results.stiffness import StiffnessRecord
from ppmcal.io.results.tables import ANY_TABLE
from ppmcal.io.results.tolerances import TolerancesRecord
from ppmcal.io.results.workspace import WorkspaceRecord
from ppmcal.notes import NOTE, Note
from ppmcal.report.records import Designed, DesignRecord, Picture
from ppmcal.store.inputs import track_input

DESIGNS: Mapping[str, type[DesignRecord]] = {kind.FILE.removesuffix(".json"): kind for kind in (
    SensitivityRecord, TolerancesRecord, StiffnessRecord, WorkspaceRecord, PlanRecord)}
"""Their records, by command."""
DESIGN_FILES = (*(kind.FILE for kind in DESIGNS.values()),
                *(f"{name}.csv" for name, kind in DESIGNS.items() if f"{name}.csv" in kind.TABLES))
"""Files by which such a folder is recognised; tables of other names are not theirs alone."""

LARGEST_FILE = 20_000_000
LARGEST_AREA = 60_000_000
"""Pictures of more bytes or dots stay out of the page."""
MOST = 40
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


def designs_in(folder: Path) -> list[str]:
    """Return the commands of which a folder holds the record, or the table of the same name."""
    return [kind for kind in DESIGNS if any(
        (folder / f"{kind}.{end}").is_file() for end in ("json", "csv")
        if f"{kind}.{end}" in DESIGN_FILES)]


def designed(folder: Path) -> list[Designed]:
    """Return what such commands left in a folder, each with its record.

    Raises:
        BadInput: a record or a table is broken.
    """
    out: list[Designed] = []
    for kind in designs_in(folder):
        file, of = folder / f"{kind}.json", DESIGNS[kind]
        record = of.read(file) if file.is_file() else of()
        _refuse_uneven(record, str(file))
        rows = {name: ANY_TABLE.read(folder / name, lambda _: False).size
                for name in of.TABLES if (folder / name).is_file()}
        out.append(Designed(str(folder), kind, record, rows, _pictures(folder, record)))
    return out


def _refuse_uneven(record: DesignRecord, source: str) -> None:
    """Refuse a table whose rows have not one cell for each column."""
    for i, table in enumerate(record.tables):
        for j, row in enumerate(table.rows):
            if len(row) != len(table.columns):
                raise BadInput(f"has {len(row)} cells, but the table has {len(table.columns)} "
                               "columns", f"{source}: tables[{i}].rows[{j}]", AGAIN)


def _pictures(folder: Path, record: DesignRecord) -> tuple[Picture, ...]:
    """Return the pictures that a record lists, or all of the folder where it has no list."""
    listed = record.pictures
    if listed is None:
        try:
            names = sorted(p.name for p in folder.iterdir() if p.suffix.lower() == ".png")
        except OSError:
            names = []
        listed = dict.fromkeys(names, "")
    out = [_picture(folder, name, caption) for name, caption in list(listed.items())[:MOST]]
    more = _left_out(f"the page takes {MOST} pictures")
    return (*out, *(Picture(name, "", problem=more) for name in list(listed)[MOST:]))


def _left_out(why: str) -> Note:
    return Note(f"left out: {why}", NOTE)


def _picture(folder: Path, name: str, caption: str) -> Picture:
    """Return one picture, or why it is not in the page."""
    def without(problem: str) -> Picture:
        return Picture(name, caption, problem=problem)

    if not name or name in (".", "..") or "/" in name or "\\" in name or "\0" in name:
        return without(_left_out("it is not in this folder"))
    path = folder / name
    try:
        if not path.is_file():
            return without("missing")
        if path.stat().st_size > LARGEST_FILE:
            return without(_left_out(f"larger than {LARGEST_FILE // 1_000_000} MB"))
        track_input(path)
        content = path.read_bytes()
    except OSError as error:
        return without(f"cannot be read ({error.strerror or error})")
    size, problem = png_size(content)
    return without(problem) if problem else Picture(name, caption, content, size)


def png_size(content: bytes) -> tuple[tuple[int, int], str]:
    """Return width and height of a PNG, or what is wrong with it.

    Every chunk is followed to the end and its check sum made, so that what was cut off or
    damaged does not leave a hole in the page.
    """
    if not content.startswith(_SIGNATURE):
        return (0, 0), _left_out("it is not a PNG")
    at, first, size = len(_SIGNATURE), True, (0, 0)
    while at + 12 <= len(content):
        length = int.from_bytes(content[at:at + 4], "big")
        body, end = content[at + 4:at + 8 + length], at + 12 + length
        if end > len(content) or zlib.crc32(body) != int.from_bytes(content[end - 4:end], "big"):
            break
        if first:
            if body[:4] != b"IHDR" or length != 13:
                break
            size = (int.from_bytes(body[4:8], "big"), int.from_bytes(body[8:12], "big"))
            if not 0 < size[0] * size[1] <= LARGEST_AREA:
                return (0, 0), _left_out(f"it has {size[0]} by {size[1]} dots")
        if body[:4] == b"IEND":
            return size, ""
        at, first = end, False
    return (0, 0), _left_out("it is cut off or damaged")
