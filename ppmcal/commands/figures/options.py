"""What ``ppmcal figures`` takes."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from ppmcal.commands.spec import Arguments, Command, Path_, argument, option
from ppmcal.errors import BadInput

FORMATS = ("pdf", "svg", "png")
UNITS = {"": 1.0, "mm": 1.0, "cm": 10.0, "in": 25.4, "pt": 25.4 / 72.27}
"""Millimetres of units of a width; ``pt`` is LaTeX's."""
LEAST, MOST = 60.0, 400.0
"""Widths of a figure, mm."""


@dataclass(frozen=True)
class FiguresArguments(Arguments):
    """Which results, which of their figures, and how these are to be."""

    folders: tuple[Path_, ...] = argument(
        "DIRS...", "Folders that commands, or save of their results, wrote; of a batch those of "
        "all its campaigns.", folder=True)
    form: str = option("pdf", "What the files are.", "--format", choices=FORMATS, shown=True)
    width: str = option("84mm", "How wide they are: 84mm is one column of many journals, 174mm "
                        "two.", metavar="LENGTH", shown=True)
    only: Sequence[str] = option((), "Those of a name or a group, such as residuals or '*-by-row*'",
                                 metavar="NAME", otherwise="all")

    @property
    def millimetres(self) -> float:
        """The width in mm.

        Raises:
            BadInput: it is no length, or no column is so wide.
        """
        found = re.fullmatch(r"\s*(\d+(?:\.\d*)?)\s*(mm|cm|in|pt|)\s*", self.width)
        if not found:
            raise BadInput(f"'{self.width}' is not a width", "--width",
                           "Write a number and mm, cm, in or pt, such as 84mm or 3.5in")
        out = float(found[1]) * UNITS[found[2]]
        if not LEAST <= out <= MOST:
            raise BadInput(f"'{self.width}' is out of range", "--width",
                           f"Write one from {LEAST:g}mm to {MOST:g}mm, such as 84mm (one column) "
                           "or 174mm (two)")
        return out


COMMAND = Command(
    "figures", FiguresArguments,
    about=("Write the figures that report has of the output folders {folders} as files for papers, "
           "and tables of parameters and errors.",
           "One file each, letters of 7 to 8 points at its width, with captions.md and "
           "captions.tex; tables as .tex (booktabs) and .md."),
    examples=("ppmcal figures identified --width 174mm",
              "ppmcal figures identified --only machine"),
    out="figures", result="FiguresResult", python="make_figures",
    raises="BadInput: a folder without results, no such figure, or a width that is none.",
    shares={"reading the results": 1.0, "writing the results": 3.0})
