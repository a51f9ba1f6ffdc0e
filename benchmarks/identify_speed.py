"""How long `identify` takes from 60 rows to a million, beside reading and writing its files.

    python benchmarks/identify_speed.py --rows 60 1000 100000 1000000

The machine is that of `test_speed.py`: a six-leg platform, 48 parameters, measured in full from an
unknown place. CPU seconds, one process and one BLAS thread for each size, compiled loops in the
cache; peak memory is the process's. A million rows need 600 MB of disk and four minutes.
"""

from __future__ import annotations

import argparse
import itertools
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import yaml  # noqa: E402

CONFIGS = Path(__file__).resolve().parent.parent / "configs"


def write_campaign(rows: int, folder: Path) -> None:
    """Write machine and measurements of so many poses."""
    import ppmcal

    tree = yaml.safe_load((CONFIGS / "6-UPS.yaml").read_text(encoding="utf-8"))
    for limb in tree["limbs"]:
        limb["ratio"] = {"value": 10.0, "tolerance": 0.005}
    del tree["limits"]
    scenario = yaml.safe_load((CONFIGS / "scenarios" / "6-UPS.yaml").read_text(encoding="utf-8"))
    scenario["poses"]["random"]["count"] = rows
    for name, content in (("machine", tree), ("scenario", scenario)):
        (folder / f"{name}.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")
    made = ppmcal.simulate(folder / "machine.yaml", folder / "scenario.yaml")
    made.save(folder / "simulated")


def spent(machine: Path, data: Path) -> dict[str, float]:
    """Return the CPU seconds of each part of `identify` in this process, and its peak memory."""
    times = [0.0, time.process_time()]
    from ppmcal import identify
    from ppmcal.commands.inputs import load, read_data

    times.append(time.process_time())
    found = identify(machine, [data])
    times.append(time.process_time())
    found.save(data.parent / "identified")
    times.append(time.process_time())
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    read_data(load(machine), data)
    times.append(time.process_time())
    parts = [b - a for a, b in itertools.pairwise(times)]
    names = ("python", "imports", "identify", "write", "read")
    return {**dict(zip(names, parts, strict=True)), "memory": memory}


def main() -> None:
    """Print a table, a process for each size."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[60, 1000, 100_000])
    parser.add_argument("--of", type=Path, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.of:
        machine, data = asked.of / "machine.yaml", asked.of / "simulated" / "measurements.csv"
        if data.exists():
            print(json.dumps(spent(machine, data)))
        else:
            write_campaign(asked.rows[0], asked.of)
        return
    print("| rows | imports, s | reading, s | identify, s | writing, s | over imports | "
          "over reading and writing | peak, MB |\n|---|---|---|---|---|---|---|---|")
    for rows in asked.rows:
        with tempfile.TemporaryDirectory() as place:
            # the campaign is made first; then a run may have to compile, which a million rows leave
            # to those before them
            for _ in range(3 if rows < 10**6 else 2):
                out = subprocess.run(
                    [sys.executable, __file__, "--of", place, "--rows", str(rows)], check=True,
                    text=True, capture_output=True,
                    env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)})
        one = json.loads(out.stdout.splitlines()[-1])
        whole = one["identify"] + one["write"]
        imports = one["python"] + one["imports"]
        print(f"| {rows} | {imports:.2f} | {one['read']:.2f} | {one['identify']:.2f} | "
              f"{one['write']:.2f} | {(imports + whole) / imports:.2f} | "
              f"{whole / (one['read'] + one['write']):.1f} | {one['memory']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
