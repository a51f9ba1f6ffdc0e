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
from ppmcal.calibration.fit import FitOptions, Problem, identify
from ppmcal.calibration.validation import FrozenModel, validated
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


def in_mm(event: dict[str, Any]) -> dict[str, Any]:
    """Return an event whose carriages are counted in mm of travel, as an import counts them."""
    step = event["geometry_start"]["stepdists"]

    def travel(row: Sequence[float]) -> list[float]:
        return [row[0], *(s * step[i % 3] for i, s in enumerate(row[1:]))]

    start = {**event["geometry_start"], "stepdists": [1.0, 1.0, 1.0]}
    return {**event, "geometry_start": start, "heights": [travel(r) for r in event["heights"]],
            "distances": [travel(r) for r in event["distances"]]}


def config_text(event: dict[str, Any], rods: Sequence[float] | None) -> str:
    """Return the printer.cfg that an event stands for: rods as typed, the rest as it was saved.

    ``rods``: as their owner typed them, None where only the calibration says.
    """
    saved, start = event["geometry_saved"], event["geometry_start"]
    typed = rods if rods is not None or event["distances"] else start["arms"]
    lines = ["[printer]", "kinematics: delta"]
    for i, tower in enumerate("abc"):
        lines += [f"[stepper_{tower}]", f"step_distance: {start['stepdists'][i]!r}"]
        lines += [] if typed is None else [f"arm_length: {typed[i]!r}"]
    lines += ["[delta_calibrate]", "#*# [printer]", f"#*# delta_radius = {saved['radius']!r}"]
    for i, tower in enumerate("abc"):
        lines += [f"#*# [stepper_{tower}]", f"#*# angle = {saved['angles'][i]!r}",
                  f"#*# position_endstop = {saved['endstops'][i]!r}"]
        lines += [f"#*# arm_length = {saved['arms'][i]!r}"] if event["distances"] else []
    lines.append("#*# [delta_calibrate]")
    for n, (z, *steps) in enumerate(event["heights"]):
        lines += [f"#*# height{n} = {z!r}", f"#*# height{n}_pos = {_triple(steps)}"]
    for n, (distance, *steps) in enumerate(event["distances"]):
        lines += [f"#*# distance{n} = {distance!r}", f"#*# distance{n}_pos1 = {_triple(steps[:3])}",
                  f"#*# distance{n}_pos2 = {_triple(steps[3:])}"]
    return "\n".join(lines) + "\n"


def _triple(steps: Sequence[float]) -> str:
    return ",".join(repr(float(s)) for s in steps)


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
    typed = [float(r) for r in rods or event["geometry_start"]["arms"]]
    named = {**event, "geometry_start": {**event["geometry_start"], "arms": typed}}
    free = real_priors.machine(named, "single")[0]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "printer.cfg").write_text(config_text(event, rods), encoding="utf-8")
        ppmcal.import_config("klipper", folder / "printer.cfg").save(folder / "imported")
        machine = ppmcal.load(folder / "imported" / "machine.yaml")
        data = ppmcal.read_data(machine, *sorted((folder / "imported").glob("*s.csv")))
        own, verdict = ours(machine, data)
    out = [FrozenModel("nominal", free),
           FrozenModel("saved", real_priors.with_numbers(free, event["geometry_saved"])),
           FrozenModel("six", fitted(free, {**named, "distances": []}, "fixed"))]
    if event["distances"]:
        out.append(FrozenModel("nine", fitted(free, named, "single")))
    return [*out, *own], verdict


def fitted(machine: Mechanism, event: dict[str, Any], rods: str) -> Mechanism:
    """Return the machine with the firmware's parameters fitted without prior."""
    return real_priors.with_numbers(machine, real_deltas.geometry(real_deltas.fitted(event, rods)))


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
    all_events = [in_mm(json.loads(p.read_text(encoding="utf-8")))
                  for p in sorted(events.glob("*.json"))]
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
