"""A router on four belts, run by run: what is found in readings without any instrument.

    python benchmarks/real_belts.py --data DIR [--runs ten-runs-01 old-runs-29 ...]
    python benchmarks/real_belts.py --data DIR --constant 150 --runs ten-runs-01 ten-runs-02 ...
    python benchmarks/real_belts.py --data DIR --repeat --runs ten-runs-01 ten-runs-02 ...

With `--constant` so many mm are taken off all belts, and it says by how much each run, fitted with
the pull of the lower belts, finds another constant: with all belts in one plane, and with the
heights of anchors that the firmware has. With `--repeat` of runs of one frame: how well anchors
repeat, and how far belts of other runs are from closing, by geometry alone and with that pull.

DIR has `maslow/`: one table of belts for each run (bl, br, tr, tl, mm), and what the owner wrote
about them in `index.csv`, with which the table is to be held.
"""

from __future__ import annotations

import argparse
import csv
import json
import multiprocessing
import re
import tempfile
from functools import partial
from pathlib import Path

import numpy as np
import yaml

import ppmcal
from ppmcal.calibration.fit import FitOptions, Problem, identify, with_gauge
from ppmcal.errors import PpmcalError
from ppmcal.io import read_mechanism

BELTS = ("bl", "br", "tr", "tl")
HEIGHTS = {"bl": 34.0, "br": 78.0, "tr": 56.0, "tl": 100.0}
"""Of the anchors above the router's plane, as the firmware has them, mm."""
CONSTANTS = ("from_row", "low", "high", "at")
"""Where an effect acts, and no size of it."""
SIDE = {"units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "none", "sigma": {"actuator": 1.0, "estimated": True}}}


def machine(sides: tuple[float, float]) -> dict:
    """Return the file of a frame of two sides, mm, drawn by hand to some centimetres."""
    width, height = sides
    at = {"bl": (0, 0), "br": (width, 0), "tr": (width, height), "tl": (0, height)}
    still = {"x": {"value": 0, "fixed": True}, "y": {"value": 0, "fixed": True}}
    return {"format": "ppmcal/mechanism/1", "name": "belts", "motion": "planar-point",
            "units": {"length": "mm", "angle": "deg"},
            "limbs": [{"name": n, "kind": "rope", "base": {"point": list(at[n])},
                       "platform": {"point": still}, "offset": {"value": 0, "fixed": True}}
                      for n in BELTS],
            "home": {"pose": {"x": width / 2, "y": height / 2}}, "tolerances": {"point": 100}}


def words(data: Path) -> dict[str, tuple[str, tuple[float, float]]]:
    """Return by run what the owner wrote, and the sides of the frame, mm."""
    out: dict[str, tuple[str, tuple[float, float]]] = {}
    size = (3030.0, 2140.0)
    with (data / "index.csv").open(encoding="utf-8") as file:
        for line in csv.DictReader(file):
            if found := re.search(r"([\d.]+) x ([\d.]+) m", line["frame"]):
                size = (1e3 * float(found[1]), 1e3 * float(found[2]))
            elif not line["frame"].startswith("same"):
                size = (3030.0, 2140.0) if "posts" not in line["frame"] else (3100.0, 2200.0)
            numbers = [int(n) for n in re.findall(r"\d+", line["runs"].split(" ")[0])]
            note = line["what the owner wrote about it (paraphrased)"]
            for n in range(numbers[0], numbers[-1] + 1):
                out[f"{_stem(line['runs'])}-{n:02d}"] = (note, size)
    return out


def _stem(runs: str) -> str:
    return re.sub(r"-\d.*$", "", runs)


def one(data: Path, told: dict[str, tuple[str, tuple[float, float]]], run: str) -> str:
    """Return a line of the table."""
    rows = np.genfromtxt(data / f"{run}.csv", delimiter=",", names=True)
    note, sides = told.get(run, ("", (3030.0, 2140.0)))
    table = {f"q_{n}": rows[n] for n in BELTS}
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "belts.yaml"
        file.write_text(yaml.safe_dump(machine(sides)), encoding="utf-8")
        given = ppmcal.read_data(file, table, sidecar=SIDE, name=run)
        try:
            fit = ppmcal.identify(file, given).identification
            ppmcal.diagnose(file, given).save(Path(folder) / "out")
        except PpmcalError as error:
            return f"| {run} | {len(rows)} | {note} | refused: {str(error)[:70]} | | | |"
        said = json.loads((Path(folder) / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    gone = sorted({r.row for r in fit.gross_errors.rows})
    named = []
    for effect in said["effects"]:
        size = ", ".join(f"{v['value']:.3g} {v['unit']}".strip()
                         for n, v in effect["parameters"].items() if n not in CONSTANTS)
        on = "" if len(effect["on"]) == 4 else " on " + " ".join(effect["on"])
        named.append(f"{effect['kind']}{on} {size} ({effect['probability']:.2f})")
    unknown = "; ".join(u["looks_like"] for u in said["unknown"] if u["probability"] > 0.5)
    return (f"| {run} | {len(rows)} | {note} | {', '.join(map(str, gone)) or '-'} | "
            f"{said['verdict']} | {'; '.join(named) or '-'} | {unknown or '-'} |")


def constant(data: Path, told: dict[str, tuple[str, tuple[float, float]]], off: float, run: str
             ) -> tuple[str, list[float]]:
    """Return the run and by how much its constant is off: in one plane, and with heights, mm."""
    rows = np.genfromtxt(data / f"{run}.csv", delimiter=",", names=True)
    table = {f"q_{n}": rows[n] - off for n in BELTS}
    found = []
    for heights in ({}, HEIGHTS):
        tree = machine(told.get(run, ("", (3030.0, 2140.0)))[1])
        tree["effects"] = [
            {"kind": "missing_length", "parameters": {"length": {"value": off, "free": True}}},
            {"kind": "rope_stretch", "on": ["bl", "br"],
             "parameters": {"strain": {"value": 0.002, "free": True}}},
            *({"kind": "rope_height", "on": [n], "parameters": {"height": h}}
              for n, h in heights.items())]
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "belts.yaml"
            file.write_text(yaml.safe_dump(tree), encoding="utf-8")
            rows_read = ppmcal.read_data(file, table, sidecar=SIDE, name=run)
            model = with_gauge(read_mechanism(file), rows_read)
            fit = identify(Problem(model, rows_read, model.free), FitOptions())
        found.append(1e3 * float(fit.state.g[model.names.index("missing_length.length")]) - off)
    return run, found


def constants(data: Path, off: float, runs: list[str], cores: int) -> None:
    """Print what each run says, and the mean with its standard error."""
    print("| run | in one plane, mm | with heights, mm |\n|---|---|---|")
    each = []
    with multiprocessing.Pool(cores) as pool:
        for run, found in pool.imap(partial(constant, data, words(data), off), runs):
            each.append(found)
            print(f"| {run} | {found[0]:+.1f} | {found[1]:+.1f} |", flush=True)
    mean, error = np.mean(each, axis=0), np.std(each, axis=0, ddof=1) / np.sqrt(len(each))
    print("| mean | " + " | ".join(f"{m:+.1f} +- {e:.1f}" for m, e in zip(mean, error, strict=True))
          + " |")


def repeats(data: Path, runs: list[str]) -> None:
    """Print how well anchors repeat from run to run, and what each run says of all others."""
    side = words(data)[runs[0]][1]
    pulled = {"effects": [{"kind": "rope_stretch", "on": ["bl", "br"],
                           "parameters": {"strain": {"value": 0.002, "free": True}}}]}
    print("| model | sd of anchors, mm | closure of other runs, rms, mm | at most |")
    print("|---|---|---|---|")
    for name, more in (("geometry alone", {}), ("lower belts pull", pulled)):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "belts.yaml"
            file.write_text(yaml.safe_dump(machine(side) | more), encoding="utf-8")
            tables = [np.genfromtxt(data / f"{run}.csv", delimiter=",", names=True) for run in runs]
            given = [ppmcal.read_data(file, {f"q_{n}": rows[n] for n in BELTS}, sidecar=SIDE,
                                      name=run) for run, rows in zip(runs, tables, strict=True)]
            found = [ppmcal.identify(file, one, holdout=0.0) for one in given]
            for run, fit in zip(runs, found, strict=True):
                fit.save(Path(folder) / run)
            missed = []
            for i, run in enumerate(runs):
                for other in given[:i] + given[i + 1:]:
                    held = ppmcal.validate(Path(folder) / run / "identified.yaml", other)
                    missed += [e.closure.rms for e in held.record.datasets[0].errors
                               if e.model == "model"]
        anchors = 1e3 * np.array([f.mechanism.values for f in found]).std(axis=0, ddof=1)
        own = [i for i, n in enumerate(found[0].mechanism.names)
               if ".base.point." in n and anchors[i] > 0.0]
        print(f"| {name} | {', '.join(f'{anchors[i]:.2f}' for i in own)} | {np.mean(missed):.2f} | "
              f"{np.max(missed):.2f} |", flush=True)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--runs", nargs="*")
    parser.add_argument("--constant", type=float)
    parser.add_argument("--repeat", action="store_true")
    parser.add_argument("--cores", type=int, default=multiprocessing.cpu_count())
    asked = parser.parse_args()
    data = asked.data / "maslow"
    runs = asked.runs or sorted(p.stem for p in data.glob("*.csv") if p.stem != "index")
    if asked.constant is not None:
        constants(data, asked.constant, runs, asked.cores)
        return
    if asked.repeat:
        repeats(data, runs)
        return
    print("| run | readings | the owner | rows left out | verdict | named | without a name |")
    print("|---|---|---|---|---|---|---|")
    with multiprocessing.Pool(asked.cores) as pool:
        for line in pool.imap(partial(one, data, words(data)), runs):
            print(line, flush=True)


if __name__ == "__main__":
    main()
