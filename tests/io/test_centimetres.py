"""Centimetres are a unit wherever millimetres are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT

import ppmcal
from ppmcal.units import LENGTHS, Units


@pytest.mark.parametrize("where", ["sidecar", "read", "header"])
def test_joints_in_centimetres_are_those_in_millimetres(tmp_path: Path, where: str) -> None:
    mechanism = ppmcal.load(ROOT / "configs" / "3-RPR.yaml")
    rows = np.array([[400.0, 410.5, 420.25, 500.0, 260.0, 25.0],
                     [430.0, 400.5, 410.25, 510.0, 250.0, 20.0]])
    names = [*(f"q_{a}" for a in mechanism.actuators), "x", "y", "rz"]
    sidecar = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
               "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.01}},
               "frame": "known", "target": "known"}
    found = []
    for unit in ("mm", "cm"):
        scale = np.ones(6)
        heads, own = list(names), yaml.safe_load(yaml.safe_dump(sidecar))
        scale[:3] = LENGTHS["mm"] / LENGTHS[unit]
        if where == "sidecar":
            scale[3:5] = scale[0]
            own["units"]["length"] = unit
            own["instrument"]["sigma"]["position"] *= float(scale[0])
        elif where == "read":
            own["read"] = {"units": dict.fromkeys(names[:3], unit)}
        else:
            heads[:3] = [f"{n} [{unit}]" for n in names[:3]]
        path = tmp_path / f"{unit}.csv"
        path.write_text("\n".join([",".join(heads), *(",".join(map(repr, map(float, row)))
                                                      for row in rows * scale)]) + "\n")
        path.with_suffix(".yaml").write_text(yaml.safe_dump(own))
        (one,) = ppmcal.read_data(mechanism, path)
        found.append(one)
    np.testing.assert_allclose(found[1].q, found[0].q, rtol=1e-14)
    np.testing.assert_allclose(found[1].position, found[0].position, rtol=1e-13)


def test_a_file_in_centimetres_says_so() -> None:
    units = Units("cm", "deg")
    assert units.words(0.0123, "length") == "1.23 cm" and units.name("N/length") == "N/cm"
