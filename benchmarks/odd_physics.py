"""What is said of physics that no library has, on machines simulated by a few lines of NumPy.

    python benchmarks/odd_physics.py --seeds 1 2 --families lens dent --machines hexapod

Shares no code with the package, nor with the other simulators: legs are distances between points.
One line per campaign on standard error: what was named, what is said to be there without a name,
the time. The table counts names that are none of what was done: all but those of ``RIGHT``.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from odd_campaign import ANGLE, SIGMA, Array, Campaign
from odd_families import FAMILIES, GROUPS, RIGHT
from scipy.spatial.transform import Rotation
from study_summary import interval

import ppmcal


@dataclass(frozen=True)
class Machine:
    """A machine whose legs are between ``base`` and ``platform`` (k, 3), mm.

    ``reach``: half ranges of the place (3,) and the turn (3,), mm and degrees, about ``home``;
    ``head``: the mechanism file but for its limbs; ``columns``: of what is measured.
    """

    base: Array
    platform: Array
    home: Array
    reach: tuple[float, ...]
    head: dict[str, object]
    limb: Callable[[Array, Array], dict[str, object]]
    columns: tuple[str, ...]
    rod: float = 0.0

    def joints(self, base: Array, platform: Array, place: Array, turn: Rotation) -> Array:
        """Return joint values (N, k): lengths, or heights of carriages that rods hang from."""
        ends = np.einsum("nij,kj->nki", turn.as_matrix(), platform) + place[:, None] - base
        if not self.rod:
            return np.asarray(np.linalg.norm(ends, axis=2))
        return np.asarray(ends[..., 2] + np.sqrt(self.rod**2 - np.sum(ends[..., :2] ** 2, axis=2)))


def ring(radius: float, degrees: list[float], height: float = 0.0) -> Array:
    """Return points on a circle (k, 3)."""
    angle = np.deg2rad(degrees)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle),
                            np.full(angle.size, height)])


def struts(base: Array, platform: Array) -> dict[str, object]:
    """Return a limb of a hexapod."""
    return {"kind": "U(P)S", "base": {"point": base.tolist()},
            "platform": {"point": platform.tolist()}}


def flat_struts(base: Array, platform: Array) -> dict[str, object]:
    """Return a limb of a planar machine."""
    return {"kind": "R(P)R", "base": {"point": base[:2].tolist()},
            "platform": {"point": platform[:2].tolist()}}


def towers(base: Array, platform: Array) -> dict[str, object]:
    """Return a limb of a printer."""
    return {"kind": "(P)US", "base": {"point": base.tolist(), "direction": {
        "value": [0, 0, 1], "fixed": True}}, "platform": {"point": {
            "value": platform.tolist(), "fixed": True}}, "length": 250.0, "branch": 1}


MACHINES = {
    "hexapod": Machine(
        ring(305.0, [-12, 12, 108, 132, 228, 252]),
        ring(130.0, [-48, 48, 72, 168, 192, 288], -15.0),
        np.array([0.0, 0.0, 365.0]), (60, 60, 50, 12, 12, 12), {
            "motion": "spatial", "home": {
                "pose": {"x": 0, "y": 0, "z": 365, "rx": 0, "ry": 0, "rz": 0}},
            "tolerances": {"point": 0.4, "offset": 0.5}}, struts,
        ("x", "y", "z", "rx", "ry", "rz")),
    "planar": Machine(
        ring(500.0, [210, 330, 90]), ring(180.0, [250, 10, 130]), np.zeros(3),
        (90, 90, 0, 0, 0, 12), {
            "motion": "planar", "home": {"pose": {"x": 0, "y": 0, "rz": 0}},
            "tolerances": {"point": 0.4, "offset": 0.5}}, flat_struts, ("x", "y", "rz")),
    "printer": Machine(
        ring(160.0, [210, 330, 90]), ring(35.0, [210, 330, 90]), np.array([0.0, 0.0, 100.0]),
        (70, 70, 60, 0, 0, 0), {
            "motion": "translational", "home": {"pose": {"x": 0, "y": 0, "z": 100}},
            "tolerances": {"point": 0.4, "length": 0.3, "offset": 0.5}}, towers, ("x", "y", "z"),
        250.0)}
UNITS = {"length": "mm", "angle": "deg"}


def simulated(machine: Machine, family: str, seed: int, rows: int, visits: int
              ) -> tuple[dict[str, object], dict[str, Array]]:
    """Return the mechanism file and the measurements of one campaign."""
    rng = np.random.default_rng([seed, *map(ord, family)])
    poses = rng.uniform(-1.0, 1.0, (rows // visits, 6)) * np.array(machine.reach)
    poses = np.concatenate([poses[rng.permutation(len(poses))] for _ in range(visits)])
    place, turn = poses[:, :3] + machine.home, Rotation.from_rotvec(np.deg2rad(poses[:, 3:]))
    flat = np.array([1.0, 1.0, "z" in machine.columns])
    base, platform = (p + rng.normal(0.0, 0.3, p.shape) * flat for p in (
        machine.base, machine.platform))
    if machine.rod:
        platform = machine.platform
    zeros = rng.normal(0.0, 0.4, len(base))
    warmth = 20.0 + 4.0 * np.sin(np.linspace(0.0, 5.0, len(place))) + rng.normal(
        0.0, 0.1, len(place))
    c = Campaign(place, turn, machine.joints(base, platform, place, turn) + zeros,
                 warmth, rng.choice([0.0, 5.0, 10.0], len(place)), rng)
    FAMILIES[family](c)
    seen = np.column_stack([c.seen + rng.normal(0.0, SIGMA, c.seen.shape), np.rad2deg(
        (Rotation.from_rotvec(np.deg2rad(rng.normal(0.0, ANGLE, c.seen.shape)))
         * c.turn).as_rotvec())])
    file = {"format": "ppmcal/mechanism/1", "name": family,
            "units": UNITS, **machine.head,
            "limbs": [{"name": f"leg{n + 1}", **machine.limb(b, p)} for n, (b, p) in enumerate(zip(
                machine.base.round(3), machine.platform.round(3), strict=True))]}
    table = {f"q_leg{n + 1}": q for n, q in enumerate(c.joints.T)}
    table |= dict(zip(("x", "y", "z", "rx", "ry", "rz"), seen.T, strict=True))
    return file, {"time": 20.0 * np.arange(len(place)), "temperature": c.warmth,
                  "payload": c.payload, **{
        name: own for name, own in table.items() if name[:2] == "q_" or name in machine.columns}}


@dataclass(frozen=True)
class Line:
    """What was said of one campaign."""

    verdict: str
    named: tuple[str, ...]
    text: str
    unknown: str
    seconds: float


def ask(machine: Machine, file: dict[str, object], table: dict[str, Array], folder: Path) -> Line:
    """Return what a diagnosis says."""
    turns = any(name.startswith("r") for name in machine.columns)
    sigma = {"position": SIGMA, "rotation": ANGLE} if turns else {"position": SIGMA}
    side = {"units": UNITS, "frame": "unknown", "target": "unknown",
            "instrument": {"kind": "pose" if turns else "position", "sigma": sigma}}
    if len(machine.columns) == 6:
        side["target_rotation"] = "unknown"
    if not turns:
        side.pop("target")
    (folder / "m.yaml").write_text(yaml.safe_dump(file), encoding="utf-8")
    start = time.process_time()
    try:
        data = ppmcal.read_data(folder / "m.yaml", table, sidecar=side, name="run")
        ppmcal.diagnose(folder / "m.yaml", data).save(folder / "out", force=True)
    except ppmcal.PpmcalError as error:
        return Line("refused", (), str(error)[:150], "", time.process_time() - start)
    found = json.loads((folder / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    return Line(found["verdict"], tuple(e["kind"] for e in found["effects"]), "; ".join(
        f"{e['kind']} {','.join(e['on'])} {e['probability']:.2f}" for e in found["effects"]),
        "; ".join(f"{u['looks_like']} {u['probability']:.2f}" for u in found["unknown"]),
        time.process_time() - start)


def main() -> None:
    """Ask about every family on every machine."""
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="*", default=[1])
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=FAMILIES)
    parser.add_argument("--machines", nargs="*", default=list(MACHINES), choices=MACHINES)
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--visits", type=int, default=1)
    options = parser.parse_args()
    lines: dict[str, list[Line]] = defaultdict(list)
    for seed in options.seeds:
        for name in options.machines:
            for family in options.families:
                with tempfile.TemporaryDirectory() as folder:
                    line = ask(MACHINES[name], *simulated(
                        MACHINES[name], family, seed, options.rows, options.visits), Path(folder))
                lines[family].append(line)
                print(f"{name:8} {family:18} {seed} {line.verdict:9} {line.text} | "
                      f"{line.unknown} | {line.seconds:.0f} s", file=sys.stderr, flush=True)
    print("| | campaigns | said to be there | named | a wrong name | s |")
    print("|---|---|---|---|---|---|")
    for group, families in GROUPS.items():
        own = {name: lines[name] for name in families if name in lines}
        if own:
            print(row(f"**{group}**", own, whole=True))
            for family in own if len(own) > 1 else ():
                print(row(family.replace("_", " "), {family: own[family]}))


def row(title: str, lines: dict[str, list[Line]], whole: bool = False) -> str:
    """Return a row of the table."""
    every = [(family, line) for family, own in lines.items() for line in own]
    there = sum(line.verdict not in ("none", "refused") for _, line in every)
    named = sum(bool(line.named) for _, line in every)
    wrong = sum(bool(set(line.named) - RIGHT.get(family, set())) for family, line in every)
    most = ""
    if whole:
        low, high = interval(wrong, len(every))
        most = f" ({100.0 * low:.0f}-{100.0 * high:.0f} %)"
    seconds = np.mean([line.seconds for _, line in every])
    return f"| {title} | {len(every)} | {there} | {named} | {wrong}{most} | {seconds:.0f} |"


if __name__ == "__main__":
    main()
