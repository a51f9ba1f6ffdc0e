"""Machines with more closure equations than their platform has freedoms."""

import numpy as np
import yaml

from ppmcal.io.mechanism_reader import read_mechanism

CABLES = {"c0": (2900.0, 0.0, 90.0, -60.0), "c1": (2900.0, 2400.0, 90.0, 60.0),
          "c2": (0.0, 2400.0, -90.0, 60.0), "c3": (0.0, 0.0, -90.0, -60.0)}


def cables(motion="planar", **more):
    """Return the file of a platform on four cables in the plane, mm."""
    limbs = [{"name": name, "kind": "rope", "base": {"point": [x, y]},
              "platform": {"point": [px, py]}} for name, (x, y, px, py) in CABLES.items()]
    return {"format": "ppmcal/mechanism/1", "name": "cables", "units": {"length": "mm",
            "angle": "rad"}, "motion": motion, "limbs": limbs,
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


def written(folder, tree, name="m.yaml"):
    """Write a mechanism file; return its path."""
    path = folder / name
    path.write_text(yaml.safe_dump(tree))
    return path


def machine(folder, tree):
    """Return the mechanism that a file says."""
    return read_mechanism(written(folder, tree))
