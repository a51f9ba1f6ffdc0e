"""Causes that remember: play, hysteresis, friction, heat that lags, creep."""

from __future__ import annotations

import numpy as np

from .bodies import grow, thermal, warmth
from .campaign import Run
from .physics import joint_effect, pick, simple, tick, unit
from .world import Effect


def play_operator(path: np.ndarray, width: float, start: np.ndarray) -> np.ndarray:
    """Play of half width ``width`` along a path (K, L): p_k = clip(p_{k-1}, u_k − w, u_k + w)."""
    out, now = np.empty_like(path), start
    for k, u in enumerate(path):
        now = np.clip(now, u - width, u + width)
        out[k] = now
    return out


def path_of(run: Run) -> np.ndarray:
    """Every stop of the joints: before and at each row (2N, L)."""
    return np.stack([run.via, run.q], axis=1).reshape(-1, run.q.shape[1])


def slack(run: Run, width: float, at: np.ndarray) -> np.ndarray:
    """Play's output minus input at the rows (N, L); ``at`` (L,) in [−1, 1] is the start."""
    path = path_of(run)
    start = path[0] + width * at
    return (play_operator(path, width, start) - path)[1::2]


def play(how: str, ahead: bool = False):
    """Output follows the joint only past a half width: lost motion, behind the move.

    ``ahead`` turns the sign, as the list's backlash has it: + half a width after a move up.
    """
    side = -1.0 if ahead else 1.0

    def make(rng, run):
        at = rng.uniform(-1, 1, run.q.shape[1])
        return joint_effect(
            "play", pick(rng, run, how), {"width": tick(run)}, ("width",), {"width": unit(run)},
            lambda r, v: side * slack(r, float(v["width"]) / 2, at),
        )  # fmt: skip

    return make


def hysteresis(how: str, ahead: bool = False):
    """Prandtl-Ishlinskii: play operators of several widths, weighted, one size for all."""
    side = -1.0 if ahead else 1.0

    def make(rng, run):
        at = rng.uniform(-1, 1, run.q.shape[1])
        span = np.ptp(run.machine.limits, axis=1).mean()
        values = {
            "size": 0.02, "half_widths": span * np.array([0.001, 0.01, 0.04, 0.12]),
            "weights": rng.dirichlet(np.ones(4)),
        }  # fmt: skip

        def shape(r, v):
            pairs = zip(v["weights"], v["half_widths"], strict=True)
            return side * v["size"] * sum(w * slack(r, float(h), at) for w, h in pairs)

        units = {"size": "1", "half_widths": unit(run), "weights": "1"}
        return joint_effect("hysteresis", pick(rng, run, how), values, ("size",), units, shape)

    return make


def friction(how: str):
    """Stribeck: direction times a give that falls with speed from static to dynamic."""

    def make(rng, run):
        slow = 10 ** rng.uniform(-1, 0.2) * np.median(np.abs(run.speed))
        values = {"static": tick(run), "dynamic": 0.25 * tick(run), "speed": slow}

        def shape(r, v):
            falling = np.exp(-np.abs(r.speed) / v["speed"])
            return r.dirs * (v["dynamic"] + (v["static"] - v["dynamic"]) * falling)

        units = {"static": unit(run), "dynamic": unit(run), "speed": unit(run) + "/s"}
        sized = ("static", "dynamic")
        return joint_effect("friction", pick(rng, run, how), values, sized, units, shape)

    return make


def lagged(time: np.ndarray, drive: np.ndarray, tau: float, start: np.ndarray) -> np.ndarray:
    """x' = (drive − x)/tau, drive held over the step before each row: (N, ...)."""
    out, now = np.empty_like(drive), start
    gone = np.diff(time, prepend=time[0])
    for k, step in enumerate(gone):
        now = drive[k] + (now - drive[k]) * np.exp(-step / tau)
        out[k] = now
    return out


def thermal_lag(part: str, how: str = "all"):
    """What expands follows the thermometer late."""

    def make(rng, run):
        legs = pick(rng, run, how) if part == "leg" else ()
        tau = (run.time[-1] - run.time[0]) * rng.uniform(0.1, 0.35)

        def apply(state, r, v):
            late = lagged(r.time, warmth(r), v["tau"], warmth(r)[0])
            grow(state, r, part, legs, v["expansion"] * late)

        values, units = {"expansion": 1e-5, "tau": tau}, {"expansion": "1/K", "tau": "s"}
        return Effect(f"{part}_thermal", legs, values, ("expansion",), units, apply, note="late")

    return make


def motion_heat(how: str, part: str = "leg"):
    """Legs heat by their own travel per second and cool with a time constant.

    The base or the platform (``part``), on which all drives stand, heats by their mean.
    """

    def make(rng, run):
        legs, tau = pick(rng, run, how) if part == "leg" else (), (
            run.time[-1] * rng.uniform(0.1, 0.3))

        def warmed(r, tau):
            path = path_of(r)
            travel = np.abs(np.diff(path, axis=0, prepend=path[:1])).reshape(r.count, 2, -1).sum(1)
            power = travel / np.diff(r.time, prepend=r.time[0] - 8.0)[:, None]
            if part != "leg":
                power = power.mean(1)
            return lagged(r.time, power, tau, np.zeros(power.shape[1:]))

        # the warmest leg of the campaign gets 15 K above its start
        factor = 15.0 / warmed(run, tau).max()

        def apply(state, r, v):
            grow(state, r, part, legs, v["expansion"] * v["K_per_rate"] * warmed(r, v["tau"]))

        values = {"expansion": 1e-5, "tau": tau, "K_per_rate": factor}
        units = {"expansion": "1/K", "tau": "s", "K_per_rate": "K per joint unit per s"}
        return Effect(f"{part}_thermal", legs, values, ("expansion",), units, apply,
                      note="from motion")  # fmt: skip

    return make


def creep(how: str):
    """Gives way slowly after each change of load."""

    def make(rng, run):
        tau = float(np.median(np.diff(run.time))) * rng.uniform(2, 8)

        def shape(r, v):
            return v["give"] * lagged(r.time, r.load, v["tau"], r.load[0])

        values = {"give": tick(run) / np.abs(run.load).mean(), "tau": tau}
        units = {"give": unit(run) + "/N", "tau": "s"}
        return joint_effect("creep", pick(rng, run, how), values, ("give",), units, shape)

    return make


def backlash_by_temperature(how: str):
    """Backlash that grows with the temperature above 20 °C."""
    return simple("product", how, "width_per_K", lambda r, v: r.dirs * v["width_per_K"] / 2
                  * warmth(r)[:, None], per="/K")  # fmt: skip


def shortfall(how: str):
    """Short by a share of the last move: in no list."""
    return simple("learned", how, "share", lambda r, v: -v["share"] * (r.q - r.via),
                  lambda r: 1e-4, "/unit")  # fmt: skip


__all__ = ["backlash_by_temperature", "creep", "friction", "hysteresis", "motion_heat", "play",
           "shortfall", "thermal", "thermal_lag"]  # fmt: skip
