"""A router on four belts that calibrates itself: an owner's readings, with no instrument at all."""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from helpers.paths import ROOT
from helpers.redundant import belts, written

import ppmcal

BELTS = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data")) / "maslow"
SIDE = {"units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "none", "sigma": {"actuator": 1.0, "estimated": True}}}

pytestmark = pytest.mark.skipif(not BELTS.is_dir(),
                                reason="real measurements are not at hand (PPMCAL_DATA)")


def identified(folder, run):
    """Return what `identify` finds in one run."""
    with (BELTS / f"{run}.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    path = written(folder, belts() | {"tolerances": {"point": 100}})
    table = {f"q_{c}": np.array([float(r[c]) for r in rows]) for c in ("bl", "br", "tr", "tl")}
    return ppmcal.identify(path, ppmcal.read_data(path, table, sidecar=SIDE, name=run))


@pytest.mark.long
def test_anchors_repeat_from_run_to_run(tmp_path):
    """By plain least squares the owner's ten runs repeat to 0.4 to 1.8 mm (one sigma)."""
    found = [identified(tmp_path, f"ten-runs-{n:02d}").identification.mechanism for n in (1, 4, 9)]
    free = list(found[0].free)
    names = [found[0].names[p] for p in free]
    assert names == ["br.base.point.x", "tr.base.point.x", "tr.base.point.y",
                     "tl.base.point.x", "tl.base.point.y"]
    values = np.array([m.values[free] for m in found])
    assert np.ptp(values, axis=0).max() < 5e-3
    np.testing.assert_allclose(values.mean(axis=0), [3.043, 3.037, 2.132, -0.003, 2.132],
                               atol=4e-3)


@pytest.mark.long
def test_worthless_readings_of_a_run_are_found(tmp_path):
    """The owner: at least one reading of run 29 is worthless. One belt is off by 56 mm there."""
    rows = identified(tmp_path, "old-runs-29").identification.gross_errors.rows
    assert {r.row for r in rows} == {17, 18, 19, 20}
    assert {r.number for r in rows} == {"gap_bl"}
    assert all(abs(r.value + 0.056) < 2e-3 for r in rows)
