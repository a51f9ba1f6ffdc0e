"""What the beds of one printer say one by one, and together.

    python benchmarks/same_printer.py --data FOLDER

FOLDER holds ``delta-events`` and ``delta-meshes``, which are not part of the project. Each bed is
diagnosed with the printer as its calibration before it was saved, the way of the head before each
touch known, the noise estimated; then all beds of the printer together, each a session with a flat
of its own. A row for each: touches, the noise that was found, verdict, what is named with its size,
and what is there without a name.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import real_machines
import real_priors
import real_sessions

from ppmcal.calibration.fit import Problem
from ppmcal.diagnosis.diagnose import DiagnosisOptions
from ppmcal.diagnosis.own_noise import diagnose_with_own_noise
from ppmcal.diagnosis.result import Diagnosis, NamedEffect
from ppmcal.errors import PpmcalError
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism


def bed(folder: Path, path: Path) -> tuple[Mechanism, Dataset] | None:
    """Return the printer as it was saved before a bed was probed, and the bed's touches.

    None where no calibration of it is there.
    """
    mesh = json.loads(path.read_text(encoding="utf-8"))
    saved = real_priors.in_use(mesh, folder / "delta-events")
    if saved is None:
        return None
    event = real_machines.in_mm(saved)
    data = real_priors.bed_of(path, mesh, event)
    return real_priors.machine(event, "fixed")[0], replace(
        data, name=path.stem, estimated=True, columns={"dir_x": real_sessions.ways(path)})


def told(found: Diagnosis) -> str:
    """Return what was named with its size, in mm or mrad, and what cannot be told from it."""
    fit = found.identification.fit
    names = fit.problem.mechanism.names

    def one(effect: NamedEffect) -> str:
        sizes = ", ".join(f"{n.rsplit('.', 1)[-1]} {1e3 * fit.state.g[names.index(n)]:.3f}"
                          for n in effect.parameters)
        tied = f" or {', '.join(effect.alternatives)}" if effect.alternatives else ""
        return f"{effect.kind} on {' '.join(effect.on) or 'all'} ({sizes}){tied}"

    return "; ".join(map(one, found.effects)) or "-"


def row(name: str, machine: Mechanism, beds: Iterable[Dataset]) -> str:
    """Return the line of one bed, or of several together."""
    data = tuple(beds)
    touches = sum(len(d) for d in data)
    try:
        found, _ = diagnose_with_own_noise(Problem(machine, data, machine.free), DiagnosisOptions())
    except PpmcalError as error:
        return f"| {name} | {touches} | - | refused: {error.what} | - | - |"
    noise = np.mean([d.sigma_value[0] for d in found.identification.fit.problem.datasets])
    other = ", ".join(u.looks_like for u in found.unknown) or "-"
    return (f"| {name} | {touches} | {1e3 * noise:.4f} | {found.verdict} | {told(found)} "
            f"| {other} |")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--printers", nargs="*", help="owners  [default: all]")
    given = parser.parse_args()
    paths = sorted((given.data / "delta-meshes").glob("*.json"))
    owners = dict.fromkeys(p.stem.split("_")[1] for p in paths)
    print("| bed | touches | noise, mm | verdict | named (mm, mrad) | without a name |")
    print("|---|---|---|---|---|---|")
    for owner in owners:
        if given.printers and owner not in given.printers:
            continue
        own = [(p, bed(given.data, p)) for p in paths if f"_{owner}_" in p.stem]
        beds = [(p, *found) for p, found in own if found is not None]
        for path, machine, data in beds:
            print(row(path.stem[:22], machine, [data]), flush=True)
        if len(beds) > 1:
            print(row(f"{owner}, all", beds[-1][1], [d for *_, d in beds]), flush=True)


if __name__ == "__main__":
    main()
