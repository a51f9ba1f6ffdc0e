"""Real delta printers with tolerances as prior: rods that stay plausible, touches left out.

    python benchmarks/real_priors.py --data FOLDER

FOLDER holds ``delta-events``, ``delta-rostock`` and ``delta-meshes``, which are not part of the
project. Every event is fitted as ``ppmcal import klipper`` would set it up, but with all three rods
free within their tolerance; every touch is predicted by a fit that had not seen it (eight parts),
and by the printers' six parameters. Then printers calibrated from their events are tested on
probed beds of the same machine, and the Rostock printer's freedoms against each other.
"""

from __future__ import annotations

import argparse
import csv
import itertools
import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import yaml
from real_deltas import mechanism_text, write_data

from ppmcal.calibration.fit import (
    Fit,
    FitOptions,
    Problem,
    flats,
    identify,
    noise_check,
    with_noise,
)
from ppmcal.calibration.sessions.change_detection import Change, between, posterior_of
from ppmcal.calibration.validation import report
from ppmcal.calibration.validation.residual_vectors import fresh_state, register_only, residuals
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.io.results.units import column_factor, column_unit
from ppmcal.linalg import finite_rows
from ppmcal.model.dataset import Dataset, Unknown
from ppmcal.model.mechanism import Mechanism

PARTS = 8
TOLERANCES = {"point": 1.0, "angle": 0.5, "length": 0.3, "offset": 1.0}
"""As ``import klipper`` writes them, mm and degrees."""
PLAUSIBLE = 3.0
"""Rods may end so many tolerances from what the owner measured or was told."""


def machine(event: dict[str, Any], rods: str, tower: bool = False, start: str = "geometry_start",
            loose: bool = False, steps: bool = False) -> tuple[Mechanism, tuple[Dataset, ...]]:
    """Return an event's printer and data.

    ``tower``: leaning towers are free too; ``loose``: endstops have no tolerance; ``steps``: the
    drives' scales are free to 0.2 %.
    """
    tree = yaml.safe_load(mechanism_text(event[start], rods))
    tree["tolerances"] = TOLERANCES | ({"offset": float("inf")} if loose else {})
    for limb in tree["limbs"]:
        if tower:
            limb["base"]["direction"] = {"value": [0, 0, 1], "tolerance": 0.3}
        if steps:
            limb["ratio"] = {"value": limb["ratio"], "tolerance": 2e-3 * abs(limb["ratio"])}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "printer.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
        mechanism = read_mechanism(folder / "printer.yaml")
        paths = write_data(folder, event)
        for path in paths:
            side = yaml.safe_load(path.with_suffix(".yaml").read_text(encoding="utf-8"))
            kind = side["instrument"]["kind"]
            side["instrument"]["sigma"] = ({"height": 0.02} if kind == "plane"
                                           else {"distance": 0.05})
            path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
        return mechanism, read_campaign(paths, mechanism)


def fitted(mechanism: Mechanism, data: tuple[Dataset, ...], method: str, robust: bool = True
           ) -> Fit:
    return identify(Problem(mechanism, data, mechanism.free), FitOptions(method, robust=robust))


def left_out(mechanism: Mechanism, data: tuple[Dataset, ...], method: str, parts: int = PARTS
             ) -> float:
    """Return the rms error, mm, of touches predicted by fits of the others."""
    part = np.arange(len(data[0])) % parts
    errors = []
    for k in range(parts):
        fit = fitted(mechanism, (data[0].take(part != k), *data[1:]), method, robust=False)
        fresh = replace(fit.problem, datasets=(data[0].take(part == k), *data[1:]), pivots=None)
        state = fresh_state(fresh, fit.state)
        errors.append(residuals(fresh, state).position[0])
    return 1e3 * float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def rods_of(fit: Fit) -> np.ndarray:
    """Return the three rods, mm."""
    v = dict(zip(fit.problem.mechanism.names, fit.state.g.tolist(), strict=True))
    return 1e3 * np.array([v.get("rod", v.get(f"{t}.length", np.nan)) for t in "abc"])


def events(folder: Path) -> None:
    """Print rods and touches left out, for every event."""
    print(f"{'event':22s} rows    rods - nominal, mm     touches left out, mm   what is odd")
    print(f"{'':22s}          a      b      c        six    priors")
    worst = []
    for path in sorted(folder.glob("*.json")):
        event = json.loads(path.read_text(encoding="utf-8"))
        six = machine(event, "fixed")
        own = machine(event, "single")
        fit = fitted(*own, "prior")
        told = report(fit, FitOptions(), 0.0, 0)
        rods = rods_of(fit) - np.array(event["geometry_start"]["arms"])
        apart = [left_out(six[0], six[1][:1], "flat"), left_out(*own, "prior")]
        noise = float(np.sqrt(np.mean(residuals(fit.problem, fit.state).position[0] ** 2))) * 1e3
        worst.append((apart[1] - apart[0]) / max(noise, 0.02))
        odd = [f"{n} {r:.1f} x noise" for n, r in told.noise.by_dataset.items() if r > 2.0]
        odd += [f"rod {'abc'[i]} {abs(r) / TOLERANCES['length']:.1f} tol"
                for i, r in enumerate(rods) if abs(r) > PLAUSIBLE * TOLERANCES["length"]]
        odd += [f"{b.dataset} row {b.row}" for b in told.gross_errors.rows]
        print(f"{event['id']:22s} {len(event['heights']):2d}+{len(event['distances']):2d} "
              f"{rods[0]:+6.3f} {rods[1]:+6.3f} {rods[2]:+6.3f}   {apart[0]:7.4f} "
              f"{apart[1]:7.4f}   " + ", ".join(odd))
    print(f"touches left out: with priors worse than six parameters by {max(worst):+.2f} of the "
          "noise at most")


def meshes(folder: Path, source: Path) -> None:
    """Print how printers calibrated from events predict probed beds of the same machine."""
    print("\nBeds probed with the numbers that an event saved: rms in mm, height and tilt aside")
    print(f"{'bed':16s} {'event':16s} rows  printer      six   priors   of bed   smooth  scatter")
    for path in sorted(folder.glob("*.json")):
        mesh = json.loads(path.read_text(encoding="utf-8"))
        event = in_use(mesh, source)
        if event is None:
            print(f"{mesh['id'][:16]:16s} no event is what it was probed with")
            continue
        data = bed_of(path, mesh, event)
        own = machine(event, "single")
        six = fitted(*machine(event, "fixed"), "flat")
        fit = fitted(*own, "prior")
        bed = fitted(machine(event, "fixed")[0], (data,), "flat", robust=False)
        (flat,) = list(flats(bed)) or [None]
        figures = [on_bed(with_numbers(own[0], mesh["active_geometry"]), data),
                   on_bed(six.problem.mechanism.with_values(six.state.g), data),
                   on_bed(own[0].with_values(fit.state.g), data),
                   1e3 * float(np.sqrt(np.mean(residuals(
                       bed.problem, bed.state).position[0] ** 2)))]
        shape = "" if flat is None else f"{1e3 * flat.smooth:8.4f} {1e3 * flat.scatter:8.4f}"
        print(f"{mesh['id'][:16]:16s} {event['id']:16s} {len(data):4d} "
              + " ".join(f"{f:8.4f}" for f in figures) + f" {shape}")


def in_use(mesh: dict[str, Any], source: Path) -> dict[str, Any] | None:
    """Return the event of the same owner whose saved numbers a bed was probed with."""
    active, best = mesh["active_geometry"], None
    for path in sorted(source.glob(f"*_{mesh['id'].split('_')[1]}.json")):
        event = json.loads(path.read_text(encoding="utf-8"))
        saved = event["geometry_saved"]
        away = float(np.max(np.abs([active["radius"] - saved["radius"], *np.subtract(
            active["arms"], saved["arms"]), *np.subtract(active["angles"], saved["angles"])])))
        if away < 0.01 and (best is None or away < best[0]):
            best = away, event
    return best[1] if best else None


def bed_of(path: Path, mesh: dict[str, Any], event: dict[str, Any]) -> Dataset:
    """Return a bed's touches as a data set of an event's machine; height and tilt unknown."""
    with path.with_suffix(".csv").open(encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    geometry = mesh["active_geometry"]
    ratio = geometry["stepdists"][0] / event["geometry_start"]["stepdists"][0]
    touches = [[float(r["probe_z_offset_mm"]), *(ratio * float(r[f"stepper_{t}_usteps"])
                                                 for t in "abc")] for r in rows]
    data = machine({**event, "heights": touches, "distances": []}, "fixed")[1][0]
    return replace(data, frame=Unknown(True, np.zeros(6)))


def with_numbers(mechanism: Mechanism, geometry: dict[str, Any]) -> Mechanism:
    """Return the machine with a printer's own numbers."""
    v = dict(zip(mechanism.names, mechanism.values.tolist(), strict=True))
    v["radius"] = 1e-3 * geometry["radius"]
    for t, angle, arm, end in zip("abc", geometry["angles"], geometry["arms"],
                                  geometry["endstops"], strict=True):
        v[f"{t}.base.point.angle"] = float(np.radians(angle))
        v[f"{t}.length"] = 1e-3 * arm
        v[f"{t}.offset"] = 1e-3 * (end + float(np.sqrt(arm**2 - geometry["radius"] ** 2)))
    return mechanism.with_values(np.array([v[n] for n in mechanism.names]))


def on_bed(mechanism: Mechanism, data: Dataset) -> float:
    """Return the rms of a bed's touches, mm, the bed's height and tilt fitted."""
    fit = register_only(Problem(mechanism, (data,), ()))
    error = residuals(fit.problem, fit.state).position[0][finite_rows(fit.state.poses[0])]
    return 1e3 * float(np.sqrt(np.mean(error**2)))


def repeated(folder: Path) -> None:
    """Print what changed between successive calibrations of one printer, six parameters."""
    print("\nSuccessive calibrations of one machine: what has changed")
    by: dict[str, list[dict[str, Any]]] = {}
    for path in sorted(folder.glob("*.json")):
        event = json.loads(path.read_text(encoding="utf-8"))
        by.setdefault(event["id"].split("_")[1], []).append(event)
    for events_ in by.values():
        for one, two in itertools.pairwise(events_):
            start = one["geometry_start"]
            if start["stepdists"] != two["geometry_start"]["stepdists"] or np.max(np.abs(
                    np.subtract(start["arms"], two["geometry_start"]["arms"]))) > 0.5:
                continue
            fits = [fitted(m, d[:1], "prior", False) for m, d in (
                machine(one, "fixed"), machine({**two, "geometry_start": start}, "fixed"))]
            mechanism = fits[1].problem.mechanism.with_values(fits[1].state.g)
            noisy = [with_noise(f, noise_check(f).inflation, FitOptions()) for f in fits]
            found, _ = between(mechanism, *(posterior_of(f, {str(n): "heights"})
                                            for n, f in enumerate(noisy)), {},
                               np.random.default_rng(0))
            names = "; ".join(_shown(c, mechanism, found.coverage) for c in found.changes)
            print(f"{one['id']:18s} -> {two['id'][:3]}  chi2 {found.chi2:8.3g} of "
                  f"{found.freedom:2d}, p = {found.p_value:8.2g}  {names}")


def _shown(change: Change, mechanism: Mechanism, coverage: float) -> str:
    """Return a change; ``coverage``: half of a 95 % interval over sigma."""
    words = []
    for part in change.parts:
        f = column_factor(mechanism, part.column)
        unit = column_unit(mechanism, part.column) or "steps"
        words.append(f"{part.value / f:+.3f} +- {coverage * part.sigma / f:.3f} {unit}")
    instead = f" (or {', '.join(change.instead[:3])})" if change.instead else ""
    return f"{change.name} {' '.join(words)}{instead}"


def rostock_event(path: Path) -> dict[str, Any]:
    """Return many touches of one bed as an event with a start of its own."""
    steps = np.loadtxt(path, delimiter=",", skiprows=1)
    place = np.array([[-117.626, -68.065], [117.626, -68.065], [-0.936, 136.130]])
    radius = float(np.mean(np.hypot(*place.T)))
    # steps are counted from the bed: a carriage is at u = steps x 0.0125 mm
    return {"heights": [[9.5, *row] for row in steps.tolist()], "distances": [], "start": {
        "radius": radius, "arms": [299.266] * 3, "stepdists": [-0.0125] * 3,
        "endstops": [-float(np.sqrt(299.266**2 - radius**2))] * 3,
        "angles": np.degrees(np.arctan2(place[:, 1], place[:, 0])).tolist()}}


def rostock(folder: Path) -> None:
    """Print what each freedom does to touches that a fit had not seen."""
    for path in sorted(folder.glob("*.csv")):
        event = rostock_event(path)
        print(f"\n{path.stem}, {len(event['heights'])} touches: left out, in {PARTS} parts")
        for words, rods, tower in (("six parameters", "fixed", False),
                                   ("and three rods", "single", False),
                                   ("and leaning towers", "fixed", True),
                                   ("and both", "single", True)):
            made = machine(event, rods, tower, "start", True)
            fit = fitted(*made, "prior", robust=False)
            inside = 1e3 * float(np.sqrt(np.mean(residuals(
                fit.problem, fit.state).position[0] ** 2)))
            print(f"{words:20s} fitted {inside:.4f}, left out {left_out(*made, 'prior'):.4f} mm "
                  f"rms, {len(fit.problem.free)} free")


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    given = parser.parse_args()
    events(given.data / "delta-events")
    meshes(given.data / "delta-meshes", given.data / "delta-events")
    repeated(given.data / "delta-events")
    rostock(given.data / "delta-rostock")


if __name__ == "__main__":
    main()
