"""Are the commands of `compensate` safe? Random machines of every kind, errors, effects and noise.

Each machine of `configs` is made within its tolerances, with effects drawn for it, measured with
noise and identified. Commands for a path and for a box of targets then drive the true machine. Told
are, over all that was sent: commands outside limits, poses across a singularity, jumps, rows whose
error is larger than without correction, and what was refused although it would have been better.

    python benchmarks/safe_commands.py --machines 40
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import ppmcal
from ppmcal import algebra as cga
from ppmcal.errors import PpmcalError
from ppmcal.io.effects import with_effects
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.equilibrium import reached_poses
from ppmcal.kinematics.forward import smallest_singular_value
from ppmcal.kinematics.partial_pose import inverse_partial, pose_motor
from ppmcal.kinematics.region import largest_box, named, placed
from ppmcal.kinematics.tables import home_singular_value
from ppmcal.model.dataset import environment
from ppmcal.model.mechanism import Mechanism
from ppmcal.units import SI

Array = NDArray[np.float64]
CONFIGS = Path(__file__).parents[1] / "configs"
NOISE = (0.02, 0.1, 0.3)
"""Of the instrument, in parts of the tolerance of a point."""
ROWS = 60


@dataclass
class Tally:
    """What became of the rows."""

    machines: int = 0
    rows: int = 0
    sent: int = 0
    reasons: Counter[str] = field(default_factory=Counter)
    outside: int = 0
    crossed: int = 0
    jumps: int = 0
    worse: int = 0
    missed: int = 0
    whole: int = 0
    gain: list[float] = field(default_factory=list)

    def lines(self) -> list[str]:
        """Return the figures in words."""
        part = 100.0 / max(self.rows, 1)
        return [
            f"machines {self.machines}, of which refused as a whole {self.whole}",
            f"targets {self.rows}, sent {self.sent} ({self.sent * part:.2f} %)",
            "refused: " + (", ".join(f"{n} {why}" for why, n in self.reasons.most_common())
                           or "none"),
            f"sent outside limits {self.outside}, across a singularity {self.crossed}, "
            f"jumps {self.jumps}",
            f"sent and farther off than without correction, beyond 2 sigma: {self.worse} "
            f"({100.0 * self.worse / max(self.sent, 1):.2f} %)",
            f"refused as worse, though three times better in truth: {self.missed} "
            f"({self.missed * part:.2f} %)",
            f"error over that without correction, median {np.median(self.gain or [0]):.3f}"]


def _effects(mechanism: Mechanism, rng: np.random.Generator) -> list[dict[str, Any]]:
    """Return effects of moderate size, or none, as a file has them, SI."""
    size = 3e-4 * (mechanism.reach if mechanism.actuator_quantity[0] == "length" else 0.3)
    every = [{"kind": "backlash", "parameters": {"width": size}},
             {"kind": "leg_thermal", "parameters": {"expansion": 1.2e-5}},
             {"kind": "gain", "parameters": {"gain": 3e-4}},
             {"kind": "drift", "parameters": {"x": 1e-9 * mechanism.reach}}]
    return [every[i] for i in np.flatnonzero(rng.random(len(every)) < 0.25)]


def true_machine(name: str, rng: np.random.Generator) -> tuple[Mechanism, Mechanism]:
    """Return the drawing with its effects' kinds, and the machine as it is made."""
    drawn = ppmcal.load(CONFIGS / f"{name}.yaml")
    effects = _effects(drawn, rng)
    free = [e | {"parameters": {n: {"value": 0.0, "free": True} for n in e["parameters"]}}
            for e in effects]
    drawn = with_effects(drawn, free, SI, "drawn")
    g = drawn.values.copy()
    for i in drawn.free:
        g[i] += (drawn.parameters[i].tolerance or 0.0) * rng.standard_normal()
    for effect, entry in zip(drawn.effects, effects, strict=True):
        for parameter, value in entry["parameters"].items():
            g[effect.parameters[parameter]] = value
    return drawn, drawn.with_values(g)


def _conditions(mechanism: Mechanism, rows: int, rng: np.random.Generator) -> dict[str, Array]:
    """Return columns that every effect can depend on, SI."""
    out = {"temperature": 293.15 + rng.uniform(-4.0, 6.0, rows),
           "time": np.sort(rng.uniform(0.0, 3600.0, rows))}
    return out | {f"dir_{a}": rng.choice([-1.0, 1.0], rows) for a in mechanism.actuators}


def _reached(true: Mechanism, q: Array, columns: dict[str, Array]) -> tuple[Array, Array]:
    """Return where the true machine goes (N, 8), and where its limbs close."""
    rows = environment(columns, true.actuators, true.gravity, q)
    found = reached_poses(Model(true), q, rows)
    return found.pose, found.closed


def identified(drawn: Mechanism, true: Mechanism, noise: float, rng: np.random.Generator) -> Any:
    """Return what identify makes of sixty poses of the true machine, measured in its base."""
    chosen = named(drawn)
    low, high = largest_box(drawn, chosen, 3)
    poses = placed(drawn, chosen, rng.uniform(low, high, (ROWS, len(chosen))))
    columns = _conditions(drawn, ROWS, rng)

    q = inverse_partial(Model(drawn.nominal()), poses).q
    at = _reached(true, q, columns)[0]
    point = drawn.tolerances.get("point", 0.1) * noise
    turn = point * drawn.units.factor("length") / drawn.length_scale / drawn.units.factor("angle")
    table = {f"q_{a}": q[:, i] / f for i, (a, (f, _)) in enumerate(
        zip(drawn.actuators, drawn.joint_units, strict=True))}
    full = np.concatenate([cga.translation(at), cga.rotation_vector(at)], axis=1)
    for c in drawn.dof:
        factor = drawn.units.factor("length" if c < 3 else "angle")
        table["x y z rx ry rz".split()[c]] = full[:, c] / factor + (
            point if c < 3 else turn) * rng.standard_normal(ROWS)
    table |= {k: v - 273.15 if k == "temperature" else v for k, v in columns.items()}
    data = ppmcal.read_data(drawn, table, sidecar={
        "units": {"length": drawn.units.length, "angle": drawn.units.angle},
        "instrument": {"kind": "pose", "sigma": {"position": point, **(
            {} if not drawn.motion.turns else {"rotation": turn})}},
        "frame": "known", "target": "known"})
    return ppmcal.identify(drawn, data, holdout=0.0)


def _targets(mechanism: Mechanism, path: bool, rng: np.random.Generator) -> Array:
    """Return a smooth path, or targets all over the box inside limits."""
    chosen = named(mechanism)
    low, high = largest_box(mechanism, chosen, 3)
    if not path:
        return placed(mechanism, chosen, rng.uniform(low, high, (ROWS, len(chosen))))
    t = np.linspace(0.0, 2.0 * np.pi, ROWS)[:, None] + rng.uniform(0.0, 6.3, len(chosen))
    return placed(mechanism, chosen, (low + high) / 2.0 + 0.5 * (high - low) * np.sin(t))


def judge(tally: Tally, drawn: Mechanism, true: Mechanism, noise: float, path: bool,
          rng: np.random.Generator) -> None:
    """Identify, compensate, drive the true machine, and count."""
    tally.machines += 1
    try:
        fit = identified(drawn, true, noise, rng)
    except PpmcalError as error:
        tally.whole += 1
        tally.reasons[f"(identify: {error.what.partition(':')[0][:40]})"] += 0
        return
    wanted = _targets(drawn, path, rng)
    columns = _conditions(drawn, ROWS, rng)
    table = {c: wanted[:, i] / drawn.units.factor("length" if i < 3 else "angle")
             for i, c in zip(drawn.dof, drawn.coordinates, strict=True)}
    table |= {k: v - 273.15 if k == "temperature" else v for k, v in columns.items()}
    try:
        done = ppmcal.compensate(fit, table, frame="base", path=path)
    except PpmcalError:
        tally.whole += 1
        return
    found = done.compensation
    good = np.array([s == "ok" for s in found.status])
    tally.rows += ROWS
    tally.sent += int(good.sum())
    tally.reasons.update(r.partition(":")[0].partition(" is ")[0] if "worse" in r or "far" in r
                         else " ".join(w for w in r.split() if not any(d.isdigit() for d in w))[:50]
                         for r in found.reason if r)
    goal = pose_motor(found.pose)
    low, high = drawn.limits.T
    with np.errstate(invalid="ignore"):
        tally.outside += int((((found.q < low) | (found.q > high)).any(axis=1) & good).sum())
    # what a refused row would have been: the row as the model alone would command it
    from ppmcal.calibration.compensation import compensate
    from ppmcal.model.registration import Registration
    alone = compensate(replace(fit.mechanism, measured=None), wanted, Registration(),
                       columns=columns)
    after, closed = _reached(true, alone.q, columns)
    before, _ = _reached(true, found.q_nominal, columns)
    arc = drawn.length_scale

    def error(real: Array) -> Array:
        away = np.linalg.norm(cga.translation(real) - cga.translation(goal), axis=1)
        turn = np.linalg.norm(cga.rotation_vector(cga.compose(cga.reverse(goal), real)), axis=1)
        return np.asarray(np.hypot(away, arc * turn))

    own, plain = error(after), error(before)
    sigma = np.hypot(np.nan_to_num(found.sigma_position), arc * np.nan_to_num(found.sigma_rotation))
    seen = np.isfinite(own) & np.isfinite(plain)
    tally.worse += int((good & seen & (own > plain + 2.0 * sigma)).sum())
    tally.missed += int((~good & seen & (3.0 * own < plain)
                         & np.array(["worse" in r for r in found.reason])).sum())
    tally.gain += (own[good & seen] / plain[good & seen]).tolist()
    rows = np.flatnonzero(good & seen)
    _, sign = smallest_singular_value(Model(true).closure(alone.q[rows]), closed[rows])
    tally.crossed += int((sign != home_singular_value(drawn)[1]).sum())
    tally.crossed += int((good & ~np.isfinite(own)).sum())
    if path:
        step = np.abs(np.diff(found.q[good], axis=0)).max(axis=1, initial=0.0)
        own_step = np.abs(np.diff(found.q_nominal[good], axis=0)).max(axis=1, initial=0.0)
        tally.jumps += int((step > 1.5 * own_step + 1e-3 * drawn.reach).sum())


def study(machines: int, seed: int = 0, names: tuple[str, ...] = ()) -> Tally:
    """Return the tally over random machines, every kind in turn."""
    tally, rng = Tally(), np.random.default_rng(seed)
    kinds = names or tuple(sorted(p.stem for p in CONFIGS.glob("*.yaml")))
    for n in range(machines):
        drawn, true = true_machine(kinds[n % len(kinds)], rng)
        judge(tally, drawn, true, NOISE[n % len(NOISE)], n % 2 == 0, rng)
    return tally


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machines", type=int, default=44)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("\n".join(study(options.machines, options.seed).lines()))


if __name__ == "__main__":
    main()
