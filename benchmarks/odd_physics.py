"""What is said of physics that no library has, on machines simulated by a few lines of NumPy.

    python benchmarks/odd_physics.py --seeds 1 2 --families lens dent --machines hexapod

Shares no code with the package, nor with the other simulators: legs are distances between points.
One line per campaign: what was named, what is said to be there without a name, the time. The table
counts names that are none of what was done: here that are all names but those of ``RIGHT``.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import ppmcal

Array = NDArray[np.float64]


@dataclass
class Campaign:
    """What a machine did, mm and rad.

    ``place`` (N, 3), ``turn`` (N): where the platform was; ``seen`` (N, 3): where it is measured to
    be; ``joints`` (N, k): what the drives say; ``warmth`` (N,), K, and ``payload`` (N,), kg: what
    else is recorded; ``rng``: chance.
    """

    place: Array
    turn: Rotation
    joints: Array
    warmth: Array
    payload: Array
    rng: np.random.Generator
    seen: Array = field(init=False)

    def __post_init__(self) -> None:
        self.seen = self.place.copy()

    def along(self, joint: int) -> Array:
        """Return a joint's travel in standard deviations (N,)."""
        own = self.joints[:, joint]
        return np.asarray((own - own.mean()) / own.std())

    def away(self, axis: int) -> Array:
        """Return how far the platform was along an axis, from -1 to 1 (N,)."""
        own = self.place[:, axis] - self.place[:, axis].mean()
        return np.asarray(own / np.abs(own).max())


# --- what is done, tenths of a millimetre -----------------------------------------------------

def nothing(_: Campaign) -> None:
    """Do nothing."""


def lens(c: Campaign) -> None:
    """A camera's picture is bent outwards, by the cube of the distance from its middle."""
    flat = c.place[:, :2] - c.place[:, :2].mean(axis=0)
    reach = np.abs(flat).max()
    c.seen[:, :2] += 0.3 * flat / reach * np.sum((flat / reach) ** 2, axis=1, keepdims=True)


def refraction(c: Campaign) -> None:
    """Y reads long by the square of the distance."""
    c.seen[:, 1] += 0.3 * c.away(1) ** 2


def ball_out_of_round(c: Campaign) -> None:
    """A ball is longer in two directions of the platform's way."""
    c.joints[:, 2] += 0.12 * np.cos(2.0 * np.arctan2(c.away(1), c.away(0)))


def product(c: Campaign) -> None:
    """A leg gives way by the lengths of two others at once."""
    c.joints[:, 0] += 0.15 * c.along(1) * c.along(2)


def stick_slip(c: Campaign) -> None:
    """A leg stays behind by chance, always to one side."""
    c.joints[:, 1] += 0.12 * np.abs(c.rng.standard_normal(len(c.joints)))


def walk(c: Campaign) -> None:
    """The stand wanders."""
    c.seen[:, 0] += 0.04 * np.cumsum(c.rng.standard_normal(len(c.seen)))


def dent(c: Campaign) -> None:
    """A screw has a dent."""
    c.joints[:, 1] += 0.3 * np.exp(-0.5 * ((c.along(1) - 0.5) / 0.25) ** 2)


def two_steps(c: Campaign) -> None:
    """Two legs have a step in their screws."""
    for joint in (0, 2):
        c.joints[:, joint] += 0.2 * np.tanh(4.0 * (c.along(joint) - 0.3))


def crooked_wave(c: Campaign) -> None:
    """A wave of a screw with its third harmonic: the first is in the library."""
    angle = 2.0 * np.pi * c.joints[:, 2] / 5.0
    c.joints[:, 2] += 0.08 * np.sin(angle) + 0.05 * np.sin(3.0 * angle + 1.0)


def lags_by_speed(c: Campaign) -> None:
    """The measurement lags behind by the way from the row before."""
    way = np.linalg.norm(np.diff(c.place, axis=0, prepend=c.place[:1]), axis=1)
    c.seen[:, 0] += 0.2 * way / way.max()


def some_rows(c: Campaign) -> None:
    """A leg is off in every seventh row, by chance."""
    off = np.arange(len(c.joints)) % 7 == 3
    c.joints[off, 0] += 0.15 * c.rng.standard_normal(int(off.sum()))


def late_heat(c: Campaign) -> None:
    """Legs grow as it was warm some time ago."""
    late = np.zeros(len(c.joints))
    for row in range(1, late.size):
        late[row] = late[row - 1] + 0.06 * (c.warmth[row] - 20.0 - late[row - 1])
    c.joints -= 0.05 * late[:, None]


def square_heat(c: Campaign) -> None:
    """Heights go with the square of how warm it is."""
    c.seen[:, 1] += 0.02 * (c.warmth - 20.0) ** 2


def square_load(c: Campaign) -> None:
    """A leg gives way with the square of the payload."""
    c.joints[:, 1] += 0.002 * c.payload**2


def creep(c: Campaign) -> None:
    """A leg creeps by the logarithm of time."""
    c.joints[:, 2] += 0.08 * np.log1p(np.arange(len(c.joints)) / 5.0)


def cross_talk(c: Campaign) -> None:
    """A leg's drive is moved by its neighbour's, more at one end than at the other."""
    c.joints[:, 0] += 0.08 * np.exp(0.5 * c.along(1))


def swelling_wave(c: Campaign) -> None:
    """A wave of a pitch that nobody listed, that grows along the stroke."""
    c.joints[:, 1] += 0.06 * (1.0 + 0.5 * c.along(1)) * np.sin(2.0 * np.pi * c.joints[:, 1] / 3.7)


def chirp(c: Campaign) -> None:
    """A wave that turns faster along the stroke."""
    c.joints[:, 0] += 0.08 * np.sin(3.0 * (c.along(0) + 2.0) ** 2)


def coarse(c: Campaign) -> None:
    """A scale is read to 0.2 mm."""
    c.joints[:, 2] = np.round(c.joints[:, 2] / 0.2) * 0.2


def loaded_reversal(c: Campaign) -> None:
    """A leg turns back the later, the more it carries."""
    way = np.sign(np.diff(c.joints[:, 1], prepend=c.joints[0, 1]))
    c.joints[:, 1] += 0.01 * c.payload * way


def by_way(c: Campaign) -> None:
    """A leg is off by the root of the way that it came."""
    way = np.diff(c.joints[:, 0], prepend=c.joints[0, 0])
    c.joints[:, 0] += 0.015 * np.sqrt(np.abs(way)) * np.sign(way)


def saddle(c: Campaign) -> None:
    """X reads long in two corners and short in the others."""
    c.seen[:, 0] += 0.2 * c.away(0) * c.away(1)


def swaying(c: Campaign) -> None:
    """The stand sways twice in the campaign."""
    c.seen[:, 1] += 0.1 * np.sin(4.0 * np.pi * np.linspace(0.0, 1.0, len(c.seen)))


def noise_far(c: Campaign) -> None:
    """Far away readings scatter up to five times as much."""
    c.seen += 4.0 * SIGMA * np.abs(c.away(0))[:, None] * c.rng.standard_normal(c.seen.shape)


def noise_late(c: Campaign) -> None:
    """In the second half readings scatter four times as much."""
    half = len(c.seen) // 2
    c.seen[half:] += 4.0 * SIGMA * c.rng.standard_normal(c.seen[half:].shape)


def noise_of_joints(c: Campaign) -> None:
    """All joints scatter."""
    c.joints += 2.0 * SIGMA * c.rng.standard_normal(c.joints.shape)


def noise_along(c: Campaign) -> None:
    """Readings scatter along one slanted direction: the beam of a tracker."""
    c.seen += 4.0 * SIGMA * c.rng.standard_normal((len(c.seen), 1)) * np.array([0.6, 0.8, 0.0])


def few_digits(c: Campaign) -> None:
    """Places are read to 0.1 mm."""
    c.seen = np.round(c.seen, 1)


def bursts(c: Campaign) -> None:
    """Now and then some rows in a row are off together, by chance."""
    for begin in c.rng.integers(0, len(c.seen) - 6, 4):
        c.seen[begin:begin + 5] += 0.1 * c.rng.standard_normal(3) * np.array([1.0, 1.0, 0.0])


def reversal(c: Campaign) -> None:
    """A leg turns back late: in the library."""
    way = np.sign(np.diff(c.joints[:, 1], prepend=c.joints[0, 1]))
    c.joints[:, 1] += 0.06 * way


def homed_anew(c: Campaign) -> None:
    """A leg is homed anew half way: in the library."""
    c.joints[len(c.joints) // 2:, 1] += 0.15


FAMILIES: dict[str, Callable[[Campaign], None]] = {do.__name__: do for do in (
    nothing, lens, refraction, ball_out_of_round, product, stick_slip, walk, dent, two_steps,
    crooked_wave, lags_by_speed, some_rows, late_heat, square_heat, square_load, creep, cross_talk,
    swelling_wave, chirp, coarse, loaded_reversal, by_way, saddle, swaying, noise_far, noise_late,
    noise_of_joints, noise_along, few_digits, bursts, reversal, homed_anew)}
REVERSAL = {"backlash", "play", "hysteresis"}
RIGHT: dict[str, set[str]] = {"crooked_wave": {"periodic"}, "swelling_wave": {"periodic"},
         "reversal": REVERSAL, "loaded_reversal": REVERSAL, "homed_anew": {"zero_shift"},
         "bursts": {"target_shift", "base_shift"}, "lens": {"sensor_scale", "sensor_scale_axis"}}
"""Kinds that are part of what was done."""


# --- machines ---------------------------------------------------------------------------------

@dataclass(frozen=True)
class Machine:
    """A machine of ``legs`` between ``base`` and ``platform`` (k, 3), mm.

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

    def joints(self, base: Array, platform: Array, place: Array, turn: Rotation, rod: float
               ) -> Array:
        """Return joint values (N, k): lengths, or heights of carriages that rods hang from."""
        ends = np.einsum("nij,kj->nki", turn.as_matrix(), platform) + place[:, None] - base
        if not rod:
            return np.asarray(np.linalg.norm(ends, axis=2))
        return np.asarray(ends[..., 2] + np.sqrt(rod**2 - np.sum(ends[..., :2] ** 2, axis=2)))


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
SIGMA, ANGLE = 0.015, 0.004
"""Of the instrument, mm and degrees."""


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
    c = Campaign(place, turn, machine.joints(base, platform, place, turn, machine.rod) + zeros,
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
    parser = argparse.ArgumentParser(description=__doc__)
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
                      f"{line.unknown} | {line.seconds:.0f} s", flush=True)
    print("\n| family | campaigns | a wrong name | said to be there | s |\n|---|---|---|---|---|")
    for family, own in lines.items():
        wrong = sum(bool(set(x.named) - RIGHT.get(family, set())) for x in own)
        there = sum(x.verdict not in ("none", "refused") for x in own)
        print(f"| {family} | {len(own)} | {wrong} | {there} | "
              f"{np.mean([x.seconds for x in own]):.0f} |")


if __name__ == "__main__":
    main()
