"""What is said of campaigns too weak for what they are to tell: flat, short, of few poses.

    python benchmarks/weak_campaigns.py --seeds 3

Machines of `configs/` with errors drawn from their tolerances are measured in a plane without
turning (a line, of the planar one), over a twentieth of the stroke, or in hardly more poses than
there are unknowns; nothing else is wrong with them. ``ppmcal diagnose`` must name nothing, and ask
for the poses that are missing. With ``--hidden`` the first joint has a backlash of many times the
noise, approached from both sides, which may be named all the same.

One line per machine and weakness: campaigns, in how many something was named, in how many some
other verdict than none was given, in how many poses were asked for and how many (median), and the
groups of parameters that were said to be unknown in the last one.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from typing import Any

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import numpy as np  # noqa: E402
import yaml  # noqa: E402

from ppmcal import diagnose, simulate  # noqa: E402
from ppmcal.commands.inputs import load, shipped  # noqa: E402
from ppmcal.errors import PpmcalError  # noqa: E402

MACHINES = {"6-UPS": 10, "3-RPR": 7, "delta-linear": 6, "6-RUS": 15}
"""And how many poses are few."""
STAYS = {"6-UPS": ("z", "rx", "ry"), "3-RPR": ("y", "rz"), "delta-linear": ("z",),
         "6-RUS": ("z", "rx", "ry")}
"""Coordinates that do not change in a flat campaign."""
SHORT = 0.05
POSES = 40
STRONG = 30.0
"""The hidden backlash, in standard deviations of the measured position."""


def scenario(machine: str, weakness: str, seed: int, hidden: bool) -> dict[str, Any]:
    """Return a weak campaign as a scenario file has it."""
    base: dict[str, Any] = yaml.safe_load(shipped(machine, True).read_text(encoding="utf-8"))
    middle, half = _box(base["poses"])
    count = MACHINES[machine] if weakness == "few" else POSES
    if weakness == "flat":
        half = {c: 0.0 if c in STAYS[machine] else v for c, v in half.items()}
    if weakness == "short":
        half = {c: SHORT * v for c, v in half.items()}
    out = {**base, "seed": seed, "poses": {"random": {
        "center": middle, "half_range": half, "count": count}}}
    if hidden:
        mechanism = load(shipped(machine))
        width = STRONG * float(base["instrument"]["sigma"]["position"])
        if mechanism.actuator_quantity[0] == "angle":    # as far as the platform is moved
            width = float(np.degrees(width / (0.1 * mechanism.reach / 1e-3)))
        out |= {"approach": "both", "effects": [{
            "kind": "backlash", "on": [mechanism.actuators[0]], "parameters": {"width": width}}]}
    return out


def _box(poses: Mapping[str, Any]) -> tuple[dict[str, float], dict[str, float]]:
    """Return middle and half range of the poses of a scenario."""
    (kind, given), = poses.items()
    if kind == "random":
        return dict(given["center"]), dict(given["half_range"])
    half = dict.fromkeys(given["center"], float(given["radius"]))
    return dict(given["center"]), {**half, **given["swing"]}


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--machines", nargs="*", default=list(MACHINES), choices=list(MACHINES))
    parser.add_argument("--kinds", nargs="*", default=["flat", "short", "few"])
    parser.add_argument("--seeds", type=int, default=3, help="campaigns of each  [default: 3]")
    parser.add_argument("--first", type=int, default=1, help="the first seed  [default: 1]")
    parser.add_argument("--hidden", action="store_true", help="with a strong backlash")
    given = parser.parse_args()
    print("| machine | campaign | n | named | not none | asked | poses | s | unknown in the last |")
    print("|---|---|---|---|---|---|---|---|---|")
    total, wrong = np.zeros(4, dtype=int), 0
    for machine in given.machines:
        for weakness in given.kinds:
            verdicts, asked, seconds, last = [], [], [], ""
            for seed in range(given.first, given.first + given.seeds):
                begin = time.perf_counter()
                try:
                    result = diagnose(shipped(machine), simulate(shipped(machine), scenario(
                        machine, weakness, seed, given.hidden)).data)
                except PpmcalError as error:
                    verdicts.append(f"refused: {error}")
                    continue
                seconds.append(time.perf_counter() - begin)
                kinds = sorted({e.kind for e in result.diagnosis.effects})
                verdicts.append(" ".join([result.verdict, *kinds]))
                if result.record.campaign is not None:
                    asked.append(result.record.campaign.poses)
                    last = "; ".join(result.record.campaign.unknown)
            named = sum(v.startswith(("named", "partial")) for v in verdicts)
            other = sum(v != "none" for v in verdicts)
            wrong += sum(v.startswith(("named", "partial")) and v.split()[1:] != ["backlash"]
                         for v in verdicts)
            total += [len(verdicts), named, other, len(asked)]
            more = f" ({', '.join(sorted({v for v in verdicts if v != 'none'}))})" if other else ""
            print(f"| {machine} | {weakness} | {len(verdicts)} | {named} | {other}{more} | "
                  f"{len(asked)} | {np.median(asked) if asked else 0:.0f} | "
                  f"{np.median(seconds) if seconds else 0:.1f} | {last} |", flush=True)
    print(f"\n{total[0]} campaigns: something named in {total[1]}, what is not there in "
          f"{wrong if given.hidden else total[1]}; a verdict other than none in {total[2]}, "
          f"missing poses asked for in {total[3]}.")


if __name__ == "__main__":
    main()
