"""Noise of a tracker: a distance and two angles, from where it stood."""

import json

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from numpy.testing import assert_allclose

from ppmcal.calibration.fit import Problem
from ppmcal.io import read_campaign, read_mechanism
from ppmcal.io.column_names import known_columns, own_name
from ppmcal.model.dataset import tracker_noise

UNITS = {"length": "mm", "angle": "deg"}
STATION = [4000.0, -3000.0, 1500.0]
RANGE, ANGLE = 0.004, 0.0006
"""mm and degrees: across the line of sight some 0.05 mm at five metres."""


@pytest.fixture
def hexapod(tmp_path):
    """A hexapod file in a folder, and a writer of its scenario, which simulates it."""
    ppmcal("init", "6-UPS", "--out", tmp_path / "m.yaml", expect=0)

    def simulate(name="run", seed=1, instrument=None, **more):
        content = {
            "format": "ppmcal/scenario/1", "units": UNITS,
            "poses": {"random": {"center": {"x": 0, "y": 0, "z": 2000, "rx": 0, "ry": 0, "rz": 0},
                                 "half_range": {"x": 250, "y": 250, "z": 200, "rx": 10, "ry": 10,
                                                "rz": 10}, "count": 60}},
            "errors": {"random": {"scale": 1.0}}, "seed": seed,
            "instrument": instrument or {
                "kind": "position", "station": STATION, "sigma": {"range": RANGE, "angle": ANGLE}},
            "frame": {"x": 500, "y": -200, "z": 0, "rx": 3, "ry": -2, "rz": 25},
            "target": [100, 50, 200], **more}
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(content))
        run = ppmcal("simulate", tmp_path / "m.yaml", tmp_path / "s.yaml", "--out",
                     tmp_path / name, "--force")
        return run, tmp_path / name
    return simulate


def test_root_by_spherical_coordinates():
    """Errors in spherical coordinates, drawn, have that covariance."""
    rng = np.random.default_rng(5)
    station, point = np.array([1.0, -2.0, 0.5]), np.array([[2.0, 1.0, 1.3]])
    root = tracker_noise(point, station, 1e-4, 3e-4)[0]
    way = (point - station)[0]
    far, around, up = np.linalg.norm(way), np.arctan2(way[1], way[0]), np.arcsin(
        way[2] / np.linalg.norm(way))
    far = far + 1e-4 * rng.normal(size=400_000)
    up = up + 3e-4 * rng.normal(size=far.size)
    # an angle about the vertical axis that moves the point as far as the other does
    around = around + 3e-4 * rng.normal(size=far.size) / np.cos(np.arcsin(
        way[2] / np.linalg.norm(way)))
    drawn = np.stack([far * np.cos(up) * np.cos(around), far * np.cos(up) * np.sin(around),
                      far * np.sin(up)])
    assert_allclose(root @ root, np.cov(drawn), atol=0.02 * np.trace(root @ root))


def test_rows_are_white_by_the_whole_covariance(hexapod, tmp_path):
    """The white squares are r' C^-1 r of the file's own numbers."""
    _, folder = hexapod()
    mechanism = read_mechanism(tmp_path / "m.yaml")
    data = read_campaign([folder / "measurements.csv"], mechanism)
    problem = Problem(mechanism, tuple(data), mechanism.free)
    state = problem.start()
    rows, = problem.rows_of(0, state, False, np.ones(60, dtype=bool))
    seen = data[0].position
    way = seen - np.array(STATION) / 1e3
    for n in (0, 17, 59):
        ahead = way[n] / np.linalg.norm(way[n])
        across = (np.radians(ANGLE) * np.linalg.norm(way[n])) ** 2
        covariance = across * (np.eye(3) - np.outer(ahead, ahead)) + (
            RANGE * 1e-3) ** 2 * np.outer(ahead, ahead)
        r = rows.raw[n]
        assert_allclose(np.sum(rows.residual[n] ** 2), r @ np.linalg.solve(covariance, r),
                        rtol=1e-9)


@pytest.mark.long
def test_intervals_hold_the_truth_and_are_narrower_than_with_one_number(hexapod, tmp_path):
    """Standardised errors of ten campaigns; the same readings, said to be alike in all axes."""
    z, wider = [], []
    for seed in range(10):
        _, folder = hexapod(f"run{seed}", seed)
        ppmcal("identify", tmp_path / "m.yaml", folder / "measurements.csv", "--out",
               folder / "id", expect=0)
        truth = json.loads((folder / "truth.json").read_text())["parameters"]
        found = json.loads((folder / "id" / "identification.json").read_text())
        assert 0.7 < found["noise"]["sigma_ratio"] < 1.3
        own = {p["name"]: p for p in found["parameters"] if p["sigma"]}
        z += [(p["value"] - truth[name]) / p["sigma"] for name, p in own.items()]
        if seed < 2:
            side = folder / "measurements.yaml"
            content = yaml.safe_load(side.read_text())
            content["instrument"] = {"kind": "position", "sigma": {"position": 0.042}}
            side.write_text(yaml.safe_dump(content))
            ppmcal("identify", tmp_path / "m.yaml", folder / "measurements.csv", "--out",
                   folder / "plain", expect=0)
            plain = json.loads((folder / "plain" / "identification.json").read_text())
            wider += [p["sigma"] / own[p["name"]]["sigma"] for p in plain["parameters"]
                      if p["name"] in own]
    assert 0.85 < np.sqrt(np.mean(np.square(z))) < 1.15
    assert np.median(wider) > 1.05


@pytest.mark.parametrize(("instrument", "words"), [
    ({"kind": "position", "sigma": {"range": 0.01}}, "the key 'angle' is missing"),
    ({"kind": "position", "sigma": {"range": 0.01, "angle": 0.001, "position": 0.1}}, "said twice"),
    ({"kind": "position", "sigma": {"position": 0.1}, "station": [0, 0, 0]}, "where a tracker"),
    ({"kind": "inclinometer", "sigma": {"range": 0.01, "angle": 0.001, "rotation": 1}},
     "no line of sight"),
    ({"kind": "position", "sigma": {"range": 0.01, "angle": 0.001}, "station": "unknown"},
     "about where it stood"),
])
def test_half_of_it_is_refused(hexapod, instrument, words):
    run, _ = hexapod(instrument=instrument)
    assert run.code == 2
    assert words in run.err.replace("\n", " ")


def test_a_plan_asks_for_one_number(hexapod, tmp_path):
    _, folder = hexapod()
    run = ppmcal("plan", tmp_path / "m.yaml", "--instrument", folder / "measurements.yaml",
                 "--out", tmp_path / "plan")
    assert run.code == 2
    assert "position: " in run.err


def test_rows_with_a_standard_deviation_of_their_own_keep_it(hexapod, tmp_path):
    _, folder = hexapod()
    path = folder / "measurements.csv"
    header, *rows = path.read_text().splitlines()
    rows = [f"{row},{'0.5' if n == 3 else ''}" for n, row in enumerate(rows)]
    path.write_text("\n".join([f"{header},sigma_x", *rows]) + "\n")
    data, = read_campaign([path], read_mechanism(tmp_path / "m.yaml"))
    assert_allclose(data.covariance[3, 0], [0.25e-6, 0.0, 0.0])
    assert data.covariance[3, 1, 2] != 0.0
    assert_allclose(data.sigma_position**2, np.diagonal(data.covariance, axis1=1, axis2=2))


def test_expanded_uncertainties_of_a_tracker_are_read(hexapod, tmp_path):
    _, folder = hexapod(instrument={"kind": "position", "sigma": {"position": 0.02}})
    path = folder / "measurements.csv"
    head, *rows = path.read_text().splitlines()
    path.write_text("\n".join([f"{head},u95_x [um]", *(f"{row},98" for row in rows)]) + "\n")
    mechanism = read_mechanism(tmp_path / "m.yaml")
    data, = read_campaign([path], mechanism)
    assert_allclose(data.sigma_position[:, 0], 0.05e-3)
    assert_allclose(data.sigma_position[:, 1:], 0.02e-3)
    for header in ("U95 x", "U95(X)", "x U95", "u95_x"):
        assert own_name(header, known_columns(mechanism))[0] == "u95_x"
