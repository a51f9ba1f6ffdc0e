"""What the page expects of residuals of joint values alone, whose poses are fitted row by row."""

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from helpers.redundant import alone, rope_cage, written

import ppmcal
from ppmcal.io.csv import Table
from ppmcal.io.results.identification_tables import gap_share, times_noise, typical_sigma, white
from ppmcal.report import collect
from ppmcal.report.residual_figures import coordinate_figures, residual_figures
from ppmcal.report.rows import DataRows


def shipped(name):
    """Return a shipped machine's file."""
    return yaml.safe_load((ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8"))


@pytest.mark.parametrize(("tree", "half", "equations", "freedoms"), [
    (shipped("maslow"), {"x": 900, "y": 600}, 4, 2),
    (shipped("cable-4-planar"), {"x": 700, "y": 500, "rz": 8}, 4, 3),
    (rope_cage(), {"x": 600, "y": 500, "z": 400, "rx": 10, "ry": 10, "rz": 10}, 8, 6)],
    ids=["maslow", "cable-4-planar", "cage"])
def test_noise_of_gaps_counts_the_pose_of_each_row(tree, half, equations, freedoms, tmp_path):
    path = written(tmp_path, {n: v for n, v in tree.items() if n != "limits"})
    made = ppmcal.simulate(path, alone(tree, half, count=150, sigma=0.1))
    ppmcal.identify(path, made.data[0], holdout=0.0).save(tmp_path / "out")
    one, = collect([tmp_path / "out"]).identified
    table = one.residuals
    share = np.sqrt((equations - freedoms) / equations)
    assert one.freedoms == freedoms
    assert gap_share(table, one.freedoms) == pytest.approx(share)
    # a fit that is no better nor worse than noise, but for its parameters
    left = one.record.noise.degrees / (table.size * (equations - freedoms))
    assert 0.7 < left < 1.0
    found, wide = white(table, one.freedoms).rms, 4.0 / np.sqrt(2.0 * one.record.noise.degrees)
    assert found == pytest.approx(np.sqrt(left), rel=wide)
    assert white(table).rms == pytest.approx(share * found)
    assert np.sqrt(np.mean(times_noise(table, one.freedoms) ** 2)) == pytest.approx(found)
    name = next(h for h in table.header if h.startswith("after_gap_")).removeprefix("after_")
    assert typical_sigma(table, name, one.freedoms) == pytest.approx(share * 0.1)
    rows = DataRows.of(one, 0)
    said = f"Sigma of gaps: {share:.2g} of the limbs' noise, since each row's pose is fitted"
    assert said in residual_figures(rows)[0].caption
    assert f"noise ({0.2 * share:.3f}\u00a0mm)" in coordinate_figures(rows)[0].caption


def test_measured_coordinates_have_the_noise_of_the_file():
    numbers = {"after_x": np.array([1.0, -1.0]), "sigma_x": np.array([1.0, 1.0])}
    table = Table("residuals.csv", tuple(numbers), numbers, {}, 2)
    assert gap_share(table, 6) == 1.0
    assert white(table, 6).rms == pytest.approx(1.0)
