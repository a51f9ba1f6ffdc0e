"""Several targets on the platform: simulated together, and read as a measurement file of each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.bodies import MARKS, long, machine, measured, wide
from helpers.commands import ppmcal
from numpy.typing import NDArray

import ppmcal as package
from ppmcal.model.dataset import Dataset

POINTS = {name: list(at) for name, at in MARKS.items()}


def simulated(folder: Path, sigma: dict[str, float] | None = None, expect: int = 0, **more: Any
              ) -> tuple[Dataset, ...]:
    """Simulate the bench with three targets; return its campaign."""
    machine(folder)
    content = {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
        "poses": {"random": {"center": {"x": 500, "y": 290, "rz": 5}, "count": 30,
                             "half_range": {"x": 90, "y": 90, "rz": 20}}},
        "errors": {"random": {"scale": 1.0}}, "seed": 6, "targets": POINTS,
        "instrument": {"kind": "position", "sigma": {"position": 0.0, **(sigma or {})}},
        "frame": {"x": 35, "y": -20, "rz": 12}, **more}
    (folder / "s.yaml").write_text(yaml.safe_dump(
        {k: v for k, v in content.items() if v is not None}))
    run = ppmcal("simulate", "bench.yaml", "s.yaml", "--out", "s", cwd=folder)
    assert run.code == expect, run.err
    if expect:
        raise AssertionError(run.err.replace("\n", " "))
    return package.read_data(folder / "bench.yaml", folder / "s" / "measurements.csv")


def apart(one: Dataset, two: Dataset) -> NDArray[np.float64]:
    """Return how far two targets are from each other in each row (N,), mm."""
    return np.asarray(1e3 * np.linalg.norm((one.position - two.position)[:, :2], axis=1))


def test_targets_of_a_body_keep_their_distances(tmp_path: Path) -> None:
    """Whatever the joints do: their noise moves the body, and all of its targets with it."""
    data = simulated(tmp_path, {"actuator": 0.5})
    assert [d.name for d in data] == [f"s {n}" for n in MARKS]
    assert all(d.target.fitted for d in data) and data[1].frame.same_as == "s T1"
    for i, j in ((0, 1), (0, 2), (1, 2)):
        first, second = (np.array(MARKS[data[n].mark]) for n in (i, j))
        assert apart(data[i], data[j]) == pytest.approx(np.linalg.norm(first - second), abs=1e-6)
    truth = json.loads((tmp_path / "s" / "truth.json").read_text())
    assert {n: at[:2] for n, at in truth["targets"].items()} == POINTS and "target" not in truth


def test_each_target_has_noise_of_its_own(tmp_path: Path) -> None:
    sigma = 0.01
    data = simulated(tmp_path, {"position": sigma})
    far = [apart(data[i], data[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    for one in far:
        assert 0.7 < one.std() / (np.sqrt(2.0) * sigma) < 1.4    # 30 rows
    assert abs(np.corrcoef(far)[0, 1]) < 0.9


def test_the_target_that_moves_moves_alone(tmp_path: Path) -> None:
    data = simulated(tmp_path, effects=[
        {"kind": "target_shift", "target": "T2", "parameters": {"x": 3.0, "y": -1.0,
                                                                "from_row": 11}}])
    first, moved, third = (np.array(MARKS[n]) for n in MARKS)
    assert np.ptp(apart(data[0], data[2])) < 1e-6
    for other, at in ((data[0], first), (data[2], third)):
        before, after = (np.linalg.norm(moved + step - at) for step in ((0.0, 0.0), (3.0, -1.0)))
        assert apart(other, data[1]) == pytest.approx([before] * 10 + [after] * 20, abs=1e-6)


@pytest.mark.parametrize(("more", "words"), [
    ({"target": [1, 2]}, "several `targets`, and one `target`"),
    ({"targets": {"T1": "unknown"}}, "needs the true value"),
    ({"instrument": {"kind": "distance", "sigma": {"distance": 0.1}}},
     "not simulated with several targets"),
    ({"effects": [{"kind": "target_shift", "target": "T4", "parameters": {
        "x": 1.0, "from_row": 9}}]}, "unknown target 'T4'"),
    ({"targets": None, "effects": [{"kind": "target_shift", "target": "T1", "parameters": {
        "x": 1.0, "from_row": 9}}]}, "one target only")])
def test_what_makes_no_sense_is_refused(tmp_path: Path, more: dict[str, Any], words: str) -> None:
    with pytest.raises(AssertionError, match=words):
        simulated(tmp_path, expect=2, **more)


@pytest.mark.parametrize("form", [wide, long])
def test_read_makes_a_file_of_each_target(tmp_path: Path, form: Any) -> None:
    """Which together are the campaign that the one file was."""
    path = form(tmp_path, measured(5, rows=20))
    bench = machine(tmp_path)
    whole = package.read_data(bench, path)
    run = ppmcal("read", path.name, "--mechanism", "bench.yaml", "--out", "r.csv", cwd=tmp_path)
    assert run.code == 0, run.err
    parts = package.read_data(bench, *(tmp_path / f"r-{name}.csv" for name in MARKS))
    for one, other in zip(whole, parts, strict=True):
        assert one.name == other.name and one.frame.same_as == other.frame.same_as
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.q, other.q)
        np.testing.assert_array_equal(one.groups, other.groups)


def test_read_keeps_the_points_that_are_known(tmp_path: Path) -> None:
    path = wide(tmp_path, measured(5, rows=20))
    side = path.with_suffix(".yaml")
    side.write_text(side.read_text().replace("T2: unknown", "T2: [-65, 30]"))
    machine(tmp_path)
    run = ppmcal("read", path.name, "--mechanism", "bench.yaml", "--out", "r.csv", cwd=tmp_path)
    assert run.code == 0, run.err
    found = {n: yaml.safe_load((tmp_path / f"r-{n}.yaml").read_text())["target"] for n in MARKS}
    assert found == {"T1": "unknown", "T2": [-65, 30], "T3": "unknown"}
