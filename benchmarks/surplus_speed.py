"""How long `identify` takes with more closure equations than freedoms, beside a hexapod.

    python benchmarks/surplus_speed.py --rows 100 10000 100000

The machines are those of `configs/`, simulated by their scenarios: ropes, some of them over
pulleys, and a seventh leg, with an instrument and by joint values alone; the hexapod is 6-UPS,
measured in full. CPU seconds of `identify` beyond imports and writing, and peak memory, one process
each; the ratio is that over the hexapod of as many rows in the same run.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from identify_speed import CONFIGS, spent

HEXAPOD = "6-UPS"
MACHINES: dict[str, tuple[str, float | None]] = {
    HEXAPOD: (HEXAPOD, None), "cable-8": ("cable-8", None), "cable-8, alone": ("cable-8", 0.1),
    "cable-4-planar": ("cable-4-planar", None),
    "cable-4-planar, alone": ("cable-4-planar", 0.1), "maslow, alone": ("maslow", 0.3),
    "stewart-7": ("stewart-7", None), "stewart-7, alone": ("stewart-7", 0.01),
    "cable-4-pulleys": ("cable-4-pulleys", None), "cable-8-pulleys": ("cable-8-pulleys", None)}
"""By name the configuration, and what joints repeat to where they are all that is known, mm."""
RUNS, MANY = 2, 10**6
"""Of each, the second is told: the first may have to compile, which so many rows leave to those
before them."""


def write_campaign(name: str, rows: int, folder: Path) -> None:
    """Write machine and measurements of so many poses."""
    import yaml

    import ppmcal

    config, alone = MACHINES[name]
    tree: dict[str, Any]
    scenario: dict[str, Any]
    tree, scenario = (yaml.safe_load((CONFIGS / place / f"{config}.yaml").read_text(
        encoding="utf-8")) for place in ("", "scenarios"))
    tree.pop("limits", None)
    scenario["poses"]["random"]["count"] = rows
    if alone is not None:
        scenario["instrument"] = {"kind": "none", "sigma": {"actuator": alone}}
        for key in ("frame", "target"):
            scenario.pop(key, None)
    for part, content in (("machine", tree), ("scenario", scenario)):
        (folder / f"{part}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    made = ppmcal.simulate(folder / "machine.yaml", folder / "scenario.yaml")
    made.save(folder / "simulated")


def measured(name: str, rows: int) -> dict[str, float]:
    """Return what a machine's identification of so many rows takes, in processes of its own."""
    with tempfile.TemporaryDirectory() as place:
        for _ in range(1 + (RUNS if rows < MANY else 1)):
            out = subprocess.run(
                [sys.executable, __file__, "--of", place, "--machine", name, "--rows", str(rows)],
                check=True, text=True, capture_output=True,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
    return dict(json.loads(out.stdout.splitlines()[-1]))


def main() -> None:
    """Print a table, a line for each machine and size."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[100, 10_000])
    parser.add_argument("--machines", nargs="+", choices=MACHINES, default=list(MACHINES),
                        help="the first of them is what the others are held against")
    for hidden in ("--of", "--machine"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.of:
        folder = Path(asked.of)
        machine, data = folder / "machine.yaml", folder / "simulated" / "measurements.csv"
        if data.exists():
            print(json.dumps(spent(machine, data)))
        else:
            write_campaign(asked.machine, asked.rows[0], folder)
        return
    print("| rows | machine | identify, s | over the hexapod | peak, MB |\n|---|---|---|---|---|")
    for rows in asked.rows:
        least = None
        for name in asked.machines:
            one = measured(name, rows)
            least = least or one["identify"]
            print(f"| {rows} | {name} | {one['identify']:.2f} | {one['identify'] / least:.1f} | "
                  f"{one['memory']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
