"""What a calibration is worth on another day: every model's error on measurements it has not seen.

    python benchmarks/real_machines.py --data FOLDER

FOLDER holds ``stewart-jugglebot``, ``delta-events`` and ``delta-meshes``, which are not part of
the project. The rig's two days in both directions, and every printer's calibration on every later
bed of the same machine. Models: the nominal machine, what the firmware saved, its six parameters
fitted to the heights and its nine to heights and distances, all 48 of the rig (these without
prior), and what ``identify`` and ``diagnose`` make of the same files by default. Each is frozen; on
the other day only the frame is fitted (of a bed: height and tilt), of the rig also what
``validate`` finds the data to demand. All are judged by the same rows. mm rms; of the rig what the
measured body misses.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import real_deltas
import real_priors
import real_sessions

import ppmcal
from ppmcal.calibration.fit import FitOptions
from ppmcal.calibration.frozen_models import FrozenModel, validated
from ppmcal.calibration.identify import identify
from ppmcal.calibration.problem import Problem
from ppmcal.controllers.klipper_config import DeltaGeometry, Printer
from ppmcal.controllers.klipper_export import files, rods_of
from ppmcal.errors import PpmcalError
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

OURS = ("identify", "diagnose")
WITHIN = 1.05
"""As good as the best: within 5 %."""
ALIKE = 5.0
"""Rods of one machine differ by less between its files, mm."""


@dataclass(frozen=True)
class Row:
    """One calibration on one other day: error of each model, mm rms."""

    source: str
    target: str
    errors: dict[str, float]
    verdict: str

    @property
    def behind(self) -> float:
        """Error of ppmcal's default, what ``diagnose`` ends with, over the best of all."""
        return self.errors["diagnose"] / min(self.errors.values())


def printer_of(event: dict[str, Any], rods: Sequence[float] | None) -> Printer:
    """Return the printer as it was before the calibration, with what was measured."""
    start = event["geometry_start"]
    geometry = DeltaGeometry(start["radius"], tuple(start["angles"]), tuple(rods or start["arms"]),
                             tuple(start["endstops"]))
    return Printer(event["id"], geometry, tuple(start["stepdists"]),
                   tuple(map(tuple, event["heights"])), tuple(map(tuple, event["distances"])))


def typed_rods(event: dict[str, Any], others: Sequence[dict[str, Any]]) -> list[float] | None:
    """Return the rods that the owner typed, which the firmware has not fitted; None: not known.

    Its solver leaves rods alone where no distances were measured.
    """
    if not event["distances"]:
        return None
    known = [e["geometry_saved"]["arms"] for e in others if not e["distances"] and np.max(np.abs(
        np.subtract(e["geometry_saved"]["arms"], event["geometry_saved"]["arms"]))) < ALIKE]
    return known[0] if known else None


def models(event: dict[str, Any], rods: Sequence[float] | None) -> tuple[list[FrozenModel], str]:
    """Return the frozen machines that one calibration leads to, and the verdict of ``diagnose``."""
    printer = printer_of(event, rods)
    start = {**event["geometry_start"], "arms": printer.geometry.arms}
    named = {**event, "geometry_start": start}
    with tempfile.TemporaryDirectory() as name:
        free, _ = imported(Path(name), printer, "single")
        machine, data = imported(Path(name), printer, rods_of(printer, None))
        own, verdict = ours(machine, data)
    out = [FrozenModel("nominal", machine),
           FrozenModel("saved", with_numbers(free, event["geometry_saved"])),
           FrozenModel("six", fitted(free, {**named, "distances": []}, "fixed"))]
    if event["distances"]:
        out.append(FrozenModel("nine", fitted(free, named, "single")))
    return [*out, *own], verdict


def imported(folder: Path, printer: Printer, rods: str) -> tuple[Mechanism, Sequence[Dataset]]:
    """Return machine and measurements as ``import klipper`` writes them."""
    for file, text in files(printer, rods).items():
        (folder / file).write_text(text, encoding="utf-8")
    machine = ppmcal.load(folder / "machine.yaml")
    return machine, ppmcal.read_data(machine, *sorted(folder.glob("*s.csv")))


def fitted(machine: Mechanism, event: dict[str, Any], rods: str) -> Mechanism:
    """Return the machine with the firmware's parameters fitted without prior."""
    return with_numbers(machine, real_deltas.geometry(real_deltas.fitted(event, rods)))


def with_numbers(machine: Mechanism, geometry: dict[str, Any]) -> Mechanism:
    """Return the machine with the firmware's numbers, mm and degrees."""
    v = dict(zip(machine.names, machine.values.tolist(), strict=True))
    v["delta_radius"] = 1e-3 * geometry["radius"]
    for t, angle, arm, end in zip("abc", geometry["angles"], geometry["arms"],
                                  geometry["endstops"], strict=True):
        v[f"{t}.base.point.angle"] = float(np.radians(angle))
        v[f"{t}.length"] = 1e-3 * arm
        v[f"{t}.offset"] = 1e-3 * (end + float(np.sqrt(arm**2 - geometry["radius"] ** 2)))
    return machine.with_values(np.array([v[n] for n in machine.names]))


def ours(machine: Mechanism, data: Sequence[Dataset]) -> tuple[list[FrozenModel], str]:
    """Return what ``identify`` and ``diagnose`` make of a calibration; refused: as it was."""
    out, verdict = [], ""
    for name in OURS:
        try:
            found = getattr(ppmcal, name)(machine, data)
        except PpmcalError as error:
            out.append(FrozenModel(name, machine))
            verdict = f"refused: {error}"[:60]
            continue
        out.append(FrozenModel(name, real_sessions.without_events(found.mechanism)))
        if name == "diagnose":
            verdict = found.headline()
    return out, verdict


def row(source: str, target: Dataset, frozen: Sequence[FrozenModel], verdict: str) -> Row:
    """Return the errors of frozen machines on another day."""
    (found,) = validated(frozen, (target,))
    errors = {e.label: 1e3 * e.position["rms"] for e in found.errors}
    return Row(source, target.name, errors, verdict)


def printers(events: Path, meshes: Path) -> Iterator[Row]:
    """Yield every calibration on every later bed of the same machine."""
    all_events = [json.loads(p.read_text(encoding="utf-8")) for p in sorted(events.glob("*.json"))]
    for event in all_events:
        owner = event["id"].split("_")[1]
        mine = [e for e in all_events if e["id"].split("_")[1] == owner]
        rods = typed_rods(event, mine)
        beds = [(p, m) for p in sorted(meshes.glob(f"*_{owner}_*.json"))
                for m in [json.loads(p.read_text(encoding="utf-8"))] if later(event, m)]
        if not beds:
            continue
        frozen, verdict = models(event, rods)
        for path, mesh in beds:
            data = real_priors.bed_of(path, mesh, event)
            yield row(event["id"], replace(data, name=mesh["id"].split("_")[0], columns={
                "dir_x": real_sessions.ways(path)}), frozen, verdict)


def later(event: dict[str, Any], mesh: dict[str, Any]) -> bool:
    """Return whether a bed was probed after a calibration of the same machine."""
    when = "".join(c for c in event["source"]["committed"][:19] if c.isdigit())
    then = "".join(mesh["id"].split("_")[2:4])
    rods = np.subtract(mesh["active_geometry"]["arms"], event["geometry_saved"]["arms"])
    return when <= then and float(np.max(np.abs(rods))) < ALIKE


def rig(folder: Path) -> Iterator[Row]:
    """Yield the rig's two days in both directions."""
    with tempfile.TemporaryDirectory() as name:
        machine, days = real_sessions.written_rig(folder, Path(name))
        for one, other in (days, days[::-1]):
            found, verdict = ours(machine, [one])
            flat = identify(Problem(machine, (one,), machine.free), FitOptions(method="flat"))
            frozen = [FrozenModel("nominal", machine),
                      FrozenModel("flat", machine.with_values(flat.state.g)), *found]
            yield row(one.name, other, frozen, verdict)


def show(rows: Iterator[Row]) -> list[Row]:
    """Print rows as they come; return them."""
    names = ("nominal", "saved", "six", "nine", "flat", *OURS)
    print(f"{'calibrated by':18s} {'error on':10s} " + " ".join(f"{n:>8s}" for n in names)
          + "  over best   what diagnose says", flush=True)
    done = []
    for r in rows:
        cells = " ".join(f"{r.errors[n]:8.4f}" if n in r.errors else f"{'':8s}" for n in names)
        print(f"{r.source:18s} {r.target:10s} {cells}  {r.behind:6.3f} "
              f"{' ' if r.behind <= WITHIN else '*'}    {r.verdict}", flush=True)
        done.append(r)
    return done


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--only", choices=("rig", "printers"))
    given = parser.parse_args()
    if not given.data.is_dir():
        print(f"skipped: the measurements are not here ({given.data})")
        return
    done = [] if given.only == "printers" else show(rig(given.data / "stewart-jugglebot"))
    if given.only != "rig":
        done += show(printers(given.data / "delta-events", given.data / "delta-meshes"))
    short = [r for r in done if r.behind > WITHIN]
    print(f"\nbest, or within {100 * (WITHIN - 1):.0f} % of the best: {len(done) - len(short)} of "
          f"{len(done)}; * is not")


if __name__ == "__main__":
    main()
