"""Calibrations of a real printer by heights and distances, and by its mesh alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from helpers.commands import ppmcal
from helpers.paths import ROOT

PRINTER = (Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data"))
           / "hard/fading-backlash/printer.cfg")


@pytest.mark.long
@pytest.mark.skipif(not PRINTER.is_file(), reason="no shared data here")
def test_calibrations_that_saw_different_things_have_not_changed(tmp_path: Path) -> None:
    """One does not know the height at all, and is hundreds of millimetres off: that is no change.

    Either way round; and what noise makes of the platform is no more than what it can be.
    """
    ppmcal("import", "klipper", PRINTER, "--mesh", "default", "--out", "bed", "--quiet",
           cwd=tmp_path)
    ppmcal("identify", "bed/machine.yaml", "bed/heights.csv", "bed/distances.csv", "--out", "one",
           "--quiet", cwd=tmp_path)
    ppmcal("identify", "bed/machine.yaml", "bed/mesh_default.csv", "--out", "two", "--quiet",
           cwd=tmp_path)
    for old, new in (("one", "two"), ("two", "one")):
        found = ppmcal("compare", old, new, "--json", "--out", f"{old}-{new}", cwd=tmp_path,
                       expect=0).json
        assert found["verdict"] == "unchanged" and found["p_value"] > 0.01
    moved = ppmcal("compare", "one", "two", "--json", "--out", "again", cwd=tmp_path,
                   expect=0).json["platform"]["position"]
    assert moved["rms"] < 3.0 * moved["by_chance"] < 30.0
