"""A machine as the text of a MuJoCo model: lengths in m, angles in rad, at home as it is read."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ppmcal import algebra as cga
from ppmcal.controllers.mjcf.limbs import AXES, BodyJoint, LimbParts, Part, moved, parts_of
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.inverse import home_state
from ppmcal.linalg import Array
from ppmcal.model.mechanism import Limb, Mechanism
from ppmcal.model.motions import POSE_COORDINATES

STEP, TIME = "0.0005", "0.001"
"""Time step and time constant of closed loops, s: at rest 100 N on 1 kg open one by 0.01 um."""
LIGHT, HEAVY = 0.05, 1.0
"""Masses of a link and of the platform, kg: no file of ours says what they are."""
PASSIVE_INERTIA, PASSIVE_DAMPING = 1e-2, 1e-2
SLIDE, HINGE, ROPE = (1.0, 2e6, 4e3), (0.1, 2e5, 3e2), (0.0, 1e5, 4e2)
"""Of a drive that slides, turns, winds: inertia of its rotor, stiffness and damping of its servo,
per m or rad of what it moves."""
PULL = 1e4
"""Most that a rope pulls, N."""
AHEAD = 0.1
"""Where the second point of an axis is that two bodies share, as a part of the machine's reach."""
PLATFORM, SITE = "platform", "platform"

Home = Mapping[str, Any]
"""BodyJoint -> how far it is at home from where bodies are drawn: rad, m or a matrix (3, 3)."""


@dataclass
class _Model:
    """What is collected for the file; ``home``: see :data:`Home`."""

    mechanism: Mechanism
    home: Home
    world: ET.Element
    platform: ET.Element
    equality: ET.Element = field(default_factory=lambda: ET.Element("equality"))
    tendons: ET.Element = field(default_factory=lambda: ET.Element("tendon"))
    actuators: ET.Element = field(default_factory=lambda: ET.Element("actuator"))
    leaders: dict[int, tuple[str, float]] = field(default_factory=dict)


def limb_parts(mechanism: Mechanism) -> tuple[LimbParts, ...]:
    """Return each limb as parts, at the present values."""
    return tuple(parts_of(limb.kind, values) for limb, values in zip(
        mechanism.limbs, Model(mechanism).limb_values, strict=True))


def text(mechanism: Mechanism, pose: Array, home: Home, comment: str = "",
         only: Sequence[int] | None = None) -> str:
    """Return the model of a machine, or of ``only`` some of its limbs.

    Args:
        mechanism: the machine; its effects are left out.
        pose: the platform's motor (8,) at home.
        home: how far each joint is at home; those that are missing are where u = 0, unturned.
        comment: what stands first, line by line.
        only: indices of limbs.
    """
    root = ET.Element("mujoco", model=mechanism.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = ET.SubElement(root, "option", timestep=STEP, integrator="implicitfast",
                           gravity=_row(9.80665 * mechanism.gravity))
    ET.SubElement(option, "flag", refsafe="disable", contact="disable")
    defaults = ET.SubElement(root, "default")
    ET.SubElement(defaults, "geom", contype="0", conaffinity="0", mass="0")
    ET.SubElement(defaults, "equality", solref=f"{TIME} 1", solimp="0.9999 0.9999 0.001 0.5 2")
    world = ET.SubElement(root, "worldbody")
    platform = _platform(mechanism, pose, world)
    made = _Model(mechanism, home, world, platform)
    for index, parts in enumerate(limb_parts(mechanism)):
        if only is None or index in only:
            _add(made, index, parts)
    root.extend(part for part in (made.equality, made.tendons, made.actuators) if len(part))
    if only is None:
        keys = ET.SubElement(root, "keyframe")
        ET.SubElement(keys, "key", name="home", ctrl=_row(
            [home_state(mechanism).q[mechanism.actuators.index(a.attrib["name"])]
             for a in made.actuators]))
    ET.indent(root)
    remark = "".join(f"  {line.replace('--', '-')}\n" for line in comment.splitlines())
    return (f"<!--\n{remark}-->\n" if remark else "") + ET.tostring(root, "unicode") + "\n"


def _platform(mechanism: Mechanism, pose: Array, world: ET.Element) -> ET.Element:
    """Return the platform's body at home, on joints for the coordinates that it has."""
    body = _body(world, PLATFORM, pose, HEAVY, mechanism.reach)
    own, back = mechanism.motion.coordinates, cga.rotation_matrix(pose).T
    if len(own) == len(POSE_COORDINATES):
        ET.SubElement(body, "freejoint", name=PLATFORM)
        own = ()
    for name in (c for c in own if c in AXES):
        ET.SubElement(body, "joint", name=f"{PLATFORM}_{name}", type="slide",
                      axis=_row(back @ AXES[name]))
    if "rx" in own:
        ET.SubElement(body, "joint", name=f"{PLATFORM}_r", type="ball")
    elif "rz" in own:
        ET.SubElement(body, "joint", name=f"{PLATFORM}_rz", type="hinge",
                      axis=_row(back @ AXES["z"]))
    ET.SubElement(body, "site", name=SITE, pos="0 0 0")
    return body


def _add(made: _Model, index: int, parts: LimbParts) -> None:
    """Add one limb, and what closes its loop."""
    limb, reach = made.mechanism.limbs[index], made.mechanism.reach
    base, ends = _chain(made, limb, made.world, parts.base, limb.name)
    platform, hooks = _chain(made, limb, made.platform, parts.platform, f"{limb.name}_platform")
    for what in ("", *parts.held):
        along = np.zeros(3) if not what else AHEAD * reach * AXES[what]
        pair = [f"{limb.name}_{end}" + (f"_{what}" if what else "") for end in ("end", "hook")]
        for name, body, motor in ((pair[0], base, ends), (pair[1], platform, hooks)):
            ET.SubElement(body, "site", name=name, pos=_row(cga.move_point(motor, along)))
        if not parts.rope:
            ET.SubElement(made.equality, "connect", site1=pair[0], site2=pair[1])
    if parts.rope:
        rope = ET.SubElement(made.tendons, "spatial", name=limb.name)
        for name in pair:
            ET.SubElement(rope, "site", site=name)
        _drive(made, limb, limb.name, ROPE)


def _chain(made: _Model, limb: Limb, body: ET.Element, parts: Sequence[Part], name: str
           ) -> tuple[ET.Element, Array]:
    """Add bodies for the joints of a chain; return the last, and where the chain ends in it."""
    at, number = cga.identity_motor(), 0
    turned: dict[bytes, str] = {}
    for part in parts:
        if not isinstance(part, BodyJoint):
            at = cga.compose(at, part)
            continue
        number += 1
        own = name if part.driven else f"{name}_{number}"
        by = made.home.get(own, np.eye(3) if part.kind == "ball" else 0.0)
        at = cga.compose(at, moved(part, by))
        if body is not made.world:
            _bar(body, cga.translation(at), made.mechanism.reach)
        body = _body(body, f"{own}_link" if part.driven else own, at, LIGHT, made.mechanism.reach)
        _joint(made, limb, body, part, own, by)
        if part.back:
            ET.SubElement(made.equality, "joint", joint1=own,
                          joint2=turned[part.axis.tobytes()], polycoef="0 -1 0 0 0")
        elif part.kind == "hinge":
            turned.setdefault(part.axis.tobytes(), own)
        at = cga.identity_motor()
    if body is not made.world:
        _bar(body, cga.translation(at), made.mechanism.reach)
    return body, at


def _joint(made: _Model, limb: Limb, body: ET.Element, part: BodyJoint, name: str, by: Any) -> None:
    """Add a joint to its body; a driven one counts as its encoder does, times the ratio."""
    if not part.driven:
        made_of = {"name": name, "type": part.kind, "armature": _number(PASSIVE_INERTIA),
                   "damping": _number(PASSIVE_DAMPING)}
        axis = {} if part.kind == "ball" else {"axis": _row(part.axis)}
        ET.SubElement(body, "joint", made_of | axis)
        return
    servo = SLIDE if part.kind == "slide" else HINGE
    offset, _ = _counts(made.mechanism, limb)
    ET.SubElement(body, "joint", name=name, type=part.kind, axis=_row(part.axis),
                  ref=_number(by - offset), armature=_number(servo[0]))
    _drive(made, limb, name, servo)


def _counts(mechanism: Mechanism, limb: Limb) -> tuple[float, float]:
    """Return a limb's offset, m or rad, and ratio."""
    values = limb.slots.values(mechanism.values)
    return float(values.get("offset", 0.0)), float(values.get("ratio", 1.0))


def _drive(made: _Model, limb: Limb, moves: str, servo: tuple[float, float, float]) -> None:
    """Add the actuator of a drive; of limbs that share one, the others follow the first."""
    offset, ratio = _counts(made.mechanism, limb)
    if limb.actuator in made.leaders:
        leader, first = made.leaders[limb.actuator]
        ET.SubElement(made.equality, "joint", joint1=moves, joint2=leader,
                      polycoef=f"0 {_number(ratio / first)} 0 0 0")
        return
    made.leaders[limb.actuator] = moves, ratio
    rope = limb.kind.pulls_only
    gain, damping = servo[1] * ratio**2, servo[2] * ratio**2
    added = gain * offset / ratio if rope else 0.0
    general = {
        "name": made.mechanism.actuators[limb.actuator], "tendon" if rope else "joint": moves,
        "gear": _number(1.0 / ratio), "gainprm": _number(gain), "biastype": "affine",
        "biasprm": _row([added, -gain, -damping])}
    ends = made.mechanism.limits[limb.actuator]
    if np.isfinite(ends).all():
        general["ctrlrange"] = _row(ends)
    if rope:
        pull = PULL * abs(ratio)
        general["forcerange"] = _row([-pull, 0.0] if ratio > 0.0 else [0.0, pull])
    ET.SubElement(made.actuators, "general", general)


def _body(parent: ET.Element, name: str, at: Array, mass: float, reach: float) -> ET.Element:
    turn = np.roll(_quaternion(at), 1)
    body = ET.SubElement(parent, "body", name=name, pos=_row(cga.translation(at)), quat=_row(turn))
    ET.SubElement(body, "inertial", pos="0 0 0", mass=_number(mass),
                  diaginertia=_row([0.4 * mass * (0.1 * reach) ** 2] * 3))
    return body


def _quaternion(motor: Array) -> Array:
    """Return the unit quaternion (4,) of a motor's turn, scalar last."""
    vector = cga.rotation_vector(motor)
    angle = float(np.linalg.norm(vector))
    return np.array([*(0.5 * np.sinc(0.5 * angle / np.pi) * vector), np.cos(0.5 * angle)])


def _bar(body: ET.Element, end: Array, reach: float) -> None:
    """Draw a bar from a body's origin."""
    if np.linalg.norm(end) > 1e-6 * reach:
        ET.SubElement(body, "geom", type="capsule", fromto=_row([0.0, 0.0, 0.0, *end]),
                      size=_number(0.005 * reach))


def _row(values: Any) -> str:
    return " ".join(_number(v) for v in np.asarray(values, dtype=float))


def _number(value: float) -> str:
    return f"{float(value) + 0.0:.16g}"


