"""A controller's configuration as a machine and its measurements."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ppmcal.api.inputs import Path_, source_of
from ppmcal.api.result import Result
from ppmcal.controllers.klipper_config import Printer, find_format, read_printer
from ppmcal.controllers.klipper_export import files, rods_of
from ppmcal.wording import counted


@dataclass(frozen=True, eq=False, repr=False)
class ImportResult(Result):
    """A printer as a mechanism and its measurements.

    Attributes:
        file: the controller's file.
        printer: what it says, SI.
        rods: how rods are taken: ``fixed``, ``shared`` or ``single``.
    """

    COMMAND: ClassVar[str] = "import"
    TABLE: ClassVar[str] = "heights.csv"

    file: str
    printer: Printer
    rods: str

    def files(self) -> Mapping[str, str | bytes]:
        """Return machine.yaml, heights.csv and .yaml, and distances.csv and .yaml if any."""
        return dict(files(self.printer, self.rods))

    def headline(self) -> str:
        """Return what the file holds."""
        return (f"{self.file}: a delta printer with "
                f"{counted(len(self.printer.heights), 'height')} and "
                f"{counted(len(self.printer.distances), 'distance')}; rods {self.rods}.")


def import_config(form: str, file: Path_, *, rods: str | None = None) -> ImportResult:
    """Turn a controller's configuration into a machine and its measurements.

    Args:
        form: ``klipper``: printer.cfg of a linear delta, with what DELTA_CALIBRATE saved in it.
        file: the configuration.
        rods: ``fixed`` as they stand there, one length for all (``shared``), or one for each
            tower (``single``)  [default: fixed without measured distances, else shared, or
            single where they differ].

    Raises:
        BadInput: another format, or anything wrong in the file.
    """
    find_format(form)
    printer = read_printer(Path(file))
    chosen = rods_of(printer, rods)
    return ImportResult(source_of("import_config", [file], None), tuple(printer.findings),
                        str(file), printer, chosen)
