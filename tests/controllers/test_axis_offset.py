"""No controller knows the axis offset of a universal joint: fitted around, and told."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml
from helpers.paths import ROOT

from ppmcal.controllers.klipper import controller as klipper
from ppmcal.controllers.linuxcnc import controller as linuxcnc
from ppmcal.io import read_mechanism


@pytest.mark.long_cases("delta-linear-1-export")
@pytest.mark.slow
@pytest.mark.parametrize(("config", "limb", "export"), [
    ("6-UPS", 2, linuxcnc.export), ("delta-linear", 1, klipper.export)])
def test_an_offset_is_fitted_around_and_told(config: str, limb: int, export, tmp_path: Path
                                             ) -> None:
    tree = yaml.safe_load((ROOT / f"configs/{config}.yaml").read_text(encoding="utf-8"))
    tree["limbs"][limb]["base"] |= {"axis": [0, 1, 0], "axis_offset": {"value": 4, "nominal": 0}}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree), encoding="utf-8")
    found = export(read_mechanism(tmp_path / "m.yaml"), None, None)
    (lack,) = found.not_expressed
    name = tree["limbs"][limb]["name"]
    assert lack.parameters == (f"{name}.base.axis_offset",)
    assert "4 mm apart" in lack.what
    # a strut that is 4 mm off misses by millimetres; what is left is its change over the poses
    assert found.before.rms > 1e-3
    assert lack.cost is not None
    assert lack.cost.rms == pytest.approx(found.after.rms, rel=1e-3)
    assert 0.0 < found.after.rms < 0.2 * found.before.rms
