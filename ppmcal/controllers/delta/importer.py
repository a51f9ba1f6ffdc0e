"""The import of a delta printer, from any firmware that has a reader of its configuration."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from ppmcal.controllers.delta.before import before_sentence, printer_before
from ppmcal.controllers.delta.files import RODS, SCALES, files, rods_of
from ppmcal.controllers.delta.geometry import SMALLEST
from ppmcal.controllers.delta.printer import Printer, PrinterReader
from ppmcal.errors import BadInput, unknown
from ppmcal.notes import Note
from ppmcal.wording import pluralize

LONGEST = 1e5
"""No rod is longer, and no radius, mm."""


@dataclass(frozen=True, eq=False)
class ImportedPrinter:
    """A printer and its measurements: :class:`ppmcal.controllers.importing.Imported`.

    Attributes:
        file: the controller's file.
        printer: what it says, mm and degrees.
        rods: how rods are taken: ``fixed``, ``shared`` or ``single``.
        scale: of measured distances: ``printed``, ``known``, or ``unknown``.
        choose: whether freedoms are left to what predicts best.
        findings: what the user must look at.
        inputs: other files that were read.
    """

    file: str
    printer: Printer
    rods: str
    scale: str
    choose: bool
    findings: tuple[str, ...]
    inputs: tuple[str, ...]

    def files(self) -> Mapping[str, str]:
        """Return machine.yaml, saved.yaml, and heights, distances and meshes with sidecars."""
        return dict(self._texts)

    @cached_property
    def _texts(self) -> dict[str, str]:
        return files(self.printer, self.rods, self.scale, self.choose)

    @cached_property
    def before(self) -> Mapping[str, object]:
        """Errors of the written machine on each table of touches, mm, and their definition."""
        return printer_before(self._texts)

    def headline(self) -> str:
        """Return what the file holds."""
        beds = "".join(f"; {len(m.rows)} touches of mesh {m.name}"
                       for m in self.printer.meshes)
        size = f"{self.printer.size}." if self.printer.size else ""
        return (f"{self.file}: a delta printer with "
                f"{pluralize(len(self.printer.heights), 'height')} and "
                f"{pluralize(len(self.printer.distances), 'distance')}{beds}; rods {self.rods}. "
                f"{before_sentence(self.before)} {size}").strip()

    def summary(self) -> Mapping[str, object]:
        """Return what ``--json`` prints of it; mm and degrees."""
        nominal = self.printer.nominal
        return {"heights": len(self.printer.heights), "distances": len(self.printer.distances),
                "meshes": {m.name: len(m.rows) for m in self.printer.meshes},
                "rods": self.rods, "scale": self.scale if self.printer.distances else None,
                "nominal": nominal.geometry.named(), "nominal_from": nominal.origin,
                "saved": self.printer.calibration.named() if self.printer.calibrated else None,
                "saved_off": dict(self.printer.off), "size": self.printer.size or None,
                "before": dict(self.before)}


def printer_importer(read: PrinterReader) -> Callable[[Path, Mapping[str, Any]], ImportedPrinter]:
    """Return the ``import_config`` of a firmware, :class:`ppmcal.controllers.importing.Importer`.

    What the printer saved of an earlier calibration is a result: the machine has the numbers in
    the body of the file, also where they are commented out.
    """
    def import_config(path: Path, options: Mapping[str, Any]) -> ImportedPrinter:
        scale, radius, mesh = options["scale"], options["radius"], options.get("mesh", ())
        if scale not in SCALES:
            raise unknown("scale of distances", scale, SCALES, "--scale")
        length, chosen = _rods(options["rods"])
        if radius is not None and not SMALLEST <= radius < LONGEST:
            raise BadInput(f"{radius} is not a radius in mm", "--radius",
                           "Give it from the joints at a tower to those at the effector, such as "
                           "--radius 140")
        meshes = [str(m) for m in ([mesh] if isinstance(mesh, str | os.PathLike) else mesh)]
        printer = read(path, length, meshes, radius)
        findings = list(printer.findings)
        if printer.distances and scale == "known" and not printer.nominal.rods_known:
            findings.append(Note("the distances alone hold the size: where the part that they were "
                                 "measured on has shrunk by 0.3 %, rods of 300 mm come out 1 mm "
                                 "short"))
        inputs = (*printer.included, *(m for m in meshes if Path(m).is_file()))
        return ImportedPrinter(str(path), printer, rods_of(printer, chosen), scale, chosen is None,
                               tuple(findings), inputs)

    return import_config


def _rods(given: str | float | Sequence[str | float]) -> tuple[float | None, str | None]:
    """Return the length of the rods, mm, and how they are fitted."""
    each = [given] if isinstance(given, str | int | float) else list(given)
    length: float | None = None
    word: str | None = None
    for one in each:
        if one in RODS:
            word = str(one)
            continue
        try:
            length = float(one)
        except ValueError:
            raise unknown("way to take rods", one, RODS, "--rods") from None
        if not 0.0 < length < LONGEST:
            raise BadInput(f"{one} is not a rod length in mm", "--rods",
                           "Give it from bearing to bearing, such as --rods 345")
    return length, word
