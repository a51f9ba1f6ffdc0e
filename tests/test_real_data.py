"""Real measurements, where they are at hand: in ../shared/data or where PPMCAL_DATA says."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data"))
sys.path.insert(0, str(ROOT / "benchmarks"))

import real_deltas  # noqa: E402

EDITED = ("011", "019", "022")
"""Events whose saved parameters were edited by hand after solving."""

pytestmark = pytest.mark.skipif(not (DATA / "delta-events").is_dir(),
                                reason="real measurements are not at hand (PPMCAL_DATA)")


@pytest.mark.parametrize("path", sorted((DATA / "delta-events").glob("*.json")),
                         ids=lambda p: p.stem)
def test_a_printer_s_own_calibration(path: Path) -> None:
    """Heights and calipers, flat priors, the printer's weights: its saved parameters."""
    event = json.loads(path.read_text(encoding="utf-8"))
    fit = real_deltas.fitted(event, "single" if event["distances"] else "fixed")
    far = real_deltas.apart(real_deltas.geometry(fit), event["geometry_saved"])
    if event["id"].startswith(EDITED):
        assert far > 0.05
    else:
        assert far < real_deltas.CLOSE


@pytest.mark.parametrize(("rods", "limit"), [("fixed", 0.0215), ("single", 0.0200)])
def test_one_bed_touched_284_times(rods: str, limit: float) -> None:
    (path,) = (DATA / "delta-rostock").glob("*.csv")
    assert real_deltas.rms(real_deltas.bed(path, rods))[0] < limit + 5e-5
    assert np.loadtxt(path, delimiter=",", skiprows=1).shape == (284, 3)
