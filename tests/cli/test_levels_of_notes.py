"""Only what the user must look at is marked, and a page of surplus limbs calls no limb open."""

import pytest
from helpers.commands import ppmcal
from helpers.paths import ROOT


@pytest.mark.long
def test_what_is_good_to_know_has_no_mark_and_no_limb_is_called_open(tmp_path):
    log = ROOT / "sample_data" / "maslow" / "maslow.log"
    ppmcal("import", "maslow", str(log), cwd=tmp_path)
    told = ppmcal("identify", "imported/machine.yaml", "imported/run_1.csv", "imported/run_2.csv",
                  cwd=tmp_path, expect=0)
    assert "\nJoint values alone cannot tell a machine from its mirror image" in told.out
    assert "\n! " not in told.out
    ppmcal("report", "identified", cwd=tmp_path, expect=0)
    assert "does not close:" not in (tmp_path / "report" / "report.html").read_text()
