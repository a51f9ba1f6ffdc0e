"""The import of a delta printer, from any firmware that has a reader of its configuration."""

from __future__ import annotations

import csv
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ppmcal.calibration.fit import Problem
from ppmcal.calibration.validation import DEFINITION, before
from ppmcal.controllers.delta.files import RODS, SCALES, SHRUNK, files, rods_of
from ppmcal.controllers.delta.geometry import SMALLEST
from ppmcal.controllers.delta.printer import Printer, PrinterReader
from ppmcal.errors import BadInput, PpmcalError, unknown
from ppmcal.io import read_mechanism
from ppmcal.io.column_names import LABELS
from ppmcal.io.dataset_reader import dataset_of
from ppmcal.io.frames import as_table
from ppmcal.io.results.identification_parts import summaries
from ppmcal.io.sidecar import sidecar_of
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import Note
from ppmcal.wording import number, pluralize


def printer_before(texts: Mapping[str, str]) -> dict[str, object]:
    """Return the errors of machine.yaml on the touches beside it, as `identify` says ``before``.

    Args:
        texts: the files that an import writes, by name.

    Returns:
        ``definition``, and by data set ``rms``, ``p95`` ... and ``unit``; empty without touches, or
        where the machine reaches none of them.
    """
    try:
        mechanism = read_mechanism(yaml.safe_load(texts["machine.yaml"]))
        sets = tuple(_datasets(texts, mechanism))
        if not sets:
            return {}
        errors = before(Problem(mechanism, sets, ()),
                        [np.ones(len(d), dtype=bool) for d in sets]).residuals
    except PpmcalError:
        return {}    # what is wrong with them identify says, with the place in its file
    out: dict[str, object] = {}
    for i, data in enumerate(sets):
        rows = [np.full(len(d), i == j) for j, d in enumerate(sets)]
        found = summaries(errors.figures(rows), mechanism.units).get("position")
        if found is not None:
            out[data.name] = found.entries(whole=True)
    return {"definition": DEFINITION, **out} if out else {}


def before_sentence(found: Mapping[str, object]) -> str:
    """Return what the errors were before, empty where they are not known."""
    parts = [f"{number(size['rms'])} {size['unit']} rms on {name}" for name, size in found.items()
             if isinstance(size, dict)]
    return f"Before: {', '.join(parts)}. \"Before\" is {found['definition']}." if parts else ""


def _datasets(texts: Mapping[str, str], mechanism: Mechanism) -> Iterator[Dataset]:
    for name, text in texts.items():
        if not name.endswith(".csv"):
            continue
        stem = name.removesuffix(".csv")
        header, *rows = csv.reader(text.splitlines())
        yield touches(mechanism, stem, header, np.array(rows, dtype=float),
                      yaml.safe_load(texts[f"{stem}.yaml"]))


def touches(mechanism: Mechanism, name: str, header: Sequence[str], rows: Array,
            sidecar: Mapping[str, Any]) -> Dataset:
    """Return the data set of rows (N, columns) with a header and a sidecar's content."""
    columns = dict(zip(header, rows.T, strict=True))
    return dataset_of(as_table(columns, (), name, LABELS.__contains__),
                      sidecar_of(sidecar, mechanism), name, mechanism)


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

    @property
    def _size(self) -> str:
        """What printers of either size agree with, and where distances are of a part, its own."""
        shrinks = f" (a printed part shrinks, to {SHRUNK[0]:g} to {SHRUNK[1]:g} of its length)"
        return self.printer.size and self.printer.size + shrinks * (self.scale == "printed")

    def headline(self) -> str:
        """Return what the file holds."""
        beds = "".join(f"; {len(m.rows)} touches of mesh {m.name}"
                       for m in self.printer.meshes)
        size = f"{self._size}." if self._size else ""
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
                "saved_off": dict(self.printer.off), "size": self._size or None,
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
