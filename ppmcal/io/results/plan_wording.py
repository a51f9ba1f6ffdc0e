"""A measuring plan in sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ppmcal import linalg
from ppmcal.codec import in_units
from ppmcal.design.plan.information import PAYS, reaching
from ppmcal.design.plan.result import Plan
from ppmcal.io.results.identification_wording import scale_sentence
from ppmcal.io.results.units import error_words
from ppmcal.model.dataset import Unknown
from ppmcal.notes import Note, about
from ppmcal.wording import abbreviate_list, pluralize

FEWEST = 2
"""The smallest plan that can be asked for."""
SHOWN = 6


def sentences(plan: Plan, wanted: float | None, notes: Sequence[str]) -> list[str]:
    """Return the result in sentences, the most important first."""
    return [measurements(plan), accuracy(plan), *_reached(plan, wanted), diminishing_returns(plan),
            *observability(plan), *effects(plan), *settings(plan), route(plan), instrument(plan),
            candidates(plan), *_undetermined(plan), *_open_ended(plan), *_frame(plan),
            *_scale(plan), *notes]


def findings(plan: Plan, wanted: float | None) -> list[Note]:
    """Return what the user must look at."""
    out = list(plan.notes)
    if wanted is not None and plan.reached is None:
        units, left = plan.mechanism.units, plan.limit[0]
        why = (f"ever more poses leave {units.words(left, 'length', 3)}, in what this instrument "
               "does not see" if left >= wanted else "a million poses would not do")
        out.append(Note(
            f"An accuracy of {units.words(wanted, 'length')} cannot be reached: {why}."))
    if plan.pool.rows.size and plan.pool.left_out:
        total = sum(plan.pool.left_out.values())
        out.append(Note(
            f"{total} of the {total + int(plan.pool.rows.size)} candidates given cannot be "
            f"used: {_counts(plan.pool.left_out)}."))
    if plan.tasks_left_out:
        out.append(Note("Task poses that cannot be judged are left out: "
                        f"{_counts(plan.tasks_left_out)}."))
    lost = [str(n + 1) for n, v in enumerate(plan.route.via) if v not in ("", "home")]
    if lost:
        out.append(Note("No path was found from the row before to row "
                        f"{abbreviate_list(lost, most=SHOWN)}, neither straight nor through home: "
                        "see `via` in poses.csv."))
    return out


def _frame(plan: Plan) -> list[str]:
    """Return what joint values alone cannot show of the frames, and what defines them."""
    return [str(f) for f in about(plan.mechanism.findings, ("gauge",))]


def _scale(plan: Plan) -> list[str]:
    """Return which distance, measured once, would fix the size that joint values do not show."""
    if plan.scale is None or not plan.scale.open:
        return []
    place = plan.pool.pose[plan.offer.pose[plan.rows], :3]
    apart = np.linalg.norm(place[:, None] - place, axis=2)
    first, last = sorted(np.unravel_index(int(np.argmax(apart)), apart.shape))
    return [f"{scale_sentence(in_units(plan.scale, plan.mechanism.units))} It is that of "
            f"the platform between rows {first + 1} and {last + 1}."]


def effects(plan: Plan) -> list[str]:
    """Return how well the effects asked for will be known, the worst of the actuators each."""
    m, offer = plan.mechanism, plan.offer
    whose = {p: (e.kind.name, n) for e in m.effects for n, p in e.parameters.items()}
    if not whose:
        return []
    information = offer.information(plan.rows)
    d = np.sqrt(np.diagonal(information))
    values, vectors = linalg.eigh(information / np.outer(d, d))
    sigmas = np.sqrt(np.sum(vectors**2 / np.maximum(values, 1e-14), axis=1)) / d * offer.scale
    worst: dict[str, tuple[float, str]] = {}
    for c, sigma in zip(offer.kept.tolist(), sigmas.tolist(), strict=True):
        index = offer.problem.free[c] if c < len(offer.problem.free) else -1
        if index not in whose:
            continue
        parameter = m.parameters[index]
        factor, unit = m.units.factor(parameter.quantity), m.units.name(parameter.quantity)
        kind, name = whose[index]
        size, label = sigma / factor, f"{kind} {name}"
        if parameter.reciprocal:
            # what is measured is the compliance: d(1/k) = dk / k^2
            size, label = sigma / parameter.value**2 * factor, f"{kind} 1/{name}"
            above, _, below = unit.partition("/")
            unit = f"{below or 1}/{above}"
        if size > worst.get(label, (0.0, ""))[0]:
            worst[label] = (size, unit)
    known = ", ".join(f"{label} to {size:.3g} {unit}".rstrip()
                      for label, (size, unit) in worst.items())
    return [f"Effects are then known (one standard deviation, the worst actuator): {known}."
            ] if known else []


def measurements(plan: Plan) -> str:
    """Return how many measurements to take, and where they stand."""
    rows, poses = len(plan.rows), len(np.unique(plan.offer.pose[plan.rows]))
    what = pluralize(poses, "pose") + f", {rows} times in all," * (rows != poses)
    return f"Measure {what} as poses.csv lists {'it' if rows == 1 else 'them, in that order'}."


def accuracy(plan: Plan) -> str:
    """Return how exact the machine will then be, and how many random poses would do as much."""
    own = next((p, r) for n, p, r in plan.best if n == len(plan.rows))
    count = len(plan.rows)
    frame = "base's" if plan.instrument.kind.inside else "instrument's"
    known = error_words(plan.mechanism, *own, digits=3)
    text = (f"The calibrated machine is then known to {known} (one standard "
            f"deviation, rms over {plan.tasks} task poses, in the {frame} frame)")
    other = (float(plan.random.position[count - 1]), float(plan.random.rotation[count - 1]))
    if not np.isfinite(other[0]):
        return f"{text}; {count} random measurements do not determine everything."
    twice = reaching(plan.random.position, own[0])
    much = f"{twice} random ones do as well" if twice else (
        f"more than {len(plan.random.position)} random ones would be needed to do as well")
    given = error_words(plan.mechanism, *other, digits=3)
    return f"{text}; {count} random ones give {given}, {much}."


def diminishing_returns(plan: Plan) -> str:
    """Return from how many on one more hardly helps."""
    fewest = f" Fewer than {plan.least} leave something open." if plan.least > 1 else ""
    if plan.pays:
        return (f"From {plan.pays} measurements on, one more lowers that error by less than "
                f"{PAYS:.0%}.{fewest}")
    return (f"Up to {len(plan.planned.position)} measurements (no more were looked at) one more "
            f"lowers that error by {PAYS:.0%} or more.{fewest}")


def observability(plan: Plan) -> list[str]:
    """Return how the information compares with random poses, nothing where that is left out."""
    if not plan.observability:
        return []
    o = [plan.observability[k]["O1"] for k in ("planned", "random")]
    return [f"Observability O1: {o[0]:.3g}; {o[1]:.3g} for as many random poses. With the "
            f"tolerances in, the information on the parameters is {plan.efficiency:.2g} times "
            "theirs (p-th root of the determinant)."]


def settings(plan: Plan) -> list[str]:
    """Return under which settings to measure."""
    out = []
    names = [n for n in plan.columns if n.startswith("dir_")]
    if names:
        ways = np.concatenate([plan.columns[n] for n in names])
        out.append("Come to each pose so that the last move of each joint goes as its dir_ column "
                   f"says ({int((ways > 0).sum())} times upward, {int((ways < 0).sum())} times "
                   "downward).")
    if any(n.startswith("vel_") for n in plan.columns):
        out.append("Trigger while the joints move at the speeds of the vel_ columns.")
    if any(n.startswith("tension_") for n in plan.columns):
        out.append("Pull ropes tight by the forces of the tension_ columns (N), and record what "
                   "they are.")
    for name, unit in (("payload", "kg"), ("temperature", "deg C")):
        if name in plan.columns:
            values, counts = np.unique(plan.columns[name] - (
                273.15 if name == "temperature" else 0.0), return_counts=True)
            out.append(f"{name.capitalize()}: " + ", ".join(
                f"{pluralize(int(c), 'row')} at {v:.6g} {unit}"
                for v, c in zip(values, counts, strict=True)) + ".")
    return out


def route(plan: Plan) -> str:
    """Return how long the path is, and whether all of it is straight."""
    text = (f"The path through the poses is {plan.route.after:.3g} joint ranges long (the longest "
            f"joint's travel of each move), {plan.route.before:.3g} in the order of choice.")
    home = [str(n + 1) for n, v in enumerate(plan.route.via) if v == "home"]
    if home:
        straight = "straight moves" if plan.mechanism.surplus else "straight joint moves"
        text += (f" Go through home to row {abbreviate_list(home, most=SHOWN)}: {straight} would "
                 "meet a singularity or another assembly mode.")
    return text


def instrument(plan: Plan) -> str:
    """Return the instrument in words."""
    i, units = plan.instrument, plan.mechanism.units
    noise = []
    if i.kind.scalar:
        noise.append(f"{i.kind.number} {units.words(i.sigma_value, i.kind.quantity)}")
    elif i.kind.of_poses and not i.kind.blind:
        noise.append(f"position {units.words(i.sigma_position, 'length')}")
    if np.isfinite(i.sigma_rotation):
        noise.append(f"rotation {units.words(i.sigma_rotation, 'angle')}")
    largest: dict[str, float] = {}
    for s, (f, name) in zip(i.sigma_actuator, plan.mechanism.joint_units, strict=True):
        largest[name] = max(largest.get(name, 0.0), float(s) / f)
    if any(largest.values()):
        noise.append("drives up to " + " and ".join(
            f"{v:.4g} {name or '(bare joint value)'}" for name, v in largest.items() if v > 0.0))
    own = "Instrument" if i.chosen else (
        "Instrument (none given; noise a tenth of the median length tolerance"
        + "; with `instrument: {kind: none}` in its sidecar, joint values alone calibrate this "
          "machine" * bool(plan.mechanism.surplus) + ")")
    kind = f"{i.kind} at {i.kind.at}" if i.kind.at else str(i.kind)
    stands = f"frame {_open(i.frame)}, target {_open(i.target)}"
    if not i.kind.of_poses:
        stands = f"offset {_open(i.offset)}" if i.kind.at else (
            f"tilt of the base {_open(i.frame)}, rotation of the sensor {_open(i.target_rotation)}")
    if i.kind.blind:
        return f"Without an instrument: joint values alone, standard deviation {', '.join(noise)}."
    text = f"{own}: {kind}, standard deviation {', '.join(noise)}; {stands}."
    if i.target.fitted and plan.mechanism.motion.turns:
        text += " The unknown target is taken to be near the platform's origin."
    return text


def candidates(plan: Plan) -> str:
    """Return what was chosen from."""
    text = f"Chosen from {len(plan.pool)} candidates"
    if plan.pool.rows.size:
        return f"{text} given."
    refined = ", the last of them the chosen poses after local D-optimal refinement" if (
        plan.refined) else ""
    return f"{text}{refined}; left out were: {_counts(plan.pool.left_out) or 'none'}."


def _reached(plan: Plan, wanted: float | None) -> list[str]:
    if wanted is None or plan.reached is None:
        return []
    size = plan.mechanism.units.words(wanted, "length")
    about = "about " if plan.about else ""
    if not plan.about and plan.reached < FEWEST:
        return [f"{FEWEST} measurements, the fewest that make a plan, reach "
                f"{size} (--count {FEWEST})."]
    return [f"{about.capitalize()}{plan.reached} measurements reach {size}"
            + (" (more of the same; extrapolated)." if plan.about else
               f" (--count {plan.reached}).")]


def _undetermined(plan: Plan) -> list[str]:
    names = plan.offer.dropped
    if not names:
        return []
    return ["Not determined by any candidate, and without a tolerance, so left out: "
            f"{abbreviate_list(names, most=SHOWN)}."]


def _open_ended(plan: Plan) -> list[str]:
    if not plan.open_ended:
        return []
    return [f"No limits are given for {', '.join(plan.open_ended)}: only reach and singularities "
            "bound the poses there; look whether the machine can go to them."]


def _open(value: Unknown) -> str:
    return "unknown" if value.fitted else "known"


def _counts(why: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {w}" for w, n in why.items())
