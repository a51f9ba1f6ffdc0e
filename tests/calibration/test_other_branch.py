"""A machine measured with the other elbow than its file has: told, and not commanded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT

import ppmcal
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.tables import inverse_table
from ppmcal.linalg import Array


def poses(count: int, size: float) -> Array:
    """Return poses x, y, mm, and rz, deg, about home."""
    rng = np.random.default_rng(4)
    return rng.uniform(-1.0, 1.0, (count, 3)) * [size, size, 5.0]


def measured(folder: Path, elbow: int) -> tuple[Path, Path]:
    """Return the file's machine, and measurements of one that stands with all elbows ``elbow``."""
    tree = yaml.safe_load((ROOT / "configs" / "3-RRR-1.yaml").read_text(encoding="utf-8"))
    file = folder / "machine.yaml"
    file.write_text(yaml.safe_dump(tree))
    real = folder / "real.yaml"
    for limb in tree["limbs"]:
        limb["elbow"] = elbow
        limb["proximal"] += 0.3
    real.write_text(yaml.safe_dump(tree))
    wanted = poses(60, 30.0)
    full = np.zeros((60, 6))
    full[:, [0, 1, 5]] = wanted * [1e-3, 1e-3, np.pi / 180.0]
    table = inverse_table(Model(ppmcal.load(real)), full)
    rng = np.random.default_rng(5)
    rows = np.column_stack([wanted + rng.standard_normal(wanted.shape) * [0.01, 0.01, 0.005],
                            np.degrees(table.q)])
    names = ",".join(f"q_{a}" for a in ppmcal.load(file).actuators)
    data = folder / "m.csv"
    np.savetxt(data, rows, delimiter=",", header=f"x,y,rz,{names}", comments="")
    data.with_suffix(".yaml").write_text(yaml.safe_dump({
        "format": "ppmcal/dataset/1", "name": "m", "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.005}},
        "frame": "known", "target": "known"}))
    return file, data


@pytest.mark.parametrize("other", [False, True])
@pytest.mark.slow
def test_the_branch_is_checked_and_told(tmp_path: Path, other: bool) -> None:
    own = ppmcal.load(ROOT / "configs" / "3-RRR-1.yaml").limbs[0].branch or 1
    file, data = measured(tmp_path, -own if other else own)
    found = ppmcal.identify(file, data)
    told = [f for f in found.findings if "in the opposite branch" in f]
    assert len(told) == 3 * other
    # it fits as well: nothing else says so
    assert not any("stated noise" in f for f in found.findings)
    assert sum("opposite branch" in f for f in ppmcal.check(file, data).findings) == 3 * other
    sent = ppmcal.compensate(found, poses(8, 20.0), path=False)
    if other:
        assert len(sent.refused) == 8
        assert all("in the opposite branch to the measured one" in why for _, why in sent.refused)
    else:
        assert not sent.refused
