"""A five-bar: an ordinary table of motor angles and places, from its first file to its exports."""

import numpy as np
import pytest
from helpers.paths import ROOT

import ppmcal
from ppmcal.controllers import uses
from ppmcal.errors import BadInput

MACHINE = ROOT / "configs" / "five-bar.yaml"


@pytest.fixture(scope="module")
def fit(tmp_path_factory):
    folder = tmp_path_factory.mktemp("five-bar")
    made = ppmcal.simulate(MACHINE, ROOT / "configs" / "scenarios" / "five-bar.yaml")
    made.save(folder / "try")
    found = ppmcal.identify(MACHINE, folder / "try" / "measurements.csv")
    found.save(folder / "found")
    return folder, made, found


@pytest.mark.slow
def test_its_table_has_a_column_for_each_motor(fit):
    folder, _, _ = fit
    header = (folder / "try" / "measurements.csv").read_text().partition("\n")[0].split(",")
    assert header[:5] == ["pose", "q_left", "q_right", "x", "y"]


@pytest.mark.slow
def test_places_hold_within_the_noise(fit):
    """Three combinations are the frame's: bases, offsets and the tracker's frame turn together."""
    _, _, found = fit
    assert found.identification.rank == 10
    table = found.to_frame("residuals.csv")
    left = np.array([table[f"after_{c}"] for c in "xy"], dtype=float)
    assert np.sqrt(np.mean(left**2)) < 0.03    # mm, as the scenario's tracker scatters by 0.02


@pytest.mark.slow
@pytest.mark.parametrize(("form", "files"), [
    ("joints", {"left.comp", "right.comp", "export.json"}), ("grid", {"grid.csv", "export.json"})])
def test_it_is_exported_as_tables(fit, form, files):
    folder, _, _ = fit
    found = ppmcal.export(form, folder / "found")
    assert set(found.files()) == files
    assert found.exported.after.rms < 0.1 * found.exported.before.rms


@pytest.mark.slow
def test_no_firmware_of_other_machines_takes_it(fit):
    """LinuxCNC drives it by the joint tables: none of its kinematics modules is a five-bar's."""
    folder, _, found = fit
    told = uses(found.mechanism, "fit")
    assert any("export joints" in t for t in told)
    assert not any(t in " ".join(told) for t in ("genhexkins", "maslow", "hangprinter"))
    with pytest.raises(BadInput, match="six limbs"):
        ppmcal.export("linuxcnc", folder / "found")
    assert np.isfinite(found.mechanism.limits).all()
