"""Does what `diagnose` finds on one day, event or bed of a real machine hold on another?

    python benchmarks/real_sessions.py --data FOLDER

FOLDER holds ``stewart-jugglebot``, ``delta-meshes``, ``delta-events`` and ``delta-rostock``, which
are not part of the project. Each campaign is diagnosed alone; the others of the same machine are
then predicted without effects, with what was named, and with what was learned too. Only the
frame is fitted anew (of a bed: height and tilt). Events (a zero lost in row 76) belong to their own
campaign and are not carried over. Of the rig figures are leg residuals, of beds touches; mm rms:
of all rows, the frame fitted to what no robust fit calls an outlier; and of those rows that the
other campaign's own fit uses, the frame fitted to just these, so that all models have the same.
"""

from __future__ import annotations

import argparse
import itertools
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import real_priors
import real_stewart

from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify
from ppmcal.calibration.validation import residuals
from ppmcal.diagnosis.diagnose import diagnose
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.linalg import Bools, finite_rows
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

PARTS = 2
"""A machine with one campaign is tested on every other touch."""


@dataclass(frozen=True)
class Carried:
    """What one campaign says of another, mm rms: without effects, with named, with learned.

    ``figures`` of all rows, ``same`` of the rows of the other campaign's own fit.
    """

    source: str
    target: str
    verdict: str
    named: tuple[str, ...]
    learned: int
    figures: tuple[float, ...]
    same: tuple[float, ...]


def carried(found: Diagnosis, source: Dataset, target: Dataset, own: Bools) -> Carried:
    """Return how what was found in ``source`` predicts ``target``; ``own``: rows it fits itself."""
    named = found.learned.without if found.learned else found.identification.fit
    named = named if found.effects else found.before
    models = (found.before, named, found.identification.fit)
    return Carried(source.name, target.name, found.verdict,
                   tuple(dict.fromkeys(e.kind for e in found.effects)),
                   len(found.learned.learned.terms) if found.learned else 0,
                   tuple(on(m, target) for m in models),
                   tuple(on(m, target.take(own), robust=False) for m in models))


def on(fit: Fit, target: Dataset, robust: bool = True) -> float:
    """Return the residual of another campaign with a fitted machine, mm rms; frame anew."""
    machine = without_events(fit.problem.mechanism.with_values(fit.state.g))
    anew = identify(Problem(machine, (target,), ()), FitOptions(method="flat", robust=robust))
    if target.kind.sees_rotation:
        return real_stewart.leg_rms(anew.problem, anew.state)
    error = residuals(anew.problem, anew.state).position[0][finite_rows(anew.state.poses[0])]
    return 1e3 * float(np.sqrt(np.mean(error**2)))


def without_events(mechanism: Mechanism) -> Mechanism:
    """Return the machine without what happened in one row of one campaign."""
    return replace(mechanism, effects=tuple(e for e in mechanism.effects if not e.kind.onset))


def both_ways(mechanism: Mechanism, days: Sequence[Dataset]) -> list[Carried]:
    """Return how each campaign predicts each other one."""
    found = [diagnose(Problem(mechanism, (d,), mechanism.free)) for d in days]
    return [carried(found[i], days[i], days[j], found[j].before.keep[0])
            for i, j in itertools.permutations(range(len(days)), 2)]


def rig(folder: Path) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return the six-leg rig and its two days."""
    with tempfile.TemporaryDirectory() as name:
        return written_rig(folder, Path(name))


def written_rig(folder: Path, scratch: Path) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return the six-leg rig and its two days, their files in ``scratch``."""
    (scratch / "rig.yaml").write_text(real_stewart.mechanism_text(folder), encoding="utf-8")
    paths = []
    for key, file in real_stewart.SETS.items():
        path = scratch / f"day{key}.csv"
        path.write_bytes((folder / file).read_bytes())
        path.with_suffix(".yaml").write_text(real_stewart.sidecar(path.stem), encoding="utf-8")
        paths.append(path)
    mechanism = read_mechanism(scratch / "rig.yaml")
    return mechanism, read_campaign(paths, mechanism)


def beds(folder: Path, events: Path) -> dict[str, tuple[Mechanism, tuple[Dataset, ...]]]:
    """Return by event the printer that it calibrated, and the beds probed with that."""
    out: dict[str, tuple[Mechanism, tuple[Dataset, ...]]] = {}
    for path in sorted(folder.glob("*.json")):
        mesh = json.loads(path.read_text(encoding="utf-8"))
        event = real_priors.in_use(mesh, events)
        if event is None:
            continue
        data = replace(real_priors.bed_of(path, mesh, event), name=mesh["id"][:6],
                       columns={"dir_x": ways(path)})
        mechanism, others = out.get(event["id"], (_six(event), ()))
        out[event["id"]] = mechanism, (*others, data)
    return out


def _six(event: dict[str, Any], start: str = "geometry_start") -> Mechanism:
    return real_priors.machine(event, "fixed", start=start)[0]


def ways(path: Path) -> np.ndarray:
    """Return the direction of travel before each touch of a bed, along x (N,)."""
    lines = path.with_suffix(".csv").read_text(encoding="utf-8").splitlines()
    column = lines[0].split(",").index("approach_dir_x")
    return np.array([float(line.split(",")[column]) for line in lines[1:]])


def same_machine(folder: Path) -> list[tuple[Mechanism, tuple[Dataset, Dataset]]]:
    """Return pairs of successive calibrations of one printer, heights alone."""
    by: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(folder.glob("*.json")):
        event = json.loads(path.read_text(encoding="utf-8"))
        by.setdefault(event["id"].split("_")[1], []).append(event)
    out = []
    for events in by.values():
        for one, two in itertools.pairwise(events):
            start, other = one["geometry_start"], two["geometry_start"]
            if start["stepdists"] == other["stepdists"] and start["arms"] == other["arms"]:
                days = [replace(real_priors.machine({**e, "geometry_start": start}, "fixed")[1][0],
                                name=e["id"]) for e in (one, two)]
                out.append((_six(one), (days[0], days[1])))
    return out


def halves(path: Path) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return the printer of one bed touched many times, and every other touch as a campaign."""
    event = real_priors.rostock_event(path)
    mechanism, (data,) = real_priors.machine(event, "fixed", start="start", loose=True)
    part = np.arange(len(data)) % PARTS
    return mechanism, tuple(replace(data.take(part == k), name=f"touches {k + 1} of {PARTS}")
                            for k in range(PARTS))


def show(title: str, found: Sequence[Carried]) -> None:
    """Print a table."""
    print(f"\n{title}\n{'':44s} all rows{'':16s} the same rows\n{'from':16s} {'to':16s} "
          f"{'verdict':9s}" + 2 * " without   named learned" + "  what", flush=True)
    for c in found:
        terms = [f"{c.learned} learned"] if c.learned else []
        print(f"{c.source:16s} {c.target:16s} {c.verdict:9s} "
              + " ".join(f"{f:7.4f}" for f in (*c.figures, *c.same))
              + "  " + (", ".join([*c.named, *terms]) or "-"), flush=True)


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    data = parser.parse_args().data
    if not data.is_dir():
        print(f"skipped: the measurements are not here ({data})")
        return
    show("six-leg rig, leg residuals, mm rms", both_ways(*rig(data / "stewart-jugglebot")))
    for name, (mechanism, days) in beds(data / "delta-meshes", data / "delta-events").items():
        if len(days) > 1:
            show(f"beds probed after {name}, mm rms", both_ways(mechanism, days))
    show("successive calibrations, heights, mm rms", [
        c for machine, days in same_machine(data / "delta-events")
        for c in both_ways(machine, days)])
    for path in sorted((data / "delta-rostock").glob("*.csv")):
        show(f"{path.stem}, mm rms", both_ways(*halves(path)))


if __name__ == "__main__":
    main()
