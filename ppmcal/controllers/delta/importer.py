"""The import of a delta printer, from any firmware that has a reader of its configuration."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ppmcal.calibration.fit import Z95, Problem, unfitted
from ppmcal.calibration.knowledge import tilt_sentences
from ppmcal.calibration.validation import DEFINITION, before
from ppmcal.controllers.delta.geometry import SMALLEST, TOWERS, DeltaGeometry
from ppmcal.controllers.delta.printer import (
    JOINT,
    TILTING,
    Effector,
    Nominal,
    Printer,
    PrinterReader,
    beside,
    by_probe_and_nozzle,
    effector_of,
    offsets,
    refuse_effector,
    six_limbs,
)
from ppmcal.controllers.importing import MACHINE, Imported, machine_head, sidecar
from ppmcal.errors import BadInput, PpmcalError, unknown
from ppmcal.io import csv_text, read_mechanism
from ppmcal.io.column_names import LABELS
from ppmcal.io.csv import csv_table
from ppmcal.io.dataset_reader import dataset_of
from ppmcal.io.results.identification_parts import summaries
from ppmcal.io.sidecar import sidecar_of
from ppmcal.io.tables import as_table
from ppmcal.linalg import Array
from ppmcal.model.dataset import Dataset
from ppmcal.model.limbs.spatial import PUS
from ppmcal.model.mechanism import Mechanism
from ppmcal.notes import NOTE, Note
from ppmcal.wording import number, pluralize

NOZZLE = "translational             # a pose is x, y, z of the nozzle, the bed is z = 0"
HEIGHT = ("height", *(f"q_{t}" for t in TOWERS))
DISTANCE = ("distance", *HEIGHT[1:], *(f"to_{c}" for c in HEIGHT[1:]))
"""Columns of a table of touches, and of one of distances between two places."""
KNOWN = "known"
JOINTS = "where the carriages were"
HEIGHT_SIGMA = 0.02
DISTANCE_SIGMA = 0.05
LEAN = 0.2
"""Tolerance of a tower's direction, degrees."""
SHRUNK = (0.992, 0.998)
"""Lengths of a printed part over those between the nozzle's places: ends of a 95 % interval."""
SCALES = ("printed", "known", "unknown")
"""What measured distances are: those of a printed part, true, or off by any factor."""
RODS = ("fixed", "shared", "single")
LONGEST = 1e5
"""No rod is longer, and no radius, mm."""


@dataclass(frozen=True)
class ImportedPrinter(Imported):
    """A printer and its measurements.

    ``printer``: what the controller's file says, mm and degrees.
    """

    printer: Printer = field(kw_only=True)


def printer_importer(read: PrinterReader) -> Callable[[Path, Mapping[str, Any]], ImportedPrinter]:
    """Return the ``import_config`` of a firmware, :class:`ppmcal.controllers.importing.Importer`.

    What the printer saved of an earlier calibration is a result: the machine has the numbers in
    the body of the file, also where they are commented out.
    """
    def import_config(path: Path, options: Mapping[str, Any]) -> ImportedPrinter:
        scale, radius, mesh = options["scale"], options["radius"], options.get("mesh", ())
        if scale not in SCALES:
            raise unknown("scale of distances", scale, SCALES, "--scale")
        effector = effector_of(options["effector"])
        length, chosen = _rods(options["rods"])
        if radius is not None and not SMALLEST <= radius < LONGEST:
            raise BadInput(f"{radius} is not a radius in mm", "--radius",
                           "Give it from the joints at a tower to those at the effector, such as "
                           "--radius 140")
        meshes = [str(m) for m in ([mesh] if isinstance(mesh, str | os.PathLike) else mesh)]
        printer = read(path, length, meshes, radius)
        findings = list(printer.findings)
        if effector is not None:
            findings += refuse_effector(effector, printer.nominal.geometry.radius)
        if printer.distances and scale == "known" and not printer.nominal.rods_known:
            findings.append(Note("the distances alone hold the size: where the part that they were "
                                 "measured on has shrunk by 0.3 %, rods of 300 mm come out 1 mm "
                                 "short"))
        # touches hardly tell the length of rods: else as many lengths as the file has
        rods = chosen or ("shared" if len(set(printer.nominal.geometry.arms)) == 1 else "single")
        inputs = (*printer.included, *(m for m in meshes if Path(m).is_file()))
        return _imported(path, printer, rods, scale, chosen is None, tuple(findings), inputs,
                         effector)

    return import_config


def _imported(path: Path, printer: Printer, rods: str, scale: str, choose: bool,
              findings: tuple[Note, ...], inputs: tuple[str, ...], effector: Effector | None
              ) -> ImportedPrinter:
    """Return a printer's files, and what is said of them."""
    texts = files(printer, rods, scale, choose, effector)
    problem = _problem(texts)
    errors = printer_before(problem)
    findings += tuple(_tilt(problem, printer, effector))
    beds = "".join(f"; {len(m.rows)} touches of mesh {m.name}" for m in printer.meshes)
    size = printer.size
    if size and scale == "printed":
        size += f" (a printed part shrinks, to {SHRUNK[0]:g} to {SHRUNK[1]:g} of its length)"
    sentence = (f"{path}: a delta printer with {pluralize(len(printer.heights), 'height')} and "
                f"{pluralize(len(printer.distances), 'distance')}{beds}; "
                f"{'six ' * (effector is not None)}rods {rods}. "
                f"{before_sentence(errors)} {f'{size}.' if size else ''}").strip()
    entries = {
        "heights": len(printer.heights), "distances": len(printer.distances),
        "meshes": {m.name: len(m.rows) for m in printer.meshes},
        "rods": rods, "scale": scale if printer.distances else None,
        **({"effector": {"radius": effector.radius, "spacing": effector.spacing},
            "probe": list(printer.probe)} if effector else {}),
        "nominal": printer.nominal.geometry.named(), "nominal_from": printer.nominal.origin,
        "saved": printer.calibration.named() if printer.calibrated else None,
        "saved_off": dict(printer.off), "size": size or None, "before": dict(errors)}
    return ImportedPrinter(texts, sentence, entries, findings, inputs, printer=printer)


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
            if str(one)[:1].isdigit():
                raise BadInput(f"'{one}' is not a number", "--rods",
                               "Give the length in mm without a unit, such as --rods 345") from None
            raise unknown("way to take rods", one, RODS, "--rods") from None
        if not 0.0 < length < LONGEST:
            raise BadInput(f"{one} is not a rod length in mm", "--rods",
                           "Give it from bearing to bearing, such as --rods 345")
    return length, word


def _one_session(table: str) -> str:
    """Return a table with a column that makes it one session with the others of the import."""
    header, *rows = table.splitlines()
    return "\n".join([f"{header},session", *(f"{row},calibration" for row in rows)]) + "\n"


def _scale_line(scale: str) -> str:
    """Return the sidecar's line on the scale of measured distances, of :data:`SCALES`.

    Rods and scale are one direction. Neither a length on a drawing nor a part outweighs the
    other: each counts by how well it is known.
    """
    if scale != "printed":
        return f"scale: {scale}    # of all these distances\n"
    low, high = SHRUNK
    value, sigma = round((low + high) / 2.0, 4), round((high - low) / (2.0 * Z95), 4)
    least, most = (100.0 * (1.0 - part) for part in reversed(SHRUNK))
    return (f"# Plastic shrinks: in 95 of 100 printed parts all lengths are {least:.1f} to "
            f"{most:.1f} % too small.\nscale: {{value: {value:g}, sigma: {sigma:g}}}"
            "    # where you know better, write it here\n")


def files(printer: Printer, rods: str, scale: str = "known", choose: bool = False,
          effector: Effector | None = None) -> dict[str, str]:
    """Return file name -> text of everything that the import writes.

    ``choose``: whether freedoms are left to what predicts best; ``effector``: of six rods.
    """
    more = _OPTIONAL if choose and printer.distances and printer.nominal.rods_known else ""
    out = {MACHINE: machine_yaml(printer, rods, effector) + more}
    if printer.calibrated:
        out["saved.yaml"] = saved_yaml(printer, rods, effector)
    target = KNOWN if effector is None else beside(printer.probe)
    heights, by_nozzle = (printer.heights, ()) if target == KNOWN else by_probe_and_nozzle(printer)
    out |= touch_files(heights, printer.distances, JOINTS, target)
    if by_nozzle:
        out |= _table("nozzle_heights", "plane", HEIGHT, by_nozzle, HEIGHT_SIGMA,
                      f"# Touches of the nozzle itself: its height above the bed, and {JOINTS}.")
        out |= {name: _one_session(text) for name, text in out.items() if name.endswith(".csv")}
    if printer.distances:
        out["distances.yaml"] += _scale_line(scale)
    for mesh in printer.meshes:
        out |= _table(f"mesh_{mesh.name}", "plane", (*HEIGHT, "dir_x"), mesh.rows, HEIGHT_SIGMA, (
            "# Touches of a bed in their order; how high it lies and how it is tilted is not known."
            "\n# Carriages are where the numbers in the configuration put them: it has to hold "
            "those\n# that the bed was probed with."), "unknown", target)
    return out


def touch_files(heights: Sequence[Sequence[float]], distances: Sequence[Sequence[float]],
                joints: str, target: str = KNOWN) -> dict[str, str]:
    """Return tables and sidecars of heights and distances.

    ``joints``: what else rows say; ``target``: of heights, in platform axes, as a sidecar has it.
    """
    out = dict[str, str]()
    if heights:
        out |= _table("heights", "plane", HEIGHT, heights, HEIGHT_SIGMA,
                      f"# Touches: the nozzle's true height above the bed, and {joints}.",
                      target=target)
    if distances:
        out |= _table("distances", "distance", DISTANCE, distances, DISTANCE_SIGMA,
                      "# Distances on a printed part between two nozzle positions.")
    return out


def _table(name: str, kind: str, columns: Sequence[str], rows: Sequence[Sequence[float]],
           sigma: float, comment: str, frame: str = KNOWN, target: str = KNOWN
           ) -> dict[str, str]:
    """Return a table of touches, or of distances, and its sidecar below a comment."""
    return {f"{name}.csv": csv_text(columns, list(np.array(rows, dtype=float).T)),
            f"{name}.yaml": sidecar(comment, name, kind, {columns[0]: sigma}, sigma,
                                    f"frame: {frame}\ntarget: {target}"
                                    f"{_BESIDE * (target != KNOWN)}\n")}


def machine_yaml(printer: Printer, rods: str, effector: Effector | None = None) -> str:
    """Return the printer as it was meant to be, a commented mechanism file.

    A carriage is at u = offset - travel, offset = position_endstop +
    sqrt(arm_length^2 - delta_radius^2), and the machine closes where the arm from there ends.
    ``effector``: of six rods, None for three, of which it stays level.
    """
    nominal = printer.nominal
    origin = ", ".join(f"{what}: {where}" for what, where in nominal.origin.items())
    angles = ", ".join(f"{t} {a:g}" for t, a in zip(TOWERS, nominal.geometry.angles, strict=True))
    head = f"""\
# A linear delta printer, as it was meant to be before any calibration. Where its numbers are
# from: {origin}; angles {angles}.
{_LEVEL if effector is None else _SIX} Rods: {_RODS[rods]}
{machine_head(f"delta printer of {Path(printer.source).name}",
              NOZZLE if effector is None else TILTING)}limbs:
"""
    limbs = "".join(_tower(printer, i, rods) for i in range(3)) if effector is None else six_limbs(
        printer, rods, effector, _size(nominal.radius), LEAN)
    turn, point, what = ("", _size(nominal.radius), "delta_radius") if effector is None else (
        ", rx: 0, ry: 0, rz: 0", f"{JOINT:g}", "a rod's joint")
    tail = f"""\
home: {{pose: {{x: 0, y: 0, z: 0{turn}}}}}
# one standard deviation each of: {what}, angles, offset (endstops and rods), rods
tolerances: {{point: {point}, angle: 0.5, offset: {_size(_offset_tolerance(nominal))}, \
length: {_size(nominal.rods)}}}
"""
    return head + limbs + tail


def _offset_tolerance(nominal: Nominal) -> float:
    """Return the tolerance of offset, mm: the endstop's, and what a longer rod adds to it."""
    arm, radius = max(nominal.geometry.arms), nominal.geometry.radius
    longer = nominal.rods * arm / math.sqrt(arm**2 - radius**2)
    return math.ceil(10.0 * math.hypot(nominal.offset, longer)) / 10.0 if math.isfinite(
        nominal.offset) else nominal.offset


def _size(tolerance: float) -> str:
    return f"{tolerance:g}" if math.isfinite(tolerance) else ".inf"


def saved_yaml(printer: Printer, rods: str, effector: Effector | None = None) -> str:
    """Return the printer with the numbers that it saved itself, to compare with."""
    own = replace(printer, nominal=replace(printer.nominal, geometry=printer.calibration))
    each = "single" if rods == "shared" and len(set(printer.calibration.arms)) > 1 else rods
    text = machine_yaml(own, each, effector)
    return ("# With the numbers that the printer saved itself: a result, to be compared with\n"
            "# (`ppmcal validate identified DATA --against saved.yaml`), never a nominal.\n"
            + text[text.index("format:"):])


_LEVEL = """\
# Only the difference of tower radius and effector radius shows, so the former is delta_radius
# and the latter 0."""
_SIX = """\
# Six rods, two to a tower: where the two differ, the effector tilts. tower_radius is the radius of
# the joints at the carriages, delta_radius and the effector's together."""
_BESIDE = "    # the probe, from the nozzle: the effector carries it where it tilts"
_OPTIONAL = """\
# identify takes these, or leaves them, by what predicts touches and distances left out
# (`--free` chooses by hand): the rods' lengths, then towers that lean
optional: [["*.length"], ["*.base.direction.*"]]
"""
_RODS = {"fixed": "fixed,\n# as if they were known exactly.",
         "shared": "one length for\n# all, fitted; it takes distances to know it.",
         "single": "one length for\n# each tower, fitted; it takes distances to know them."}


def _tower(printer: Printer, i: int, rods: str) -> str:
    g: DeltaGeometry = printer.nominal.geometry
    arm, angle = g.arms[i], g.angles[i]
    end = {"fixed": ", fixed: true", "shared": ", share: rod", "single": ""}[rods]
    held = ", fixed: true" if i == 2 else ""
    why = "    # holds the x and y axes" if i == 2 else ""
    return f"""\
  - name: {TOWERS[i]}
    kind: {PUS.name}
    base:
      point:
        radius: {{share: delta_radius, value: {g.radius!r}}}
        angle: {{value: {angle!r}{held}}}{why}
        z: {{value: 0, fixed: true}}    # an error here is one of offset
      direction: {{value: [0, 0, 1], fixed: true, tolerance: {LEAN}}}    # free: it leans
    platform:
      point: {{value: [0, 0, 0], fixed: true}}
    length: {{value: {arm!r}{end}}}
    ratio: -1    # q is travel down from the endstop in mm, whatever the microsteps
    offset: {offsets(g)[i]!r}    # position_endstop + sqrt(arm_length^2 - delta_radius^2)
    branch: 1
"""


def _problem(texts: Mapping[str, str]) -> Problem | None:
    """Return machine.yaml with the touches beside it, of texts by file name; None without any."""
    try:
        mechanism = read_mechanism(yaml.safe_load(texts[MACHINE]))
        sets = tuple(_datasets(texts, mechanism))
    except PpmcalError:
        return None    # what is wrong with them identify says, with the place in its file
    return Problem(mechanism, sets, mechanism.free) if sets else None


def printer_before(problem: Problem | None) -> dict[str, object]:
    """Return the errors of a machine on its touches, as `identify` says ``before``.

    Returns:
        ``definition``, and by data set ``rms``, ``p95`` ... and ``unit``; empty without touches, or
        where the machine reaches none of them.
    """
    if problem is None:
        return {}
    sets = problem.datasets
    try:
        errors = before(replace(problem, free=()),
                        [np.ones(len(d), dtype=bool) for d in sets]).residuals
    except PpmcalError:
        return {}
    out: dict[str, object] = {}
    for i, data in enumerate(sets):
        rows = [np.full(len(d), i == j) for j, d in enumerate(sets)]
        found = summaries(errors.figures(rows), problem.mechanism.units).get("position")
        if found is not None:
            out[data.name] = found.entries(whole=True)
    return {"definition": DEFINITION, **out} if out else {}


def _tilt(problem: Problem | None, printer: Printer, effector: Effector | None) -> Iterator[Note]:
    """Yield what touches beside the nozzle tell of an effector that tilts."""
    x, y = printer.probe
    if effector is None:
        if math.hypot(x, y) > 0.0 and (printer.heights or printer.meshes):
            yield Note(f"the probe stands {x:g}, {y:g} mm beside the nozzle: where the effector "
                       "tilts, heights are not the nozzle's. --effector RADIUS,SPACING imports six "
                       "rods, and says what they tell of it", NOTE)
    elif not printer.probed:
        yield Note("no section of a probe stands in the file: heights count as the nozzle's own",
                   NOTE)
    elif problem is not None:
        try:
            yield from tilt_sentences(unfitted(problem), fitted=False)
        except PpmcalError:
            return


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
        table = csv_table(text.encode(), stem, LABELS.__contains__).without(LABELS)
        yield dataset_of(table, sidecar_of(yaml.safe_load(texts[f"{stem}.yaml"]), mechanism), stem,
                         mechanism)


def touches(mechanism: Mechanism, name: str, header: Sequence[str], rows: Array,
            sidecar: Mapping[str, Any]) -> Dataset:
    """Return the data set of rows (N, columns) with a header and a sidecar's content."""
    columns = dict(zip(header, rows.T, strict=True))
    return dataset_of(as_table(columns, (), name, LABELS.__contains__),
                      sidecar_of(sidecar, mechanism), name, mechanism)
