"""A real printer's bed, touched: nothing is learned, and nothing commanded, along it."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT

import ppmcal
from ppmcal.calibration.fit.secondary_analyses import LEFT_OUT
from ppmcal.notes import topic_of

FLAT = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data")) / "hard/flat-reprap"


def thinned(path: Path) -> Path:
    """Leave every third touch in a file."""
    header, *touches = path.read_text(encoding="utf-8").splitlines(keepends=True)
    path.write_text("".join([header, *touches[::3]]), encoding="utf-8")
    return path


@pytest.mark.long
@pytest.mark.skipif(not FLAT.is_dir(), reason="real measurements are not at hand (PPMCAL_DATA)")
def test_touches_of_a_bed_teach_heights_only(tmp_path: Path) -> None:
    ppmcal.import_config("reprap", FLAT / "config.g", mesh=FLAT / "heightmap.csv").save(tmp_path)
    found = ppmcal.diagnose(tmp_path / "machine.yaml", thinned(tmp_path / "mesh_heightmap.csv"))
    learned = [e for e in found.mechanism.effects if e.kind.name == "learned"]
    assert {e.kind.written(found.mechanism.units)["acts"] for e in learned} <= {"z"}
    # touches of one bed hardly tell towers and waves apart: the fit of both may not come to its end
    sent = ppmcal.compensate(found, np.array([[0, 0, 0], [100, 0, 0], [-100, 0, 0], [0, 100, 0]]),
                             frame="base", regardless=True).compensation
    # of a machine whose towers are known to 1 mm and half a degree
    assert np.nanmax(sent.position_before) < 5e-3


OTHER = FLAT.parent / "fading-backlash"


@pytest.mark.long
@pytest.mark.skipif(not (FLAT.is_dir() and OTHER.is_dir()),
                    reason="real measurements are not at hand (PPMCAL_DATA)")
def test_heights_and_distances_of_another_printer_move_no_command_far(tmp_path: Path) -> None:
    """They say nothing of this one, which is told, and commands stay within its tolerances."""
    ppmcal.import_config("reprap", FLAT / "config.g", mesh=FLAT / "heightmap.csv").save(
        tmp_path / "own")
    ppmcal.import_config("klipper", OTHER / "printer.cfg").save(tmp_path / "other")
    files = [tmp_path / "own/mesh_heightmap.csv",
             *(tmp_path / f"other/{n}.csv" for n in ("heights", "distances"))]
    found = ppmcal.identify(tmp_path / "own/machine.yaml", files)
    # none of them has said anything of this machine unnoticed
    for name in ("heights", "distances"):
        assert any(f.startswith(f"{name}: ") and (
            "rows left out" in f or "carry no information" in f) for f in found.findings)
    assert not any(topic_of(f) == LEFT_OUT for f in found.findings)
    sent = ppmcal.compensate(found, np.array([[0, 0, 0], [60, 0, 0], [0, 60, 0]]),
                             frame="base").compensation
    ok = np.array([s == "ok" for s in sent.status])
    assert np.all(sent.position_before[ok] < 5e-3)


@pytest.mark.long
@pytest.mark.skipif(not (FLAT.is_dir() and OTHER.is_dir()),
                    reason="real measurements are not at hand (PPMCAL_DATA)")
def test_a_diagnosis_with_values_of_another_printer_ends_and_moves_no_command(tmp_path: Path
                                                                              ) -> None:
    """Each of their rows is told to say nothing of this one, and commands are refused."""
    ppmcal.import_config("reprap", FLAT / "config.g", mesh=FLAT / "heightmap.csv").save(
        tmp_path / "own")
    ppmcal.import_config("klipper", OTHER / "printer.cfg").save(tmp_path / "other")
    files = [tmp_path / "own/mesh_heightmap.csv",
             *(tmp_path / f"other/{n}.csv" for n in ("heights", "distances"))]
    found = ppmcal.diagnose(tmp_path / "own/machine.yaml", files)
    for name, rows in (("heights", 7), ("distances", 12)):
        assert any(f.startswith(f"{name}: {rows} of {rows} rows left out") for f in found.findings)
    sent = ppmcal.compensate(found, np.array([[0, 0, 0], [60, 0, 0], [0, 60, 0]]),
                             frame="base").compensation
    ok = np.array([s == "ok" for s in sent.status])
    assert np.all(sent.position_before[ok] < 5e-3)
