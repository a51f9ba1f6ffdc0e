"""What ``ppmcal report`` takes."""

from __future__ import annotations

from dataclasses import dataclass

from ppmcal.commands.spec import CONSOLE, Arguments, Command, Path_, argument, option


@dataclass(frozen=True)
class ReportArguments(Arguments):
    """Which results."""

    folders: tuple[Path_, ...] = argument(
        "DIRS...", "Folders that commands, or save of their results, wrote.", folder=True)
    open_page: bool = option(False, "Open the page in the browser.", "--open", only=CONSOLE)


COMMAND = Command(
    "report", ReportArguments,
    about=("Gather the output folders {folders} into report.html and report.json.",),
    examples=("ppmcal report identified compared",), out="report", result="ReportResult",
    python="make_report",
    raises="BadInput: a folder without results, or a file there that cannot be read.",
    shares={"reading the results": 1.0, "drawing the page": 2.0, "writing the results": 0.1})
