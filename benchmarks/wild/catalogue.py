"""Write one case as files, with its truth; ask a written case for true poses.

python -m benchmarks.wild.catalogue --out DIR --case NAME --machine hexapod --rows 120
    --seed 3 --eta 1
python -m benchmarks.wild.catalogue --list
"""

from __future__ import annotations

import argparse
import json
import sys
import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from .campaign import Plan, Run, Setup, extended, setup, take
from .cases import CASES, Case, fits
from .files import coordinates, in_file_units, mechanism_record, table_text, write_text, yaml_text
from .machines import MACHINES, build, draw_errors, values_of, with_errors
from .mistakes import Blame, Paper
from .world import Effect, Judge, judge, measured, poses, rest


@dataclass(frozen=True)
class World:
    """A case as it happened: run, instrument, effects at their sizes, slot errors (slots,)."""

    case: Case
    run: Run
    place: Setup
    effects: list[Effect]
    scales: list[float]
    errors: np.ndarray
    judge: Judge | None


def stream(seed: int, what: str, name: str = "") -> np.random.Generator:
    """Generator of one purpose."""
    return np.random.default_rng([seed, zlib.crc32(what.encode()), zlib.crc32(name.encode())])


@lru_cache(maxsize=64)
def campaign(machine: str, plan: Plan, rows: int, seed: int) -> tuple[np.ndarray, Setup, Run]:
    """Slot errors (slots,), instrument and rows: those of all cases with that plan."""
    nominal = build(machine, seed)
    errors = draw_errors(nominal, stream(seed, "errors", machine))
    place = setup(nominal, plan, stream(seed, "setup", machine))
    run = take(nominal, with_errors(nominal, errors), plan, rows,
               stream(seed, "campaign", machine))
    return errors, place, run


@lru_cache(maxsize=64)
def referee_of(machine: str, plan: Plan, rows: int, seed: int) -> Judge:
    """What measures the effects of all cases with that plan."""
    errors, place, run = campaign(machine, plan, rows, seed)
    return judge(run, place, errors)


def draw(name: str, machine: str, rows: int, seed: int, eta: float, scales=None) -> World:
    """Machine, campaign and effects; scales (one per effect) skip the sizing by eta."""
    if not fits(name, machine):
        raise ValueError(f"{name} does not fit {machine}: {', '.join(CASES[name].machines)}")
    case = CASES[name]
    errors, place, run = campaign(machine, case.plan, rows, seed)
    rng = stream(seed, "effects", name)
    units = [make(rng, run) for make in case.causes]
    referee = None
    if scales is None:
        referee = referee_of(machine, case.plan, rows, seed)
        scales = [referee.scale_for(e, eta) if e.sized else 1.0 for e in units]
    effects = [e.scaled(s) for e, s in zip(units, scales, strict=True)]
    return World(case, run, place, effects, list(scales), errors, referee)


def noise(world: World, rng) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Noise of positions (N, 3) mm, rotations (N, 3) rad and joints (N, L)."""
    n, kind = world.run.count, world.case.plan.noise
    draws = rng.normal(size=(n, 6))
    if kind == "ar":
        for k in range(1, n):
            draws[k] = 0.6 * draws[k - 1] + 0.8 * draws[k]
    if kind == "tails":
        draws = rng.standard_t(4, size=(n, 6)) / np.sqrt(2.0)
    sigma = actuator_sigma(world)
    joints = sigma * rng.normal(size=world.run.q.shape)
    return draws[:, :3] * world.place.sigma_pos, draws[:, 3:] * world.place.sigma_rot, joints


def actuator_sigma(world: World) -> float:
    """Repeatability of the drives (mm or rad): only in cases that have it."""
    if world.case.plan.noise != "actuator":
        return 0.0
    return 0.01 / (150 if world.run.machine.rotary else 1)


def recorded(world: World, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Measured positions (N, 3) mm and rotations (N, 3, 3), with noise."""
    shift, turn, joints = noise(world, stream(seed, "noise", world.run.machine.name))
    run = world.run
    jitter = Effect("noise", (), {}, (), {}, lambda s, r, v: _add(s, joints))
    pos, rot = measured(run, world.place, [*world.effects, jitter])
    if run.machine.motion == "planar":
        shift[:, 2] = turn[:, :2] = 0
    return pos + shift, Rotation.from_rotvec(turn).as_matrix() @ rot


def _add(state, joints: np.ndarray) -> None:
    state.du += joints


def table_of(world: World, seed: int) -> dict[str, np.ndarray]:
    """All columns of the data file, in mm, deg, kg, N, N·m, °C, s."""
    run, machine = world.run, world.run.machine
    turn = np.degrees if machine.rotary else np.asarray
    pos, rot = recorded(world, seed)
    values = in_file_units(machine.motion, values_of(machine.motion, pos, rot))
    names = coordinates(machine.motion)
    if world.place.instrument == "position":
        names, values = ["x", "y", "z"], pos
    table = {"pose": run.label}
    table |= {f"q_{n}": turn(run.q[:, i]) for i, n in enumerate(machine.legs)}
    table |= dict(zip(names, values.T, strict=True))
    table |= {f"dir_{n}": run.dirs[:, i] for i, n in enumerate(machine.legs)}
    table |= {f"vel_{n}": turn(run.speed[:, i]) for i, n in enumerate(machine.legs)}
    table["temperature"] = run.temperature
    if world.case.plan.loads == "wrench":
        scale = np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
        table |= dict(
            zip(["fx", "fy", "fz", "mx", "my", "mz"], (run.wrench * scale).T, strict=True)
        )
    else:
        table["payload"] = run.payload
    table["time"] = run.time
    return {k: np.array(v) for k, v in table.items() if k not in world.case.plan.hide}


def sidecar_of(world: World, name: str) -> dict:
    """The data file's sidecar."""
    place, plan = world.place, world.case.plan
    sigma = {"position": place.sigma_pos}
    if place.instrument == "pose":
        sigma["rotation"] = float(np.degrees(place.sigma_rot))
    if actuator_sigma(world):
        drive = actuator_sigma(world)
        sigma["actuator"] = float(np.degrees(drive)) if world.run.machine.rotary else drive
    open_or = "known" if place.known else "unknown"
    target = "known" if world.run.machine.motion == "translational" else open_or
    return {
        "format": "ppmcal/dataset/1", "name": f"campaign {name}",
        "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": place.instrument, "sigma": sigma},
        "frame": open_or, "target": target, "approach": plan.approach,
    }  # fmt: skip


def plain(value):
    """Arrays and numbers as JSON has them."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return value.item() if isinstance(value, np.generic) else value


def effect_record(world: World, effect: Effect, names: list[str]) -> dict:
    """One effect of the truth file; its row counts from 0 (index) and from 1 (row)."""
    sizes = world.judge.sizes([effect]) if world.judge else (None, None)
    record = {
        "kind": effect.kind, "on": [names[i] for i in effect.legs],
        "parameters": {k: plain(v) for k, v in effect.values.items()}, "units": effect.units,
        "eta": sizes[0], "rms_before_projection": sizes[1],
        "survival": sizes[0] / sizes[1] if sizes[1] else None, "note": effect.note,
        "physical": physical(effect),
    }  # fmt: skip
    if effect.row is not None:
        record |= {"index": effect.row, "row": effect.row + 1}
    return record


LARGEST = {"expansion": 4e-5, "gain": 5e-3, "axis_offset": 5.0, "scale": 5e-3, "shrink": 5e-3}


def physical(effect: Effect) -> bool:
    """Whether no parameter is larger than real machines have it."""
    return all(
        np.abs(effect.values[name]).max() <= most
        for name, most in LARGEST.items() if name in effect.values
    )  # fmt: skip


def blame_record(blame: Blame) -> dict:
    """One mistake of the truth file; rows count from 0 (indices) and from 1 (rows)."""
    return {
        "kind": blame.kind, "columns": blame.columns, "indices": blame.rows,
        "rows": [k + 1 for k in blame.rows], "read": blame.read, "accept": blame.accept,
        "mended_by_read": blame.read is not None and blame.mends, "note": blame.note,
    }  # fmt: skip


def truth_of(world: World, blames: list[Blame], recipe: dict) -> dict:
    """The truth file."""
    case, machine = world.case, world.run.machine
    effects = [effect_record(world, e, machine.legs) for e in world.effects]
    total = world.judge.sizes(world.effects)[0] if world.judge and effects else 0.0
    read: dict = {}
    for blame in blames:
        for key, value in (blame.read or {}).items():
            read[key] = {**read.get(key, {}), **value} if isinstance(value, dict) else value
    mends = all(b.mends for b in blames) and not case.other
    return {
        "group": case.group, "kinds": [b.kind for b in blames] + [e.kind for e in world.effects],
        "accept": [*case.accept, *[k for b in blames for k in b.accept],
                   *[k for e in world.effects for k in (*e.same, *like_backlash(world, e))]],
        "effects": effects, "eta_all": total, "mistakes": [blame_record(b) for b in blames],
        "mend": read if read and mends else None, "predicts_to_noise": mends,
        "parameters": len(machine.slots), "rank": world.judge.rank if world.judge else None,
        "freedom": world.judge.basis.shape[0] - world.judge.rank if world.judge else None,
        "errors": {s.name: _slot(s, e) for s, e in zip(machine.slots, world.errors, strict=True)},
        "frame": {"position": plain(world.place.frame_pos), "target": plain(world.place.target),
                  "rotvec_deg": _degrees(world.place.frame_rot)},
        "note": case.note, "recipe": recipe,
    }  # fmt: skip


LIKE = 0.25
"""Part of an effect's RMS that is none of a plain reversal, below which it is one."""


def like_backlash(world: World, effect: Effect) -> list[str]:
    """Backlash, where play or friction did no more in this campaign than change sides."""
    if effect.kind not in ("play", "friction"):
        return []
    state = rest(world.run)
    effect.apply(state, world.run, effect.values)
    du, dirs = (x[:, list(effect.legs)].ravel() for x in (state.du, world.run.dirs))
    other = du - dirs * (dirs @ du) / (dirs @ dirs)
    return ["backlash"] if other @ other < LIKE**2 * (du @ du) else []


def _degrees(rot: np.ndarray) -> list[float]:
    return Rotation.from_matrix(rot).as_rotvec(degrees=True).tolist()


def _slot(slot, error: float) -> float:
    return float(np.degrees(error) if slot.angle else error)


def write(case: str, machine: str, rows: int, seed: int, folder, eta: float = 1.0) -> dict:
    """Write mechanism.yaml, data.csv, data.yaml and truth.json; returns the truth."""
    world, folder = draw(case, machine, rows, seed, eta), Path(folder)
    nominal = build(machine, seed + 1000) if world.case.other else world.run.machine
    name = f"{machine} {seed}"
    paper = Paper(table_of(world, seed), sidecar_of(world, name), mechanism_record(nominal),
                  world.run.machine.rotary)  # fmt: skip
    rng = stream(seed, "mistakes", case)
    blames = [make(rng, paper) for make in world.case.errors]
    recipe = {"case": case, "machine": machine, "rows": rows, "seed": seed, "eta": eta}
    truth = truth_of(world, blames, recipe | {"scales": world.scales})
    if world.case.other:
        truth["kinds"] = ["other-machine"]
    write_text(folder / "mechanism.yaml", yaml_text(paper.mechanism))
    write_text(folder / "data.csv", table_text(paper.table))
    write_text(folder / "data.yaml", yaml_text(paper.sidecar))
    write_text(folder / "truth.json", json.dumps(truth, indent=1, ensure_ascii=False) + "\n")
    return truth


def truth_pose(folder, joints, conditions=None, frame: str = "measured") -> np.ndarray:
    """True poses (M, d) in mm and deg at joints (M, L) in mm or deg, after the last row.

    The joints are visited in the order given, in the state that the last row left; they are
    what the drives get, each under its true leg's name. conditions: temperature °C (M,),
    payload kg (M,), time s (M,), dirs (M, L), speed (M, L) in mm/s or rad/s, wrench (M, 6) N and
    N·mm; by default the last temperature, no load, ten seconds a row. frame: measured (the
    target in the measuring frame, as the instrument sees it, without noise) | base (the
    platform in the base frame, as it truly stands).
    """
    recipe = json.loads((Path(folder) / "truth.json").read_text(encoding="utf-8"))["recipe"]
    world = draw(*(recipe[k] for k in ("case", "machine", "rows", "seed", "eta", "scales")))
    joints = np.atleast_2d(np.asarray(joints, float))
    joints = np.radians(joints) if world.run.machine.rotary else joints
    run, motion = extended(world.run, joints, conditions or {}), world.run.machine.motion
    pos, rot = poses(run, world.effects)[:2]
    if frame == "measured":
        pos, rot = measured(run, world.place, world.effects)
    return in_file_units(motion, values_of(motion, pos, rot))[world.run.count :]


def main(argv=None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(prog="catalogue", description=__doc__.splitlines()[0])
    parser.add_argument("--list", action="store_true", help="cases by group, with their machines")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--case", choices=list(CASES), metavar="NAME")
    parser.add_argument("--machine", choices=MACHINES, default="hexapod")
    parser.add_argument("--rows", type=int, default=120)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--eta", type=float, default=1.0)
    args = parser.parse_args(argv)
    if args.list:
        for name, case in sorted(CASES.items(), key=lambda item: item[1].group):
            sys.stdout.write(f"{case.group:8} {name:26} {' '.join(case.machines)}\n")
        return 0
    if not args.out or not args.case:
        parser.error("--out and --case are needed, or --list")
    try:
        truth = write(args.case, args.machine, args.rows, args.seed, args.out, args.eta)
    except ValueError as fault:
        parser.error(str(fault))
    sys.stdout.write(f"{args.out}: {truth['group']} {truth['kinds']} eta {truth['eta_all']:.3g}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
