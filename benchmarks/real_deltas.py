"""Calibrate real linear delta printers from touches of the bed and caliper distances.

    python benchmarks/real_deltas.py --data FOLDER

FOLDER holds ``delta-events`` (what printers recorded when they calibrated themselves, and what
their own solver found) and ``delta-rostock`` (284 touches of one bed), which are not part of the
project. Every event becomes a mechanism file with the printer's freedoms and data files, and is
fitted with flat priors and the printer's weights: a height counts n_distances/(0.5 n_heights) of
a distance.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify
from ppmcal.calibration.validation import residuals
from ppmcal.io import read_campaign, read_mechanism

TOWERS = "abc"
CLOSE = 0.002
"""A fit agrees with the printer's if all its parameters do, in mm (angles at the radius)."""
UNITS = {"length": "mm", "angle": "deg"}


def mechanism_text(geometry: dict[str, Any], rods: str) -> str:
    """Return a linear delta as its printer parametrises it.

    The carriage is at u = offset - steps x stepdist, with offset = endstop + sqrt(rod^2 -
    radius^2). ``rods``: ``fixed``, ``shared`` or ``single``.
    """
    limbs = []
    for i, tower in enumerate(TOWERS):
        arm, radius = geometry["arms"][i], geometry["radius"]
        rod: dict[str, Any] = {"value": arm} | ({"share": "rod"} if rods == "shared" else {})
        angle = geometry["angles"][i]
        limbs.append({
            "name": tower, "kind": "(P)US",
            "base": {"point": {"radius": {"share": "radius", "value": radius},
                               "angle": {"value": angle} | ({"fixed": True} if i == 2 else {}),
                               "z": {"value": 0, "fixed": True}},
                     "direction": {"value": [0, 0, 1], "fixed": True}},
            "platform": {"point": {"radius": {"value": 0, "fixed": True},
                                   "angle": {"value": angle, "fixed": True},
                                   "z": {"value": 0, "fixed": True}}},
            "length": rod | ({"fixed": True} if rods == "fixed" else {}),
            "ratio": -geometry["stepdists"][i],
            "offset": geometry["endstops"][i] + float(np.sqrt(arm**2 - radius**2)), "branch": 1})
    return yaml.safe_dump({
        "format": "ppmcal/mechanism/1", "name": "printer", "units": UNITS,
        "motion": "translational", "limbs": limbs, "home": {"pose": {"x": 0, "y": 0, "z": 0}},
        "tolerances": {"point": 1.0, "angle": 0.5, "length": 1.0, "offset": 1.0}})


def write_data(folder: Path, event: dict[str, Any]) -> list[Path]:
    """Write heights and distances with their sidecars; return the tables."""
    heights, distances = event["heights"], event["distances"]
    share = len(distances) / (0.5 * len(heights)) if distances else 1.0
    q = [f"q_{t}" for t in TOWERS]
    out = [_table(folder / "heights.csv", ["height", *q], heights, {
        "kind": "plane", "sigma": {"height": 0.05 / float(np.sqrt(share))}})]
    if distances:
        out.append(_table(folder / "distances.csv", ["distance", *q, *(f"to_{c}" for c in q)],
                          distances, {"kind": "distance", "sigma": {"distance": 0.05}}))
    return out


def _table(path: Path, header: list[str], rows: list[list[float]], instrument: dict[str, Any]
           ) -> Path:
    lines = [",".join(header), *(",".join(repr(float(v)) for v in row) for row in rows)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    path.with_suffix(".yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "name": path.stem, "units": UNITS,
        "instrument": instrument, "frame": "known", "target": "known"}), encoding="utf-8")
    return path


def fitted(event: dict[str, Any], rods: str, start: str = "geometry_start") -> Fit:
    """Return the fit of one event with flat priors."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        path = folder / "printer.yaml"
        path.write_text(mechanism_text(event[start], rods), encoding="utf-8")
        mechanism = read_mechanism(path)
        data = read_campaign(write_data(folder, event), mechanism)
    return identify(
        Problem(mechanism, data, mechanism.free), FitOptions(method="flat", robust=False)
    )


def geometry(fit: Fit) -> dict[str, Any]:
    """Return the fitted machine in the printer's parameters, mm and degrees."""
    v = dict(zip(fit.problem.mechanism.names, fit.state.g.tolist(), strict=True))
    radius = v["radius"]
    arms = [v.get("rod", v.get(f"{t}.length", np.nan)) for t in TOWERS]
    return {"radius": radius * 1e3, "arms": [1e3 * a for a in arms],
            "angles": [float(np.degrees(v[f"{t}.base.point.angle"])) for t in TOWERS],
            "endstops": [1e3 * (v[f"{t}.offset"] - float(np.sqrt(a**2 - radius**2)))
                         for t, a in zip(TOWERS, arms, strict=True)]}


def apart(found: dict[str, Any], saved: dict[str, Any]) -> float:
    """Return the largest difference of two geometries, mm."""
    turn = np.radians(np.subtract(found["angles"], saved["angles"])) * saved["radius"]
    return float(np.max(np.abs([
        found["radius"] - saved["radius"], *turn, *np.subtract(found["arms"], saved["arms"]),
        *np.subtract(found["endstops"], saved["endstops"])])))


def rms(fit: Fit) -> list[float]:
    """Return the rms of each data set's residuals, mm."""
    errors = residuals(fit.problem, fit.state)
    return [float(np.sqrt(np.mean(e**2))) * 1e3 for e in errors.position]


def events(folder: Path) -> None:
    """Print the comparison with the printers' own fits."""
    print(f"{'event':22s} rows  rods    heights  distances  differs from the saved by (mm)")
    for path in sorted(folder.glob("*.json")):
        event = json.loads(path.read_text(encoding="utf-8"))
        rods = "single" if event["distances"] else "fixed"
        fit = fitted(event, rods)
        own = rms(fit)
        far = apart(geometry(fit), event["geometry_saved"])
        print(f"{event['id']:22s} {len(event['heights']):2d}+{len(event['distances']):2d} "
              f"{rods:7s} {own[0]:.4f}   {own[1] if len(own) > 1 else float('nan'):.4f}    "
              f"{far:8.4f} {'' if far <= CLOSE else '*'}")
    print(f"* the saved parameters are not what the data say to {CLOSE} mm")


def bed(path: Path, rods: str) -> Fit:
    """Return the fit of many touches of one bed; carriages in microsteps up from it."""
    steps = np.loadtxt(path, delimiter=",", skiprows=1)
    place = np.array([[-117.626, -68.065], [117.626, -68.065], [-0.936, 136.130]])
    start = {"radius": float(np.mean(np.hypot(*place.T))), "arms": [299.266] * 3,
             "stepdists": [-0.0125] * 3, "endstops": [0.0] * 3,
             "angles": np.degrees(np.arctan2(place[:, 1], place[:, 0])).tolist()}
    event = {"heights": [[9.5, *row] for row in steps.tolist()], "distances": [], "start": start}
    return fitted(event, rods, "start")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    given = parser.parse_args()
    events(given.data / "delta-events")
    for path in sorted((given.data / "delta-rostock").glob("*.csv")):
        for rods in ("fixed", "shared", "single"):
            fit = bed(path, rods)
            print(f"{path.stem}, rods {rods:7s} {rms(fit)[0]:.4f} mm rms, "
                  f"{len(fit.problem.free)} free")


if __name__ == "__main__":
    main()
