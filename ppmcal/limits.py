"""Size limits: stated once, checked while reading, before memory is allocated.

A file beyond a limit is rejected with the limit and a way round it; a million good rows are well
within all limits. The tables of ``docs/trust.md`` are generated from :data:`FILE_LIMITS` and
:data:`ASKED_LIMITS`.
"""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.errors import BadInput


@dataclass(frozen=True)
class Limit:
    """The largest accepted number of something, and what to do about more.

    Attributes:
        most: the largest accepted number.
        what: what is counted, in the plural.
        hint: a way round the limit, one sentence.
        where: the files or options to which the limit applies.
    """

    most: int
    what: str
    hint: str
    where: str

    def refuse(self, found: int, place: str) -> None:
        """Raise an error above the limit.

        Raises:
            BadInput: ``found`` is above the limit.
        """
        if found > self.most:
            raise self.error(place, grouped(found))

    def error(self, place: str, found: str = "") -> BadInput:
        """Return the error for exceeding the limit at ``place``."""
        has = f"has {found} {self.what}" if found else f"has too many {self.what}"
        return BadInput(f"{has}; the limit is {grouped(self.most)}", place, self.hint)


def grouped(number: int) -> str:
    """Return a whole number with thousands separators: ``2,000,000``."""
    return f"{number:,}" if abs(number) < 10 ** 15 else f"over 10^{len(str(abs(number))) - 1}"


_SPLIT = "Split the file: several are read together as one campaign; or leave out rows"
_TEXT = "Is it a measurement file? Those are CSV, with a sidecar of a few lines"
_LESS = "Ask for fewer, or write several scenarios"

TABLE_BYTES = Limit(500_000_000, "bytes", _SPLIT, "CSV, Parquet, spreadsheet, list of points, log")
TABLE_ROWS = Limit(2_000_000, "rows", _SPLIT, "any table; in a CSV lines count")
TABLE_COLUMNS = Limit(1_000, "columns", "Leave out columns that no key of the sidecar names, or "
                      "check what separates the cells", "any table")
TABLE_CELLS = Limit(50_000_000, "cells", _SPLIT, "any table: rows times columns")
LINE_BYTES = Limit(200_000, "bytes in one line", "Check line ends and quotes; a table has "
                   f"{grouped(TABLE_COLUMNS.most)} columns at most",
                   "CSV, list of points, log, configuration")
CELL_SIZE = Limit(200_000, "letters in one cell", "Leave the column out",
                  "spreadsheet, Parquet, data frame")
UNPACKED_BYTES = Limit(1_000_000_000, "bytes when unpacked", _SPLIT, "spreadsheet, Parquet")
BAG_BYTES = Limit(2_000_000_000, "bytes", "Record only the topics of joints and poses",
                  "bag of ROS")
CONFIG_BYTES = Limit(5_000_000, "bytes", "Give the configuration file itself, without logs",
                     "configuration of a controller: Klipper, RepRapFirmware, HAL, joint tables")
YAML_BYTES = Limit(10_000_000, "bytes", _TEXT, "any YAML file")
YAML_NODES = Limit(100_000, "keys and values", _TEXT, "any YAML file, aliases unfolded")
YAML_DEPTH = Limit(60, "levels of nesting", "Check the brackets and the indentation",
                   "any YAML file")
JSON_BYTES = Limit(300_000_000, "bytes", "Run the command that writes it again, on fewer rows",
                   "JSON of an earlier result")
JSON_NODES = Limit(10_000_000, "keys and values", "Run the command that writes it again, on fewer "
                   "rows", "JSON of an earlier result")
JSON_DEPTH = Limit(40, "levels of nesting", "Run the command that writes it again",
                   "JSON of an earlier result")

POSES = Limit(1_000_000, "poses", _LESS, "scenario: `count`, product of a grid's `counts`")
SIMULATED_ROWS = Limit(2_000_000, "rows", _LESS, "scenario: poses times `repeats`, payloads "
                       "and directions")
GRID_POSES = Limit(2_000_000, "poses", "Ask for fewer levels", "`--grid` of any command")
FOLDERS = Limit(50_000, "folders within", "Name the folder of the results itself",
                "folder given to `verify`")

FILE_LIMITS = (TABLE_BYTES, TABLE_ROWS, TABLE_COLUMNS, TABLE_CELLS, LINE_BYTES, CELL_SIZE,
               UNPACKED_BYTES, BAG_BYTES, CONFIG_BYTES, YAML_BYTES, YAML_NODES, YAML_DEPTH,
               JSON_BYTES, JSON_NODES, JSON_DEPTH)
"""Limits on the contents of files."""
ASKED_LIMITS = (POSES, SIMULATED_ROWS, GRID_POSES, FOLDERS)
"""Limits on requests: scenarios, grids, folders."""


def refuse_long_lines(data: bytes, source: str) -> None:
    """Reject a text with too many lines or too long a line; line ends are newlines.

    Raises:
        BadInput: with the line.
    """
    TABLE_ROWS.refuse(data.count(b"\n"), source)
    start, stop, most = 0, len(data), LINE_BYTES.most
    while start + most < stop:
        # advance to the last line end within the longest line allowed
        end = data.rfind(b"\n", start, start + most + 1)
        if end < 0:
            line = data.count(b"\n", 0, start) + 1
            raise BadInput(f"the line is longer than {grouped(most)} bytes, the limit",
                           f"{source}: line {line}", LINE_BYTES.hint)
        start = end + 1


def refuse_shape(rows: int, columns: int, source: str) -> None:
    """Reject a table with too many rows, columns or cells.

    Raises:
        BadInput: with the number that is too large.
    """
    TABLE_COLUMNS.refuse(columns, source)
    TABLE_ROWS.refuse(rows, source)
    TABLE_CELLS.refuse(rows * columns, source)
