"""Calibrate a real six-leg platform from motion-capture data, and print how well it went.

    python benchmarks/real_stewart.py --data FOLDER

FOLDER holds nominal_geometry.yaml and the two campaigns of 60 and 108 poses measured on
two days (not part of the project). The mechanism file is made from the drawing: joint
centres good to 5 mm, mm per revolution and retracted lengths as the rig gave them, good to
2 mm per revolution and 3 mm. Residuals are leg
lengths: what a leg's closure misses at the measured pose.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from ppmcal.calibration.fit import Fit, FitOptions, Problem, identify, noise_check, with_noise
from ppmcal.calibration.knowledge import Estimate, estimates, intervals
from ppmcal.calibration.validation.residual_vectors import closure_lengths, register_only
from ppmcal.calibration.validation.summary import rank_of
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.effect_response import with_strokes
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

SPLITS, FOLDS = 10, 5
SETS = {"60": "poses60_2025-02-12.csv", "108": "poses108_2025-02-13.csv"}
LIMITS = {("fit", "60"): 0.250, ("fit", "108"): 0.410, ("5-fold", "60"): 0.29,
          ("5-fold", "108"): 0.47, ("60 -> 108", ""): 0.62, ("108 -> 60", ""): 0.37}


def mechanism_text(data: Path) -> str:
    """Return the mechanism file of the rig."""
    g = yaml.safe_load((data / "nominal_geometry.yaml").read_text())
    limbs = [{"name": f"leg{i + 1}", "kind": "U(P)S", "base": {"point": g["base_joints"][i]},
              "platform": {"point": g["platform_joints"][i]},
              "ratio": {"value": g["mm_per_rev_linear_scale_rig"][i], "tolerance": 2.0},
              "offset": g["retracted_lengths_measured_on_rig"][i]} for i in range(6)]
    return yaml.safe_dump({
        "format": "ppmcal/mechanism/1", "name": "six-leg rig",
        "units": {"length": "mm", "angle": "deg"}, "motion": "spatial", "limbs": limbs,
        "home": {"pose": {"x": 0, "y": 0, "z": 700, "rx": 0, "ry": 0, "rz": 0}},
        "tolerances": {"point": 5.0, "offset": 3.0, "length": 5.0, "angle": 1.0}})


def sidecar(name: str) -> str:
    """Return the sidecar of one campaign: motion capture, noise mostly in the spools."""
    return yaml.safe_dump({
        "format": "ppmcal/dataset/1", "name": name, "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "pose",
                       "sigma": {"position": 0.01, "rotation": 0.001, "actuator": 0.0025}},
        "frame": "unknown", "target": "unknown"})


def leg_rms(problem: Problem, state: object) -> float:
    """Root mean square leg residual over all rows of a problem, mm."""
    gaps = np.concatenate([closure_lengths(problem, state, i)
                           for i in range(len(problem.datasets))])
    return float(1e3 * np.sqrt(np.nanmean(gaps**2)))


def cross_validated(problem: Problem, options: FitOptions) -> float:
    """5-fold held-out leg residual, mean of ten seeded splits, mm."""
    rms = []
    data = problem.datasets[0]
    for seed in range(SPLITS):
        order = np.random.default_rng(seed).permutation(len(data))
        gaps = []
        for fold in range(FOLDS):
            out = np.zeros(len(data), dtype=bool)
            out[order[fold::FOLDS]] = True
            fit = identify(replace(problem, datasets=(data.take(~out),)), options)
            gaps.append(closure_lengths(replace(problem, datasets=(data.take(out),)),
                                        fit.state, 0))
        rms.append(1e3 * np.sqrt(np.nanmean(np.concatenate(gaps) ** 2)))
    return float(np.mean(rms))


def across(mechanism: Mechanism, train: object, test: object, options: FitOptions
           ) -> tuple[float, float]:
    """Fit on one day, test on the other: frame as it was, and frame registered anew, mm."""
    fit = identify(Problem(mechanism, (train,), mechanism.free), options)
    fixed = mechanism.with_values(fit.state.g)
    problem = Problem(fixed, (test,), ())
    anew = register_only(problem)
    kept = replace(anew.state, registrations=fit.state.registrations)
    return leg_rms(problem, kept), leg_rms(problem, anew.state)


def honest(fit: Fit) -> list[Estimate]:
    """Return the estimates with intervals that count what sessions and stretches differ by."""
    inflation = max(1.0, noise_check(fit).sigma_ratio)
    fit = with_noise(fit, inflation, FitOptions())
    sessions, blocks = intervals.cluster_robust(fit, inflation)
    return list(estimates(fit, rank_of(fit)[0], sessions or blocks,
                          intervals.by_noise(fit, FitOptions())))


def against_rig(found: list[Estimate], name: str, rig: list[float], key: str) -> None:
    """Print a number of each leg beside the rig's own, mm: both intervals."""
    held = [0, 0]
    mine = [e for e in found if e.name.endswith(name)]
    for e, measured in zip(mine, rig, strict=True):
        half = 0.5e3 * (e.interval[1] - e.interval[0])
        noise = 1e3 * e.half_by_noise
        away = 1e3 * e.value - measured
        held[0] += abs(away) <= half
        held[1] += abs(away) <= noise
        alone = "nothing" if e.sigma_data is None else f"{1e3 * e.sigma_data:.2f} mm"
        print(f"{e.name:34} {key:4} {1e3 * e.value:8.3f} mm +- {half:.3f} (by noise {noise:.3f}), "
              f"{away:+.3f} from the rig's {measured:.3f}; data alone know {alone}"
              + "; sessions disagree" * e.disagree)
    print(f"{name:34} {key:4} {held[0]} of {len(mine)} intervals hold the rig's number, "
          f"by noise alone {held[1]}", flush=True)


def curvatures(mechanism: Mechanism, days: dict[str, Dataset]) -> None:
    """Print the curvature of each leg by day and by both, with both intervals."""
    for actuator in mechanism.actuators:
        effect = {"kind": "curvature", "on": [actuator],
                  "parameters": {"p2": {"value": 0.0, "free": True}}}
        bent = with_effects(mechanism, [effect], mechanism.units, "curvature")
        bent = with_strokes(bent, np.concatenate([d.q for d in days.values()]))
        for key, sets in (*((k, (d,)) for k, d in days.items()), ("both", tuple(days.values()))):
            fit = identify(Problem(bent, sets, bent.free), FitOptions(robust=False))
            for e in (e for e in honest(fit) if e.name.endswith(".p2")):
                half = 0.5e3 * (e.interval[1] - e.interval[0])
                print(f"{e.name:34} {key:4} {1e3 * e.value:8.3f} mm +- {half:.3f} (by noise "
                      f"{1e3 * e.half_by_noise:.3f})" + "; sessions disagree" * e.disagree,
                      flush=True)


def main() -> int:
    """Print the figures; exit 1 where one misses its limit."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=Path("../shared/data/stewart-jugglebot"))
    folder = parser.parse_args().data
    if not folder.is_dir():
        print(f"skipped: the measurements are not here ({folder})")
        return 0
    options = FitOptions(robust=False)
    with tempfile.TemporaryDirectory() as scratch:
        mech = Path(scratch) / "rig.yaml"
        mech.write_text(mechanism_text(folder))
        paths = []
        for key, name in SETS.items():
            path = Path(scratch) / f"day{key}.csv"
            path.write_bytes((folder / name).read_bytes())
            path.with_suffix(".yaml").write_text(sidecar(f"day{key}"))
            paths.append(path)
        mechanism = read_mechanism(mech)
        days = dict(zip(SETS, read_campaign(paths, mechanism), strict=True))
        drawing = yaml.safe_load((folder / "nominal_geometry.yaml").read_text())
        rig = {"offset": drawing["retracted_lengths_measured_on_rig"],
               "ratio": drawing["mm_per_rev_linear_scale_rig"]}
    missed = 0

    def line(what: str, key: str, value: float) -> None:
        nonlocal missed
        limit = LIMITS.get((what, key))
        verdict = "" if limit is None else f"  (wanted <= {limit:.3f})"
        if limit is not None and value > limit:
            verdict += "  MISSED"
            missed += 1
        print(f"{what:34} {key:4} {value:7.3f} mm rms{verdict}", flush=True)

    for key, day in days.items():
        problem = Problem(mechanism, (day,), mechanism.free)
        fit = identify(problem, options)
        line("fit", key, leg_rms(problem, fit.state))
        line("5-fold", key, cross_validated(problem, options))
        for name, measured in rig.items():
            against_rig(honest(fit), name, measured, key)
    for a, b in (("60", "108"), ("108", "60")):
        same, anew = across(mechanism, days[a], days[b], options)
        line(f"{a} -> {b}, frame as it was", "", same)
        line(f"{a} -> {b}", "", anew)
    both = Problem(mechanism, tuple(days.values()), mechanism.free)
    fit = identify(both, options)
    line("both days, shared geometry", "", leg_rms(both, fit.state))
    for name, measured in rig.items():
        against_rig(honest(fit), name, measured, "both")
    curvatures(mechanism, days)
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
