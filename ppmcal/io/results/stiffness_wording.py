"""Stiffness in sentences, and what the user must look at."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ppmcal.design.statics import AppliedLoad
from ppmcal.design.stiffness import Principal, StiffnessStudy
from ppmcal.io.results.tables import status_counts
from ppmcal.kinematics.loads import only_pull
from ppmcal.kinematics.tables import SINGULAR_HOME, home_singular_value
from ppmcal.linalg import Array, Bools
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.motions import POSE_COORDINATES
from ppmcal.notes import Note

ROUND_OFF = 1e-9
"""What is smaller by this is shown as 0."""
LINEAR = 0.01
"""Deflections above this part of the reach (or rad) are no longer linear to a percent."""
ALIKE = 1.001


def sentences(study: StiffnessStudy) -> list[str]:
    """Return the result in words, the most important first."""
    return [*_at_home(study), *_held_at_home(study), *_tension_at_home(study),
            *_over_poses(study), *study.notes, *_assumptions(study.mechanism, study.tension)]


def findings(study: StiffnessStudy) -> list[Note]:
    """Return what the user must look at."""
    return [*_home_findings(study), *_slack_findings(study), *_map_findings(study)]


def _amount(mechanism: Mechanism, value: float, quantity: str) -> str:
    """Return an SI value in file units, with the machine builder's unit where that differs."""
    if np.isinf(value):
        return "infinite"
    text = mechanism.units.words(value, quantity)
    if quantity == "N/length" and mechanism.units.length in ("m", "in"):
        text += f" ({value / 1e6:.4g} N/um)"
    elif quantity == "length" and mechanism.units.length != "um":
        text += f" ({value / 1e-6:.4g} um)"
    return text


def _at_home(study: StiffnessStudy) -> list[str]:
    """Return what there is to say of home."""
    point, mechanism, found = "the platform origin", study.mechanism, study.home.compliance
    if study.tool.any():
        place = study.tool[[c for c in mechanism.dof if c < 3]] / mechanism.units.factor("length")
        point = f"the tool point {_tuple(place)} {mechanism.units.length} in platform axes"
    if not np.isfinite(found.factor).all():
        return [f"At home the tension leaves {point} no stiffness: the pose is not stable."]
    out = [f"At home, at {point}: translational stiffness "
           f"{_span(mechanism, found.translational(), 'N/length', 'direction')}."]
    turning = found.rotational()
    if turning.values.shape[1]:
        out.append("Rotational stiffness there: "
                   f"{_span(mechanism, turning, 'N.m/angle', 'axis')}.")
    if study.load is not None:
        out.append(_deflection(study, study.load))
    return out


def _span(mechanism: Mechanism, found: Principal, quantity: str, what: str) -> str:
    """Return ``from A (softest, direction ...) to B (stiffest, direction ...)``."""
    values, ways = found.values[0], found.directions[0]
    if np.isinf(values[0]):
        return "infinite: nothing gives way"
    first = _amount(mechanism, float(values[0]), quantity)
    if len(values) == 1 or values[-1] < ALIKE * values[0]:
        return first + ("" if len(values) == 1 else f", the same in every {what}")
    out = []
    for k, beside, name in ((0, 1, "softest"), (-1, -2, "stiffest")):
        low, high = sorted((float(values[k]), float(values[beside])))
        alone = len(values) == 2 or high > ALIKE * low
        near = f", {what} {_tuple(ways[:, k])}" if alone and not np.isinf(values[k]) else ""
        out.append(f"{_amount(mechanism, float(values[k]), quantity)} ({name}{near})")
    return " to ".join(out)


def _deflection(study: StiffnessStudy, load: AppliedLoad) -> str:
    """Return by how far the tool gives way at home."""
    mechanism, home = study.mechanism, study.home
    if not np.isfinite(home.compliance.shares(load.wrench)).any():
        return f"Under {load.words} nothing gives way there."
    moved = home.deflection(load.wrench)
    if np.isnan(moved).any():
        return f"Under {load.words} ropes do not hold the platform there."
    scaled = moved * np.repeat([1.0, mechanism.length_scale], 3)
    whole = max(np.linalg.norm(scaled[:3]), np.linalg.norm(scaled[3:]))
    moved = np.where(np.abs(scaled) > ROUND_OFF * whole, moved, 0.0)
    units, length = mechanism.units, mechanism.units.factor("length")
    axes = [c for c in mechanism.dof if c < 3]
    size = _amount(mechanism, float(np.linalg.norm(moved[:3])), "length")
    out = (f"Under {load.words} the tool there moves {size}: "
           + ", ".join(f"{POSE_COORDINATES[c]} {moved[c] / length:+.3g}" for c in axes)
           + f" {units.length}")
    if any(c >= 3 for c in mechanism.dof):
        turn = float(np.linalg.norm(moved[3:]))
        out += f"; the platform turns {units.words(turn, 'angle', 3)}"
    return out + "."


def _over_poses(study: StiffnessStudy) -> list[str]:
    """Return what there is to say of the poses."""
    mechanism, found, ok = study.mechanism, study.found, study.found.ok
    out = [f"{int(ok.sum())} of {len(ok)} poses are within limits and reach."]
    soft = np.where(ok, found.translational[:, 0], np.nan)
    if not np.isfinite(soft).any():
        return out
    low, high = int(np.nanargmin(soft)), int(np.nanargmax(np.where(np.isinf(soft), np.nan, soft)))
    at_home = float(study.home.compliance.translational().values[0, 0])
    at = [f"{_amount(mechanism, float(soft[n]), 'N/length')} at {_place(study, n)}"
          for n in (low, high)]
    home_too = f"; at home it is {_amount(mechanism, at_home, 'N/length')}"
    out.append(f"The softest direction's translational stiffness goes from {at[0]} to {at[1]}"
               f"{home_too * (not np.isnan(at_home))}.")
    if found.deflection is not None:
        size = np.linalg.norm(found.deflection[:, :3], axis=1)
        if np.isfinite(size).any():
            worst = int(np.nanargmax(size))
            out.append(f"The load moves the tool most at {_place(study, worst)}: "
                       f"{_amount(mechanism, float(size[worst]), 'length')}.")
    return out


def _place(study: StiffnessStudy, row: int) -> str:
    """Return a pose in words, rotations that do not matter left out."""
    mechanism, pose = study.mechanism, study.found.table.pose[row]
    turned = any(c >= 3 and abs(pose[c]) > 1e-9 for c in mechanism.dof)
    parts = []
    for c in mechanism.dof:
        if c < 3 or turned:
            quantity = "length" if c < 3 else "angle"
            # round-off of a coordinate that is solved for is not a place
            small = ROUND_OFF * (mechanism.reach if c < 3 else 1.0)
            value = pose[c] if abs(pose[c]) > small else 0.0
            parts.append(f"{POSE_COORDINATES[c]} {mechanism.units.words(value, quantity)}")
    return ", ".join(parts)


def _assumptions(mechanism: Mechanism, tension: float) -> list[str]:
    """Return what these numbers are, and what they leave out."""
    out = ["Translational stiffness is (C_tt)^-1, force per displacement of a tool that is free "
           "to turn; it is not the translational block of the stiffness matrix."]
    if not mechanism.motion.turns:
        out[0] = ("Stiffness is C^-1; the platform cannot turn in this model, and moments do not "
                  "move it.")
    for a, name in enumerate(mechanism.actuators):
        sharing = [i for i, limb in enumerate(mechanism.limbs) if limb.actuator == a]
        if len(sharing) > 1 and "drive" in mechanism.stiffness[sharing[0]]:
            names = ", ".join(mechanism.limbs[i].name for i in sharing)
            out.append(f"{names} hang on one drive, {name}: one spring, not one for each limb.")
    if mechanism.surplus and only_pull(mechanism).any():
        out.append("Stiffness is that of tight ropes. Under a load a rope without tension holds "
                   "nothing; --tension says how tight they are without it.")
    left = "the parts' own weight" if tension else "preload, the parts' own weight"
    kinds = dict.fromkeys(effect.kind.name for effect in mechanism.effects)
    if kinds:
        left += f", the file's effects ({', '.join(kinds)})"
    out.append(f"What the file gives no stiffness is rigid. Left out: {left}.")
    out.append("The file's stiffnesses carry no uncertainty, so neither do these figures: a "
               "compliance scales as the spring that makes it.")
    return out


def _home_findings(study: StiffnessStudy) -> list[Note]:
    """Return what is wrong with home."""
    out, home, load = list[Note](), study.home, study.load
    if load is not None and _too_far(home.deflection(load.wrench)[None], study.mechanism)[0]:
        out.append(_nonlinear(f"at home {load.words}", ""))
    if not np.isfinite(home.compliance.factor).all():
        out.append(Note("home is not stable under this tension: ropes pull the platform away from "
                        "it. Take less tension, or stiffer ropes"))
    if home.status != "ok":
        out.append(Note(f"home is not a pose to work at: {home.status}: {home.reason}"))
    value = home_singular_value(home.compliance.mechanism)[0]
    if value < SINGULAR_HOME:
        out.append(Note(f"the machine is close to a singularity at home (smallest singular value "
                        f"{value:.2g}): its stiffness there says little"))
    return out


def _held_at_home(study: StiffnessStudy) -> list[str]:
    """Return what surplus limbs hold among themselves at home, of no tension that was asked for."""
    held = study.home.held
    if held is None or held.idle is None or study.tension or not np.isfinite(held.idle).all():
        return []
    size = np.abs(held.idle[0])
    return [f"Without any load limbs hold up to {size.max():.3g} N against each other at home "
            f"({study.conditions[int(size.argmax())]}): the controller commands the nominal "
            "geometry, and this machine has another."]


def _tension_at_home(study: StiffnessStudy) -> list[str]:
    """Return that stiffness has that of the tension in it, and how much that is at home."""
    held = study.home.held
    if held is None or held.geometric is None:
        return []
    said = f"Stiffness counts the ropes' mean tension of {study.tension:g} N"
    without = study.home.untensioned
    if not held.geometric[0].any() or without is None:
        return [f"{said}, where they can be as tight; at home they cannot."]
    if not np.isfinite(study.home.compliance.factor).all():
        return [f"{said}."]
    with_it = study.home.compliance.translational().values[0, 0]
    before = without.translational().values[0, 0]
    return [f"{said}: at home the softest direction has "
            f"{_amount(study.mechanism, float(with_it), 'N/length')} with it, "
            f"{_amount(study.mechanism, float(before), 'N/length')} without."]


def _slack_findings(study: StiffnessStudy) -> list[Note]:
    """Return which ropes have no tension, and where ropes hold no load."""
    out, home, found = list[Note](), study.home.held, study.found
    if home is None or found.held is None or (home.forces is None and found.held.forces is None):
        return out
    under = f"under {study.load.words}" if study.load else "without a load"
    if home.forces is not None and not np.isfinite(home.forces).all():
        out.append(Note(f"at home ropes do not hold the platform {under}: no tensions balance it "
                        "in this pose"))
    elif home.slack[0].any():
        slack = [n for n, s in zip(study.conditions, home.slack[0].tolist(), strict=True) if s]
        out.append(Note(f"at home {', '.join(slack)} {'is' if len(slack) == 1 else 'are'} slack "
                        f"{under}, and hold{'s' * (len(slack) == 1)} nothing"))
    if found.held.forces is None:
        return out
    held = np.isfinite(found.held.forces).all(axis=1)
    lost, slack_there = found.ok & ~held, found.ok & held & found.held.slack.any(axis=1)
    for rows, what in ((lost, "ropes do not hold the platform"), (slack_there, "a rope is slack")):
        if rows.any():
            out.append(Note(f"{under} {what} at {int(rows.sum())} of {int(found.ok.sum())} poses"))
    return out


def _map_findings(study: StiffnessStudy) -> list[Note]:
    """Return what is wrong with the poses."""
    found, load = study.found, study.load
    if not found.ok.any():
        return [Note("no pose has a stiffness: " + ", ".join(
            f"{count} {status}" for status, count in status_counts(found.table.status).items()))]
    if found.deflection is None or load is None:
        return []
    far = int(np.sum(_too_far(found.deflection, study.mechanism)))
    return [_nonlinear(load.words, f", at {far} of {int(found.ok.sum())} poses")] if far else []


def _too_far(moved: Array, mechanism: Mechanism) -> Bools:
    """Return which deflections (N, 6) are too far for a linear model (N,)."""
    return np.asarray(np.maximum(np.linalg.norm(moved[:, :3], axis=1) / mechanism.reach,
                                 np.linalg.norm(moved[:, 3:], axis=1)) > LINEAR)


def _nonlinear(load: str, where: str) -> Note:
    return Note(f"{load} moves the tool by more than {LINEAR:.0%} of the reach, or turns it by "
                f"more than {LINEAR} rad{where}: too far for a linear model")


def _tuple(values: Sequence[float] | Array) -> str:
    """Return ``(0.81, -0.58, 0)``."""
    return "(" + ", ".join(f"{v + 0.0:.4g}" for v in np.round(np.asarray(values), 4)) + ")"
