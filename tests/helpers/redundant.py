"""Machines with more closure equations than their platform has freedoms."""

import numpy as np
import yaml
from scipy.optimize import least_squares

from ppmcal import algebra as cga
from ppmcal.io.mechanism_reader import read_mechanism

CABLES = {"c0": (2900.0, 0.0, 90.0, -60.0), "c1": (2900.0, 2400.0, 90.0, 60.0),
          "c2": (0.0, 2400.0, -90.0, 60.0), "c3": (0.0, 0.0, -90.0, -60.0)}


def cables(offset=0, **more):
    """Return the file of a platform on four cables in the plane, mm."""
    limbs = [{"name": name, "kind": "rope", "base": {"point": [x, y]}, "offset": offset,
              "platform": {"point": [px, py]}} for name, (x, y, px, py) in CABLES.items()]
    return {"format": "ppmcal/mechanism/1", "name": "cables", "units": {"length": "mm",
            "angle": "rad"}, "motion": "planar", "limbs": limbs,
            "home": {"pose": {"x": 1400, "y": 1100, "rz": 0}},
            "tolerances": {"point": 5, "offset": 5}, **more}


def stewart(legs=7):
    """Return the file of a platform on that many struts, mm."""
    angles = 360.0 / legs * np.arange(legs)
    limbs = [{"name": f"leg{i + 1}", "kind": "U(P)S",
              "base": {"point": {"radius": 600 + 20 * (i % 3), "angle": float(a), "z": 0}},
              "platform": {"point": {"radius": 300, "angle": float(a + 35 * (-1) ** i), "z": 0}}}
             for i, a in enumerate(angles)]
    return {"format": "ppmcal/mechanism/1", "name": "stewart", "units": {"length": "mm",
            "angle": "deg"}, "motion": "spatial", "limbs": limbs,
            "home": {"pose": {"x": 0, "y": 0, "z": 500, "rx": 0, "ry": 0, "rz": 0}},
            "tolerances": {"point": 0.5, "offset": 0.5, "angle": 0.1}}


def gapped(tree, sizes=(0.3, 0.1, 0.6, 0.2)):
    """Return a file whose limbs may gap, one after the other by ``sizes``, its length units."""
    names = [limb["name"] for limb in tree["limbs"]]
    return {**tree, "closure": {"sigma": {
        name: sizes[i % len(sizes)] for i, name in enumerate(names)}}}


def written(folder, tree, name="m.yaml"):
    """Write a mechanism file; return its path."""
    path = folder / name
    path.write_text(yaml.safe_dump(tree))
    return path


def machine(folder, tree):
    """Return the mechanism that a file says."""
    return read_mechanism(written(folder, tree))


def rope_cage():
    """Return the file of a platform on eight ropes in space, mm."""
    corners = [(x, y, z) for z in (0, 2000) for x, y in ((0, 0), (3000, 0), (3000, 2500),
                                                         (0, 2500))]
    hooks = [(x, y, z) for z in (150, -150) for x, y in ((-200, -150), (200, -150), (200, 150),
                                                         (-200, 150))]
    limbs = [{"name": f"r{i + 1}", "kind": "rope", "base": {"point": list(corner)},
              "platform": {"point": list(hook)}}
             for i, (corner, hook) in enumerate(zip(corners, hooks, strict=True))]
    return {"format": "ppmcal/mechanism/1", "name": "cage", "units": {"length": "mm",
            "angle": "deg"}, "motion": "spatial", "limbs": limbs,
            "home": {"pose": {"x": 1500, "y": 1250, "z": 1000, "rx": 0, "ry": 0, "rz": 0}},
            "tolerances": {"point": 5, "offset": 5}}


def belts():
    """Return the file of a router on four belts in the plane, whose ends meet in one point, mm."""
    at = {"bl": (0, 0), "br": (3000, 0), "tr": (3000, 2100), "tl": (0, 2100)}
    one = {"x": {"value": 0, "fixed": True}, "y": {"value": 0, "fixed": True}}
    limbs = [{"name": name, "kind": "rope", "base": {"point": list(place)},
              "platform": {"point": one}, "offset": {"value": 0, "fixed": True}}
             for name, place in at.items()]
    return {"format": "ppmcal/mechanism/1", "name": "belts", "units": {"length": "mm",
            "angle": "deg"}, "motion": "planar-point", "limbs": limbs,
            "home": {"pose": {"x": 1500, "y": 1050}}, "tolerances": {"point": 20}}


def alone(tree, half_range, count=60, sigma=1e-6, **more):
    """Return a scenario of joint values alone about home, in the machine's units."""
    return {"format": "ppmcal/scenario/1", "units": tree["units"],
            "poses": {"random": {"center": tree["home"]["pose"], "half_range": half_range,
                                 "count": count}},
            "errors": {"random": {"scale": 1.0}}, "frame": "known", "target": "known",
            "instrument": {"kind": "none", "sigma": {"actuator": sigma}}, "seed": 7, **more}


def apart(mechanism, poses, others):
    """Return how far poses (N, 8) are from others, m: frames of base and platform laid together."""
    base, body = list(mechanism.motion.frame_parts), [
        c for c in range(6) if c < mechanism.motion.axes or c in mechanism.dof]

    def left(x):
        frame, own = np.zeros((1, 6)), np.zeros((1, 6))
        frame[:, base], own[:, body] = x[:len(base)], x[len(base):]
        first, last = (cga.motor_from_rotation_vector(v[:, 3:], v[:, :3]) for v in (frame, own))
        laid = cga.compose(first, cga.compose(poses, last))
        turn = cga.rotation_vector(cga.compose(laid, cga.reverse(others)))
        away = cga.translation(laid) - cga.translation(others)
        # a platform that does not turn has nothing of its own turned
        size = mechanism.length_scale if mechanism.motion.turns else 0.0
        return np.concatenate([away, turn * size], axis=1).ravel()

    found = least_squares(left, np.zeros(len(base) + len(body)), xtol=1e-15, ftol=1e-15,
                          gtol=1e-15)
    return float(np.abs(found.fun).max())
