"""Does `compensate` promise the error that its commands have, where effects look alike?

    python benchmarks/promise_study.py --out promise.csv --count 12

Campaigns of a hexapod in which one of a pair of effects acts that look alike: a gain of the drives
and a scale of the instrument, heated legs and a heated base. Each is diagnosed, poses that were
not measured are compensated, and the true machine is sent there. Wanted: the rms of the true
errors over the rms of the promised ones near 1 over all campaigns.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
import tempfile
from dataclasses import dataclass, fields
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402

import ppmcal  # noqa: E402
from ppmcal import diagnose  # noqa: E402
from ppmcal.kinematics.closure import Model  # noqa: E402
from ppmcal.kinematics.equilibrium import reached_poses  # noqa: E402
from ppmcal.kinematics.registration import predict  # noqa: E402
from ppmcal.model.dataset import environment  # noqa: E402
from ppmcal.model.registration import Registration  # noqa: E402

MACHINE = Path(__file__).resolve().parents[1] / "sample_data" / "hexapod.yaml"
EFFECTS = {
    "gain": "{kind: gain, parameters: {gain: %g}}",
    "sensor_scale": "{kind: sensor_scale, parameters: {scale: %g}}",
    "leg_thermal": "{kind: leg_thermal, parameters: {expansion: %g}}",
    "base_thermal": "{kind: base_thermal, parameters: {expansion: %g}}"}
SIZES = {"gain": (1e-4, 5e-4), "sensor_scale": (1e-4, 5e-4), "leg_thermal": (5e-6, 2e-5),
         "base_thermal": (5e-6, 2e-5)}
SCENARIO = """
format: ppmcal/scenario/1
units: {{length: mm, angle: deg}}
poses:
  random:
    center: {{x: 0, y: 0, z: 400, rx: 0, ry: 0, rz: 0}}
    half_range: {{x: 40, y: 40, z: 35, rx: 7, ry: 7, rz: 9}}
    count: {count}
errors: {{random: {{scale: 1.0}}}}
effects: [{effect}]
conditions: {{temperature: {{mean: 22, swing: 4}}}}
instrument: {{kind: pose, sigma: {{position: 0.005, rotation: 0.001}}}}
frame: {{x: 1850, y: -420, z: 730, rx: 2, ry: -3, rz: 118}}
target: [12, -7, 55]
seed: {seed}
"""
ROWS, UNSEEN = 100, 40


@dataclass(frozen=True)
class Promise:
    """One campaign: truth, what was named, sets told, rms true and promised errors, mm."""

    truth: str
    seed: int
    verdict: str
    named: str
    sets: int
    true: float
    promised: float
    alone: float


def run(truth: str, seed: int) -> Promise:
    """Run one campaign; ``alone``: what is promised if the named set is taken for certain, mm."""
    rng = np.random.default_rng([seed, sorted(EFFECTS).index(truth)])
    low, high = SIZES[truth]
    size = float(rng.choice([-1, 1]) if truth in ("gain", "sensor_scale") else 1) * float(
        np.exp(rng.uniform(np.log(low), np.log(high))))
    machine = ppmcal.load(MACHINE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scenario.yaml"
        path.write_text(SCENARIO.format(count=ROWS + UNSEEN, effect=EFFECTS[truth] % size,
                                        seed=seed), encoding="utf-8")
        made = ppmcal.simulate(machine, path)
        folder_ = Path(folder) / "sim"
        made.save(folder_)
        with (folder_ / "measurements.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        _write(folder_ / "seen.csv", rows[:ROWS], list(rows[0]))
        (folder_ / "seen.yaml").write_bytes((folder_ / "measurements.yaml").read_bytes())
        _write(folder_ / "targets.csv", rows[ROWS:], [
            "x", "y", "z", "rx", "ry", "rz", "temperature"])
        found = diagnose(MACHINE, [folder_ / "seen.csv"])
        done = ppmcal.compensate(found, folder_ / "targets.csv")
        found.save(Path(folder) / "diagnosed")
        (Path(folder) / "diagnosed" / "diagnosis.json").unlink()
        alone = ppmcal.compensate(Path(folder) / "diagnosed" / "model.yaml",
                                  folder_ / "targets.csv").compensation
    compensation, scenario = done.compensation, made.scenario
    campaign = made.campaign
    columns = {"temperature": np.array([float(r["temperature"]) + 273.15 for r in rows[ROWS:]])}
    reached = reached_poses(Model(campaign.with_effects, campaign.g), compensation.q, environment(
        columns, machine.actuators, machine.gravity, compensation.q, False)).pose
    registration = Registration.of_pose(scenario.frame, scenario.target, scenario.target_rotation)
    wanted = np.array([[float(r[c]) for c in "xyz"] for r in rows[ROWS:]]) * 1e-3
    # what is wanted is what the instrument is to show
    shown = predict(registration, reached)[0] * (1.0 + (size if truth == "sensor_scale" else 0.0))
    away = np.linalg.norm(shown - wanted, axis=1)
    names = "; ".join(dict.fromkeys(e.kind for e in found.diagnosis.effects))
    return Promise(truth, seed, found.verdict, names, len(found.record.sets), _rms(away),
                   _rms(compensation.sigma_position), _rms(alone.sigma_position))


def _write(path: Path, rows: list[dict[str, str]], names: list[str]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.nanmean(values**2)) * 1e3)


def main() -> None:
    """Run campaigns and print the ratio."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("promise.csv"))
    parser.add_argument("--count", type=int, default=12)
    given = parser.parse_args()
    lines = []
    for n in range(given.count):
        lines.append(run(list(EFFECTS)[n % len(EFFECTS)], 1 + n))
        print(lines[-1], file=sys.stderr)
    with given.out.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([f.name for f in fields(Promise)])
        writer.writerows([getattr(line, f.name) for f in fields(Promise)] for line in lines)
    true, promised, alone = (np.array([getattr(line, n) for line in lines])
                             for n in ("true", "promised", "alone"))
    near = int(np.sum((true < 2 * promised) & (promised < 2 * true)))
    print(f"rms true / rms promised {_rms(true) / _rms(promised):.2f}, with the named set alone "
          f"{_rms(true) / _rms(alone):.2f}; within a factor of 2 in {near} "
          f"of {len(lines)}")


if __name__ == "__main__":
    main()
