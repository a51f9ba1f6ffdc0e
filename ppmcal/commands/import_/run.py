"""A controller's configuration as a machine and its measurements."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

from ppmcal.commands.import_.options import ImportArguments
from ppmcal.commands.result import Result
from ppmcal.controllers import IMPORTS, loaded
from ppmcal.controllers.delta.before import before_sentence, printer_before
from ppmcal.controllers.delta.files import RODS, SCALES, files, rods_of
from ppmcal.controllers.delta.geometry import SMALLEST
from ppmcal.controllers.delta.printer import Importer, Printer
from ppmcal.errors import BadInput, unknown
from ppmcal.notes import Note
from ppmcal.store.provenance import source_of
from ppmcal.wording import pluralize
from ppmcal.wording.told import CommandLine, Told

ROBOTS = {
    "urdf": "it describes trees, and a parallel machine is a loop",
    "sdf": "its loops are joints between links, which say nothing of limbs, drives or home",
    "mjcf": "its loops are constraints of points, which say nothing of limbs, drives or home"}
"""Models of robots, and why they are not a mechanism."""
LONGEST = 1e5
"""No rod is longer, and no radius, mm."""


@dataclass(frozen=True, eq=False, repr=False)
class ImportResult(Result):
    """A printer as a mechanism and its measurements.

    Attributes:
        file: the controller's file.
        printer: what it says, mm and degrees.
        rods: how rods are taken: ``fixed``, ``shared`` or ``single``.
        scale: of measured distances: ``printed``, ``known``, or ``unknown``.
        size: both readings of the size, by distances and by rods, in a sentence.
        choose: whether freedoms are left to what predicts best.
        off: saved number -> by how much it is not what the printer's own fit gives, mm and degrees.
    """

    COMMAND: ClassVar[str] = "import"
    TABLE: ClassVar[str] = "heights.csv"

    file: str
    printer: Printer
    rods: str
    scale: str
    off: Mapping[str, float]
    choose: bool = True
    size: str = ""

    def files(self) -> Mapping[str, str | bytes]:
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
        return (f"{self.file}: a delta printer with "
                f"{pluralize(len(self.printer.heights), 'height')} and "
                f"{pluralize(len(self.printer.distances), 'distance')}{beds}; rods {self.rods}. "
                f"{before_sentence(self.before)} {f'{self.size}.' if self.size else ''}").strip()

    def finished(self, written: Sequence[Path], asked: Any) -> Iterator[Told]:
        """Yield where the files are, and what to do with the measurements among them."""
        yield from super().finished(written, asked)
        if tables := [p for p in written if p.suffix == ".csv"]:
            machine = written[0].with_name("machine.yaml")
            yield CommandLine("Next:", ["ppmcal", "identify", machine, *tables])

    def summary_of(self, written: Sequence[Path]) -> Mapping[str, Any]:
        """Return the names of the files that were written."""
        return {"written": [p.name for p in written]}

    def summary(self) -> dict[str, object]:
        """Return what the command prints as JSON, but for the files written; mm and degrees."""
        nominal = self.printer.nominal
        return {"format": "ppmcal/import/1", "heights": len(self.printer.heights),
                "distances": len(self.printer.distances),
                "meshes": {m.name: len(m.rows) for m in self.printer.meshes},
                "rods": self.rods, "scale": self.scale if self.printer.distances else None,
                "nominal": nominal.geometry.named(), "nominal_from": nominal.origin,
                "saved": self.printer.calibration.named() if self.printer.calibrated else None,
                "saved_off": dict(self.off), "size": self.size or None, "before": dict(self.before),
                "findings": list(self.findings),
                "provenance": self.provenance}


def run(asked: ImportArguments) -> ImportResult:
    """Turn a controller's configuration into a machine and its measurements.

    What the printer saved of an earlier calibration is a result: the machine has the numbers in
    the body of the file, also where they are commented out.
    """
    form, file, scale, radius = asked.form, asked.file, asked.scale, asked.radius
    name = form.lower()
    if name in ROBOTS:
        raise BadInput(f"{form.upper()} is not imported: {ROBOTS[name]}", str(file),
                       "Begin with `ppmcal init 6-UPS` or the kind of your machine, and copy the "
                       "joints' places at home from the file; docs/notes.md says why")
    reader: Importer = loaded(form, IMPORTS)
    if scale not in SCALES:
        raise unknown("scale of distances", scale, SCALES, "--scale")
    length, chosen = _rods(asked.rods)
    if radius is not None and not SMALLEST <= radius < LONGEST:
        raise BadInput(f"{radius} is not a radius in mm", "--radius",
                       "Give it from the joints at a tower to those at the effector, such as "
                       "--radius 140")
    mesh = asked.mesh
    meshes = [str(m) for m in ([mesh] if isinstance(mesh, str | os.PathLike) else mesh)]
    printer = reader.printer(Path(file), length, meshes, radius)
    findings = list(printer.findings)
    if printer.distances and scale == "known" and not printer.nominal.rods_known:
        findings.append(Note("the distances alone hold the size: where the part that they were "
                             "measured on has shrunk by 0.3 %, rods of 300 mm come out 1 mm short"))
    inputs = [file, *printer.included, *(m for m in meshes if Path(m).is_file())]
    return ImportResult(source_of("import_config", inputs, None), tuple(findings), str(file),
                        printer, rods_of(printer, chosen), scale, printer.off, chosen is None,
                        printer.size)


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
