"""Readers: each writes the files of a case as the tool, and any other one, reads them.

A mechanism file and one table with its sidecar for each instrument. What is known of the formats of
the printers, belts and rigs stands in the studies of this folder's parent; it is used from there.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import real_belts
import real_priors
import real_stewart
import yaml
from real_deltas import mechanism_text, write_data

import ppmcal
from labelled.cases import Case, injected
from ppmcal.errors import BadInput

Geometry = dict[str, Any]


@dataclass(frozen=True)
class Files:
    """The files of a case: a mechanism, and tables with their sidecars beside them."""

    mechanism: Path
    tables: tuple[Path, ...]


def written(case: Case, root: Path, folder: Path) -> Files:
    """Write the files of a case into an empty folder, with what was injected by hand."""
    if case.reader not in READERS:
        raise BadInput(f"{case.id}: no reader is called {case.reader}", "reader",
                       "one of " + ", ".join(READERS))
    paths = case.files(root)
    folder.mkdir(parents=True, exist_ok=True)
    made = READERS[case.reader](paths, folder, case.options)
    if case.inject:
        injected(case, made.tables)
    return made


def belts(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Write one run of a router on four belts; ``options``: the frame's sides, mm."""
    with paths[0].open(encoding="utf-8", newline="") as stream:
        rows = list(csv.reader(stream))
    machine = real_belts.machine(tuple(options.get("sides", (3030.0, 2140.0))))
    (folder / "machine.yaml").write_text(yaml.safe_dump(machine), encoding="utf-8")
    table = folder / "belts.csv"
    header = ",".join(f"q_{name}" for name in rows[0])
    table.write_text("\n".join([header, *(",".join(r) for r in rows[1:])]) + "\n",
                     encoding="utf-8")
    side = {"format": "ppmcal/dataset/1", "name": "belts", **real_belts.SIDE}
    table.with_suffix(".yaml").write_text(yaml.safe_dump(
        {**side, "frame": "known", "target": "known"}), encoding="utf-8")
    return Files(folder / "machine.yaml", (table,))


def event(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Write a printer's own calibration: heights, and distances by caliper where it has them.

    ``options``: ``geometry: saved``, the numbers that the file ends with, all fixed and each with
    a tolerance, so that what differs from them can be asked; else those that it began with.
    ``rods``: ``fixed`` or ``single``.
    """
    tree = json.loads(paths[0].read_text(encoding="utf-8"))
    saved = options.get("geometry") == "saved"
    geometry = tree["geometry_saved" if saved else "geometry_start"]
    _printer(folder, geometry, str(options.get("rods", "fixed")), saved)
    tables = write_data(folder, tree)
    for table in tables:
        estimated(table)
    return Files(folder / "machine.yaml", tuple(tables))


def bed(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Write a probed bed, with the way of the head along x before each touch."""
    mesh = json.loads(paths[0].with_suffix(".json").read_text(encoding="utf-8"))
    with paths[0].with_suffix(".csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    _printer(folder, mesh["active_geometry"], "fixed", False)
    table = folder / "bed.csv"
    columns = ["probe_z_offset_mm", *(f"stepper_{t}_usteps" for t in "abc"), "approach_dir_x"]
    table.write_text("\n".join(["height,q_a,q_b,q_c,dir_x", *(
        ",".join(r[c] for c in columns) for r in rows)]) + "\n", encoding="utf-8")
    _side(table, {"kind": "plane", "sigma": {"height": 0.02, "estimated": True}}, "unknown")
    return Files(folder / "machine.yaml", (table,))


def rostock(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Write many touches of one bed; every slot that the firmware has not is fixed."""
    tree = real_priors.rostock_event(paths[0])
    _printer(folder, tree["start"], "fixed", False, float("inf"))
    tables = write_data(folder, tree)
    estimated(tables[0])
    return Files(folder / "machine.yaml", tuple(tables))


def _printer(folder: Path, geometry: Geometry, rods: str, fixed: bool,
             endstops: float | None = None) -> None:
    """Write a linear delta with the tolerances that an import gives it."""
    tree = yaml.safe_load(mechanism_text(geometry, rods))
    tree["tolerances"] = real_priors.TOLERANCES | (
        {} if endstops is None else {"offset": endstops})
    for limb in tree["limbs"]:
        limb["base"]["direction"] = {"value": [0, 0, 1], "tolerance": 0.3, "fixed": True}
        if fixed:
            limb["length"] = {"value": limb["length"]["value"], "tolerance": 1.0}
    if fixed:
        tree["free"] = []
    (folder / "machine.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")


def _side(table: Path, instrument: dict[str, Any], frame: str) -> None:
    table.with_suffix(".yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "name": table.stem,
        "units": {"length": "mm", "angle": "deg"}, "instrument": instrument, "frame": frame,
        "target": "known"}), encoding="utf-8")


def estimated(table: Path) -> None:
    """Say in a sidecar that the noise is to be estimated: nobody wrote it down."""
    side = yaml.safe_load(table.with_suffix(".yaml").read_text(encoding="utf-8"))
    side["instrument"]["sigma"]["estimated"] = True
    table.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")


def rig(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Write one day of the six-leg rig, its nominal geometry beside it."""
    (folder / "machine.yaml").write_text(real_stewart.mechanism_text(paths[0].parent),
                                         encoding="utf-8")
    table = folder / "poses.csv"
    text = paths[0].read_text(encoding="utf-8")
    names = {"meas_pos": "position", "meas_ori": "orientation"}
    header, rest = text.split("\n", 1)
    header = re.sub("|".join(names), lambda m: names[m[0]], header)
    kept = [i for i, c in enumerate(header.split(",")) if not c.startswith("cmd_")]
    lines = [[line.split(",")[i] for i in kept] for line in [header, *rest.splitlines()] if line]
    table.write_text("\n".join(",".join(x) for x in lines) + "\n", encoding="utf-8")
    table.with_suffix(".yaml").write_text(real_stewart.sidecar("poses"), encoding="utf-8")
    return Files(folder / "machine.yaml", (table,))


def klipper(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Write what `ppmcal import klipper` makes of a printer's file; ``options``: mesh, tables."""
    out = folder / "imported"
    ppmcal.import_config("klipper", paths[0], mesh=options.get("mesh")).save(out)
    stems = options.get("tables") or sorted(p.stem for p in out.glob("*.csv"))
    return Files(out / "machine.yaml", tuple(out / f"{s}.csv" for s in stems))


def files(paths: list[Path], folder: Path, options: Mapping[str, Any]) -> Files:
    """Copy a case that is in the tool's own files: the mechanism first, then tables."""
    for path in paths:
        for one in (path, path.with_suffix(".yaml")):
            if one.exists():
                shutil.copyfile(one, folder / one.name)
    tables = tuple(folder / p.name for p in paths[1:])
    if not tables:
        raise BadInput("a case of files has a mechanism and at least one table", str(paths[0]),
                       "name the mechanism first in data")
    return Files(folder / paths[0].name, tables)


READERS: dict[str, Callable[[list[Path], Path, Mapping[str, Any]], Files]] = {
    "belts": belts, "event": event, "bed": bed, "rig": rig, "rostock": rostock,
    "klipper": klipper, "files": files}
