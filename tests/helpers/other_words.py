"""One campaign of a machine in space, written down as another person would have written it."""

import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

import ppmcal as face

LENGTHS = {"mm": 1.0, "m": 1e-3, "um": 1e3, "in": 1 / 25.4}
ANGLES = {"deg": 1.0, "rad": np.pi / 180.0}
IN_LENGTHS = ("length", "proximal", "distal", "lateral")
POSE = ("x", "y", "z", "rx", "ry", "rz")


@dataclass(frozen=True)
class Campaign:
    """A mechanism tree of plain points, sidecar, rows and targets, in mm and degrees."""

    tree: dict[str, Any]
    side: dict[str, Any]
    table: dict[str, Any]
    targets: dict[str, Any]
    truth: dict[str, float]


@dataclass(frozen=True)
class Words:
    """How it is written: the order of things, units, names, and where the axes are.

    ``base`` and ``seen`` are a rotation vector and a shift, mm, of base and measuring frame.
    """

    rows: Any = None
    limbs: Any = None
    columns: int | None = None
    units: tuple[str, str] = ("mm", "deg")
    names: dict[str, str] = field(default_factory=dict)
    base: tuple[Any, Any] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    seen: tuple[Any, Any] = ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


PLAIN = Words()


def cartesian(point):
    """Return a point that may be given as radius, angle and z, shared or not, as [x, y, z]."""
    if not isinstance(point, dict):
        return [float(v) for v in point]
    radius, angle, z = ((v["value"] if isinstance(v, dict) else v)
                        for v in (point[k] for k in ("radius", "angle", "z")))
    turn = np.radians(angle)
    return [float(radius * np.cos(turn)), float(radius * np.sin(turn)), float(z)]


def plainly(kind):
    """Return the tree of a machine that comes with ppmcal: plain points, no two limbs alike."""
    tree = yaml.safe_load(face.shipped(kind).read_text())
    for i, limb in enumerate(tree["limbs"]):
        for k, end in enumerate(("base", "platform")):
            point = np.array(cartesian(limb[end]["point"]))
            # no symmetry: what is equal in size would be chosen by name
            away = 0.01 * np.linalg.norm(point) * np.array([i, -k * i, 0.3 + i * k])
            limb[end]["point"] = [float(v) for v in point + away * np.sin(2.0 + 3.0 * i + k)]
        for slot, value in limb["base"].items():
            if isinstance(value, dict):
                limb["base"][slot] = value["value"]
        for slot in IN_LENGTHS:
            if isinstance(limb.get(slot), dict):
                limb[slot] = limb[slot]["value"]
    for key in ("limits", "free"):
        tree.pop(key, None)
    return tree


def campaign(kind, count, seed=3, wrong=(5, 40.0), **scenario):
    """Return rows of a machine, one of them off by so many sigma, frame and target unknown.

    The targets are five of the measured poses, one of them far out of reach.
    """
    tree = plainly(kind)
    plan = yaml.safe_load(face.shipped(kind, scenario=True).read_text())
    plan["poses"]["random"]["count"] = count
    made = face.simulate(tree, plan | scenario, seed=seed)
    texts = made.files()
    side = yaml.safe_load(str(texts["measurements.yaml"]))
    side |= {"frame": "unknown", "target": "unknown"}
    frame = made.to_frame()
    table = {c: np.array(frame[c], float) for c in frame
             if c.startswith("q_") or c in POSE or c in ("dir_" + n for n in (
                 limb["name"] for limb in tree["limbs"]))}
    row, sigmas = wrong
    table["x"][row] += sigmas * side["instrument"]["sigma"]["position"]
    asked = {c: table[c][[0, 7, 8, 9, 10]].copy() for c in POSE if c in table}
    asked["z"][2] += 1e4
    truth = yaml.safe_load(str(texts["truth.json"]))["parameters"]
    return Campaign(tree, side, table, asked, truth)


def _moved(points, motion):
    """Return points (..., 3) turned and shifted."""
    return Rotation.from_rotvec(motion[0]).apply(np.asarray(points, float)) + motion[1]


def _poses(table, motion):
    """Return columns of a pose table as another frame has them, degrees."""
    out = dict(table)
    at = _moved(np.stack([table[c] for c in "xyz"], axis=-1), motion)
    out |= {c: at[..., i] for i, c in enumerate("xyz")}
    if "rx" in table:
        turns = Rotation.from_rotvec(np.radians(np.stack([table[c] for c in POSE[3:]], axis=-1)))
        vectors = np.degrees((Rotation.from_rotvec(motion[0]) * turns).as_rotvec())
        out |= {c: vectors[..., i] for i, c in enumerate(POSE[3:])}
    return out


def _in_units(table, length, angle, drive):
    """Return columns in other units; ``drive``: the factor of joint values."""
    return {c: v * (drive if c.startswith("q_") else angle if c in POSE[3:] else
                    length if c in POSE else 1.0) for c, v in table.items()}


@dataclass(frozen=True)
class Written:
    """A campaign in other words: what files would hold, and how to read it back."""

    tree: dict[str, Any]
    side: dict[str, Any]
    table: dict[str, Any]
    targets: dict[str, Any]
    words: Words

    @property
    def old(self):
        """New name -> old name of each limb."""
        return {new: old for old, new in self.words.names.items()}

    def machine(self):
        """Return the mechanism as it is read."""
        return face.load(self.tree)

    def data(self, machine, name="run"):
        """Return the data sets as they are read."""
        return face.read_data(machine, self.table, sidecar=self.side, name=name)


def written(one, words=PLAIN):
    """Return a campaign in other words."""
    tree, side = copy.deepcopy(one.tree), copy.deepcopy(one.side)
    names = words.names or {limb["name"]: limb["name"] for limb in tree["limbs"]}
    turning = tree["limbs"][0]["kind"] == "(R)US"
    length, angle = LENGTHS[words.units[0]], ANGLES[words.units[1]]
    drive = angle if turning else length
    level = tree["motion"] == "translational"
    for limb in tree["limbs"]:
        limb["name"] = names[limb["name"]]
        _turn(limb, words.base, level)
        for end in ("base", "platform"):
            limb[end]["point"] = [float(v) * length for v in limb[end]["point"]]
        limb |= {s: float(limb[s]) * length for s in IN_LENGTHS if s in limb}
    home = _poses({c: np.float64(v) for c, v in tree["home"]["pose"].items()}, words.base)
    tree["home"] = {"pose": {c: float(v) for c, v in _in_units(home, length, angle, 1.0).items()}}
    tree["gravity"] = [float(v) for v in Rotation.from_rotvec(words.base[0]).apply([0, 0, -1])]
    tree["tolerances"] = {k: v * (angle if k == "angle" else drive if k == "offset" else length)
                          for k, v in tree["tolerances"].items()}
    tree["units"] = side["units"] = dict(zip(("length", "angle"), words.units, strict=True))
    side["instrument"]["sigma"] = {
        k: v * {"position": length, "rotation": angle, "actuator": drive}[k]
        for k, v in side["instrument"]["sigma"].items()}
    table, targets = (_in_units({_renamed(c, names): v for c, v in _poses(t, words.seen).items()},
                                length, angle, drive) for t in (one.table, one.targets))
    if words.limbs is not None:
        tree["limbs"] = [tree["limbs"][i] for i in words.limbs]
    if words.rows is not None:
        table = {c: v[words.rows] for c, v in table.items()}
    if words.columns is not None:
        order = np.random.default_rng(words.columns).permutation(len(table))
        table = {list(table)[i]: table[list(table)[i]] for i in order}
    return Written(tree, side, table, targets, words)


def _turn(limb, motion, level):
    """Put a limb into other base axes; a platform that stays level turns with them."""
    turn = Rotation.from_rotvec(motion[0])
    limb["base"]["point"] = _moved(limb["base"]["point"], motion)
    for slot in ("axis", "direction", "zero"):
        if slot in limb["base"]:
            limb["base"][slot] = [float(v) for v in turn.apply(limb["base"][slot])]
    if level:
        limb["platform"]["point"] = turn.apply(limb["platform"]["point"])


def _renamed(column, names):
    kind, _, joint = column.partition("_")
    return f"{kind}_{names[joint]}" if joint else column
