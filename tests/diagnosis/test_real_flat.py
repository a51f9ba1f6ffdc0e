"""A real printer's bed, touched: nothing is learned, and nothing commanded, along it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT

import ppmcal

FLAT = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data")) / "hard/flat-reprap"


@pytest.mark.slow
@pytest.mark.skipif(not FLAT.is_dir(), reason="real measurements are not at hand (PPMCAL_DATA)")
def test_touches_of_a_bed_teach_heights_only(tmp_path: Path) -> None:
    ppmcal.import_config("reprap", FLAT / "config.g", mesh=FLAT / "heightmap.csv").save(tmp_path)
    found = ppmcal.diagnose(tmp_path / "machine.yaml", tmp_path / "mesh_heightmap.csv")
    learned = [e for e in found.mechanism.effects if e.kind.name == "learned"]
    assert {e.kind.written(found.mechanism.units)["acts"] for e in learned} <= {"z"}
    sent = ppmcal.compensate(found, np.array([[0, 0, 0], [100, 0, 0], [-100, 0, 0], [0, 100, 0]]),
                             frame="base").compensation
    # of a machine whose towers are known to 1 mm and half a degree
    assert np.nanmax(sent.position_before) < 5e-3
