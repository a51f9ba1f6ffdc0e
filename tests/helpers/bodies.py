"""A planar bench that several marks on its platform were measured at, made without the program.

Poses are drawn, legs are the distances between joint centres of the true bench; what is recorded
of them has the joints' noise, what is seen of each mark the camera's. Lengths are mm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
BASE = np.array([[0.0, 0.0], [1000.0, 0.0], [500.0, 860.0]])
PLATFORM = np.array([[70.0, -120.0], [70.0, 120.0], [-140.0, 0.0]])
MARKS: Mapping[str, tuple[float, float]] = {
    "T1": (40.0, -15.0), "T2": (-65.0, 30.0), "T3": (10.0, 90.0)}
FRAME = (35.0, -20.0, 0.2)
MACHINE = """format: ppmcal/mechanism/1
name: bench
units: {length: mm, angle: deg}
motion: planar
limbs:
  - {name: leg1, kind: R(P)R, base: {point: [0, 0]}, platform: {point: [70, -120]}}
  - {name: leg2, kind: R(P)R, base: {point: [1000, 0]}, platform: {point: [70, 120]}}
  - {name: leg3, kind: R(P)R, base: {point: [500, 860]}, platform: {point: [-140, 0]}}
home: {pose: {x: 500, y: 290, rz: 5}}
tolerances: {point: 0.5, offset: 0.4}
free: ["*.offset", "*.base.point.?"]
"""


@dataclass(frozen=True)
class Seen:
    """A campaign: joints (N, 3) as recorded, marks (N, 2) by name, and errors by parameter.

    ``poses`` (N, 3): where the platform was, x, y and its angle.
    """

    q: Floats
    marks: dict[str, Floats]
    errors: dict[str, float]
    poses: Floats


def turned(angle: Floats | float) -> Floats:
    """Return rotations of the plane (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def measured(seed: int, rows: int = 40, sigma: float = 0.01, joint: float = 0.0,
             names: Sequence[str] = tuple(MARKS), moved: Mapping[str, tuple[int, Sequence[float]]]
             | None = None, slots: Sequence[str] = ("offset", "base.point.x", "base.point.y")
             ) -> Seen:
    """Return a campaign of the true bench; ``moved``: marks that moved by so much from a row on.

    ``slots``: of each leg that are off their nominal values.
    """
    rng = np.random.default_rng(seed)
    errors = {f"leg{i + 1}.{slot}": float(rng.normal() * (0.4 if slot == "offset" else 0.5))
              for i in range(3) for slot in slots}
    base = BASE + np.array([[errors.get(f"leg{i}.base.point.{c}", 0.0) for c in "xy"]
                            for i in (1, 2, 3)])
    offset = np.array([errors.get(f"leg{i}.offset", 0.0) for i in (1, 2, 3)])
    place = np.array([500.0, 290.0]) + rng.uniform(-90.0, 90.0, (rows, 2))
    angle = rng.uniform(-0.35, 0.35, rows)
    turn = turned(angle)
    legs = np.linalg.norm(place[:, None] + PLATFORM @ np.swapaxes(turn, -1, -2) - base, axis=-1)
    q = legs - offset + joint * rng.normal(size=legs.shape)
    out = {}
    for name in names:
        at = np.tile(MARKS[name], (rows, 1))
        row, step = (moved or {}).get(name, (rows + 1, (0.0, 0.0)))
        at[row - 1:] += step
        point = place + (turn @ at[..., None])[..., 0]
        out[name] = (np.array(FRAME[:2]) + point @ turned(FRAME[2]).T
                     + sigma * rng.normal(size=(rows, 2)))
    return Seen(q, out, errors, np.column_stack([place, angle]))


def columns(pose: Floats, names: Sequence[str]) -> tuple[Floats, Floats, Floats]:
    """Return how marks that are seen at one pose (3,) of the nominal bench move (2 M, ...).

    With the legs' lengths (3), with the frame (x, y, and a turn about the origin: 3) and with the
    marks (2 M).
    """
    def legs(at: Floats) -> Floats:
        return np.asarray(np.linalg.norm(at[:2] + PLATFORM @ turned(at[2]).T - BASE, axis=1))

    steps = np.diag([1e-3, 1e-3, 1e-6])
    by_pose = np.stack([(legs(pose + h) - legs(pose - h)) / (2.0 * h.sum()) for h in steps], 1)
    frame, turn, quarter = turned(FRAME[2]), turned(pose[2]), turned(np.pi / 2.0)
    arms = [turn @ np.array(MARKS[name]) for name in names]
    moved = np.concatenate([frame @ np.column_stack([np.eye(2), quarter @ arm]) for arm in arms])
    around = np.concatenate([np.column_stack(
        [np.eye(2), quarter @ (frame @ (pose[:2] + arm))]) for arm in arms])
    return (moved @ np.linalg.inv(by_pose), around, np.kron(np.eye(len(names)), frame @ turn))


def sidecar(name: str, targets: str, sigma: float = 0.01, joint: float = 0.0,
            frame: str = "unknown", more: str = "") -> str:
    """Return a sidecar's text; ``targets``: the line that says what was measured."""
    drives = f", actuator: {joint:g}" if joint else ""
    return ("format: ppmcal/dataset/1\n" f"name: {name}\nunits: {{length: mm, angle: deg}}\n"
            f"instrument: {{kind: position, sigma: {{position: {sigma:g}{drives}}}}}\n"
            f"frame: {frame}\n{targets}\n{more}")


def listed(names: Sequence[str]) -> str:
    """Return the sidecar's line of unknown targets."""
    return f"targets: {{{', '.join(f'{n}: unknown' for n in names)}}}"


def _table(header: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    return "\n".join(",".join(f"{v:.17g}" if isinstance(v, float) else str(v) for v in row)
                     for row in [list(header), *rows]) + "\n"


JOINTS = ("q_leg1", "q_leg2", "q_leg3")


def wide(folder: Path, seen: Seen, joint: float = 0.0, spelt: str = "{name}{axis} [mm]",
         more: str = "") -> Path:
    """Write a file with columns of each mark."""
    heads = [spelt.format(name=n, axis=c) for n in seen.marks for c in "xy"]
    (folder / "wide.csv").write_text(_table(("pose", *JOINTS, *heads), [
        [i + 1, *seen.q[i].tolist(), *(v for m in seen.marks.values() for v in m[i].tolist())]
        for i in range(len(seen.q))]))
    (folder / "wide.yaml").write_text(sidecar("body", listed(list(seen.marks)), joint=joint,
                                              more=more))
    return folder / "wide.csv"


def long(folder: Path, seen: Seen, joint: float = 0.0, column: str = "target") -> Path:
    """Write a file with a row for each mark at each pose."""
    (folder / "long.csv").write_text(_table((*JOINTS, column, "x", "y"), [
        [*seen.q[i].tolist(), name, *m[i].tolist()]
        for i in range(len(seen.q)) for name, m in seen.marks.items()]))
    (folder / "long.yaml").write_text(sidecar("body", listed(list(seen.marks)), joint=joint))
    return folder / "long.csv"


def several(folder: Path, seen: Seen, joint: float = 0.0) -> list[Path]:
    """Write a file for each mark."""
    out, frame = [], "unknown"
    for name, marks in seen.marks.items():
        (folder / f"{name}.csv").write_text(_table((*JOINTS, "x", "y"), [
            [*q.tolist(), *m.tolist()] for q, m in zip(seen.q, marks, strict=True)]))
        (folder / f"{name}.yaml").write_text(sidecar(
            f"body {name}", "target: unknown", joint=joint, frame=frame))
        frame = f"{{same_as: body {next(iter(seen.marks))}}}"
        out.append(folder / f"{name}.csv")
    return out


def machine(folder: Path) -> Path:
    """Write the bench."""
    (folder / "bench.yaml").write_text(MACHINE)
    return folder / "bench.yaml"
