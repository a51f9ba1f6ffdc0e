"""`ppmcal read --combined`: targets of one body as one measured pose with its covariance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.bodies import FRAME, MARKS, Seen, long, machine, measured, sidecar, turned, wide
from helpers.commands import columns, ppmcal
from scipy.stats import chi2

import ppmcal as package
from ppmcal.model.dataset import Dataset

PLACES = f"targets: {{{', '.join(f'{n}: [{x:g}, {y:g}]' for n, (x, y) in MARKS.items())}}}"


def given(path: Path, places: str = PLACES) -> Path:
    """Return a file whose sidecar says where the marks are."""
    side = path.with_suffix(".yaml")
    lines = [places if t.startswith("targets:") else t for t in side.read_text().splitlines()]
    side.write_text("\n".join(lines) + "\n")
    return path


def read(folder: Path, path: Path, expect: int = 0, mechanism: str = "bench.yaml") -> str:
    """Combine; return what was said."""
    machine(folder)
    run = ppmcal("read", path.name, "--mechanism", mechanism, "--combined", "--out", "poses.csv",
                 cwd=folder)
    assert run.code == expect, run.out + run.err
    return " ".join((run.out + run.err).split())


def poses(folder: Path) -> Dataset:
    data, = package.read_data(folder / "bench.yaml", folder / "poses.csv")
    return data


def errors(data: Dataset, seen: Seen) -> Any:
    """Return by what poses are off those of the bench, in the camera's frame (N, 3), m and rad."""
    at = np.array(FRAME[:2]) + seen.poses[data.rows - 1, :2] @ turned(FRAME[2]).T
    off = np.column_stack([1e3 * data.position[:, :2] - at, 1e3 * (
        data.rotation[:, 2] - seen.poses[data.rows - 1, 2] - FRAME[2])]) / 1e3
    return off


@pytest.mark.parametrize("form", [wide, long])
def test_marks_are_poses_as_good_as_their_covariance_says(tmp_path: Path, form: Any) -> None:
    seen = measured(5, rows=60)
    said = read(tmp_path, given(form(tmp_path, seen)))
    assert "one pose for each of 60 rows of 60" in said
    data = poses(tmp_path)
    assert data.covariance is not None and str(data.kind) == "pose" and not data.target.fitted
    own = data.covariance[:, [0, 1, 5]][:, :, [0, 1, 5]]
    off = errors(data, seen)
    square = float(np.einsum("ni,nij,nj->", off, np.linalg.inv(own), off))
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], off.size)
    assert low < square < high
    np.testing.assert_allclose(data.q, 1e-3 * seen.q, rtol=1e-15)


@pytest.mark.slow
def test_a_fit_of_the_poses_is_the_fit_of_the_marks(tmp_path: Path) -> None:
    """What marks of known places tell of a pose is all in the pose and its covariance."""
    path = given(wide(tmp_path, measured(6, rows=30), joint=0.02))
    read(tmp_path, path)
    found = []
    for name in ("wide.csv", "poses.csv"):
        run = package.identify(tmp_path / "bench.yaml", tmp_path / name)
        found.append({row["name"]: (row["value"], row["sigma"])
                      for row in run.parameters.to_dict("records") if row["sigma"] > 0.0})
    assert len(found[0]) >= 6
    for name, (value, sigma) in found[0].items():
        other, spread = found[1][name]
        assert abs(value - other) <= 1e-3 * sigma and spread == pytest.approx(sigma, rel=1e-3)


def test_correlations_count(tmp_path: Path) -> None:
    """Without their columns the same poses make another fit."""
    read(tmp_path, given(wide(tmp_path, measured(6, rows=30))))
    data = poses(tmp_path)
    names = [c for c in columns(tmp_path / "poses.csv") if c.startswith("rho_")]
    assert names == ["rho_x_y", "rho_x_rz", "rho_y_rz"]
    side = tmp_path / "poses.yaml"
    side.write_text(side.read_text() + f"read: {{ignore: [{', '.join(names)}]}}\n")
    alone = poses(tmp_path)
    assert data.covariance is not None and alone.covariance is None
    np.testing.assert_allclose(alone.sigma_position[:, :2] ** 2, np.diagonal(
        data.covariance, axis1=1, axis2=2)[:, :2], rtol=1e-12)


@pytest.mark.parametrize(("column", "value", "words"), [
    ("rho_x_y", "1.5", "no noise has the row's correlations"),
    ("rho_x_rz", "-1", "no noise has the row's correlations")])
def test_correlations_that_no_noise_has_are_refused(tmp_path: Path, column: str, value: str,
                                                    words: str) -> None:
    read(tmp_path, given(wide(tmp_path, measured(6, rows=12))))
    header, *lines = (tmp_path / "poses.csv").read_text().splitlines()
    cells = lines[4].split(",")
    cells[header.split(",").index(column)] = value
    lines[4] = ",".join(cells)
    (tmp_path / "poses.csv").write_text("\n".join([header, *lines]) + "\n")
    run = ppmcal("check", "bench.yaml", "poses.csv", cwd=tmp_path)
    assert run.code == 2 and words in run.err and "row 5" in run.err


def test_rows_with_one_mark_are_left_empty_and_named(tmp_path: Path) -> None:
    """A row with two of three has a pose in the plane; the machine stood in all of them."""
    path = given(wide(tmp_path, measured(4, rows=12)))
    rows = [line.split(",") for line in path.read_text().splitlines()]
    rows[3][6] = rows[3][7] = ""
    for hidden in (4, 5, 8, 9):
        rows[7][hidden] = ""
    path.write_text("\n".join(",".join(r) for r in rows) + "\n")
    said = read(tmp_path, path)
    assert "no pose in row 7: too few targets are seen" in said
    assert "11 rows of 12" in said
    data = poses(tmp_path)
    assert data.rows.tolist() == [1, 2, 3, 4, 5, 6, 8, 9, 10, 11, 12]
    assert data.sigma_position[2, 0] > data.sigma_position[1, 0]


@pytest.mark.slow
def test_marks_that_identification_found_are_known(tmp_path: Path) -> None:
    seen = measured(8, rows=40)
    path = wide(tmp_path, seen)
    said = read(tmp_path, path, expect=2)
    assert "where the target T1 is on the platform is not known" in said and "targets.T1" in said
    found = ppmcal("identify", "bench.yaml", path.name, "--out", "fit", cwd=tmp_path)
    assert found.code == 0, found.err
    read(tmp_path, path, mechanism="fit/identified.yaml")
    assert len(poses(tmp_path)) == 40


def test_a_mark_whose_point_is_wrong_is_a_finding(tmp_path: Path) -> None:
    path = given(wide(tmp_path, measured(5, rows=20)), PLACES.replace("-65", "-65.1"))
    assert "do not stand to each other as their points say" in read(tmp_path, path, expect=1)


def test_a_mark_that_moved_is_a_finding_with_its_rows(tmp_path: Path) -> None:
    seen = measured(5, rows=20, moved={"T2": (19, (1.0, 0.0))})
    assert "most of all in rows 19, 20" in read(tmp_path, given(wide(tmp_path, seen)), expect=1)


@pytest.mark.parametrize(("targets", "words"), [
    ("targets: {T1: [40, -15], T2: [40, -15], T3: [40, -15]}", "in one place"),
    ("target: known", "one target")])
def test_bodies_that_show_no_pose_are_refused(tmp_path: Path, targets: str, words: str) -> None:
    seen = measured(5, rows=12)
    path = given(wide(tmp_path, seen), targets)
    if targets.startswith("target:"):
        header, *lines = path.read_text().splitlines()
        path.write_text("\n".join([header.replace("T1x", "x").replace("T1y", "y"), *lines]) + "\n")
        path.with_suffix(".yaml").write_text(sidecar(
            "body", targets, more='read: {ignore: ["T2x [mm]", "T2y [mm]", "T3x [mm]", '
                                  '"T3y [mm]"]}\n'))
    said = read(tmp_path, path, expect=2)
    assert words in said and not (tmp_path / "poses.csv").exists()




def in_space(folder: Path, points: dict[str, list[float]], expect: int) -> str:
    """Simulate a hexapod that a tracker sees, combine its targets; return what was said."""
    text = package.shipped("6-UPS", scenario=True).read_text()
    content = yaml.safe_load(text)
    content = {k: v for k, v in content.items() if k not in ("target", "effects", "noise")}
    content |= {"targets": points, "frame": {"x": -1500, "y": 200, "z": 100, "rx": 4, "ry": -3,
                                             "rz": 20},
                "instrument": {"kind": "position", "sigma": {"range": 0.005, "angle": 0.0004}}}
    (folder / "s.yaml").write_text(yaml.safe_dump(content))
    (folder / "m.yaml").write_text(package.shipped("6-UPS").read_text())
    run = ppmcal("simulate", "m.yaml", "s.yaml", "--out", "s", cwd=folder)
    assert run.code == 0, run.err
    side = folder / "s" / "measurements.yaml"
    told = yaml.safe_load(side.read_text())
    side.write_text(yaml.safe_dump({**told, "targets": points}))
    run = ppmcal("read", "s/measurements.csv", "--mechanism", "m.yaml", "--combined", "--out",
                 "poses.csv", cwd=folder)
    assert run.code == expect, run.out + run.err
    return " ".join((run.out + run.err).split())


@pytest.mark.slow
def test_a_trackers_targets_on_a_hexapod_are_poses_of_six_coordinates(tmp_path: Path) -> None:
    """They leave of the targets what the tracker's noise is, and are read as they were written."""
    in_space(tmp_path, {"T1": [120, 20, 40], "T2": [-60, 110, 45], "T3": [-70, -100, 30]}, 0)
    data, = package.read_data(tmp_path / "m.yaml", tmp_path / "poses.csv")
    assert data.covariance is not None and data.covariance.shape[1:] == (6, 6)
    assert len([c for c in columns(tmp_path / "poses.csv") if c.startswith("rho_")]) == 15
    found = package.identify(tmp_path / "m.yaml", tmp_path / "poses.csv")
    assert found.summary()["noise"]["chi2_p"] > 1e-3


def test_targets_on_one_line_show_no_pose_in_space(tmp_path: Path) -> None:
    said = in_space(tmp_path, {"T1": [120, 20, 40], "T2": [0, 20, 40], "T3": [-70, 20, 40]}, 2)
    assert "on one line" in said and "s/measurements.yaml: targets" in said
