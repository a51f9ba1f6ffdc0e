"""Campaigns of many machines of one design: files, and the manifest of a batch over them."""

from pathlib import Path

import numpy as np

import ppmcal
from ppmcal.io.yaml import dump_yaml, read_yaml

DESIGN = {"leg1.offset": 0.6}
"""What every machine of the design is off by."""
MOVED = {"leg2.base.point.x": 0.4}
"""What changes on the last machine between its first and its last date."""


def write_fleet(folder, machines=3, dates=("2026-01-10", "2026-03-12"), backlash=0, rows=40,
                command="identify", options=None, own=0.1):
    """Write model, measurements and manifest; return the manifest's path.

    Planar machines whose tolerances are drawn by unit, with ``DESIGN`` on all and ``MOVED`` on
    the last one. ``own``: standard deviation of units, mm; ``backlash``: so many of them have
    some on leg1.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bench.yaml").write_bytes(ppmcal.shipped("3-RPR").read_bytes())
    scenario = read_yaml(ppmcal.shipped("3-RPR", scenario=True))
    names = [p.name for p in ppmcal.load(folder / "bench.yaml").parameters]
    for m in range(machines):
        drawn = np.random.default_rng([7, m]).normal(0.0, own, len(names))
        errors = {n: float(e) for n, e in zip(names, drawn, strict=True)}
        errors = {n: e + DESIGN.get(n, 0.0) for n, e in errors.items()
                  if n.endswith((".x", ".y", ".radius", "offset"))}
        for d, date in enumerate(dates):
            last = m == machines - 1 and d == len(dates) - 1 and d > 0
            now = {n: e + last * MOVED.get(n, 0.0) for n, e in errors.items()}
            effects = [{"kind": "backlash", "on": ["leg1"], "parameters": {"width": 0.12}}]
            run = ppmcal.simulate(folder / "bench.yaml", {
                **scenario, "errors": now, "effects": effects if m < backlash else [],
                "approach": "sequence",
                "noise": {}, "poses": {"random": {
                    "center": {"x": 500, "y": 290, "rz": 10}, "count": rows,
                    "half_range": {"x": 80, "y": 80, "rz": 8}}},
                "seed": 100 * m + d})
            place = folder / "runs" / f"m{m:02d}" / date
            place.mkdir(parents=True)
            for name in ("measurements.csv", "measurements.yaml"):
                (place / name).write_bytes(_bytes(run.files()[name]))
    manifest = folder / "fleet.yaml"
    manifest.write_text(dump_yaml({
        "format": "ppmcal/batch/1", "model": "bench.yaml", "command": command,
        "options": {command: options or {}},
        "campaigns": [{"data": "runs/{machine}/{date}/*.csv"}]}))
    return manifest


def _bytes(content):
    return content if isinstance(content, bytes) else str(content).encode()
