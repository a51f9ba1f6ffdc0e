"""Campaigns of the independent generator that were once diagnosed wrongly, or in minutes."""

from __future__ import annotations

from pathlib import Path

import pytest
from wild.catalogue import write

from ppmcal.api.diagnose import diagnose


@pytest.mark.slow
def test_typos_do_not_pull_the_fit_of_the_training_rows_away(tmp_path: Path) -> None:
    """Joints and positions typed wrong in six rows: only those are out, and nothing is there."""
    truth = write("gross-5", "delta-rotary", 120, 313442, tmp_path)
    found = diagnose(tmp_path / "mechanism.yaml", [tmp_path / "data.csv"])
    assert found.record.verdict == "none"
    assert found.record.fit.after < 1.2
    (training,) = found.diagnosis.found.before.reasons
    wrong = set(truth["mistakes"][0]["indices"])
    assert len(training) <= len(wrong)
