"""Pictures of kinematics: what is drawn, over what, and what is marked."""


import numpy as np
import pytest
from helpers import machines
from helpers.drawings import svg_of
from helpers.paths import ROOT

import ppmcal as face
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.kinematics.path_rates import rates
from ppmcal.kinematics.tables import pose_vector, velocity_table
from ppmcal.report.collect import collect
from ppmcal.report.html import sig
from ppmcal.report.kinematics_figures import drawn_columns, kinematics_figures, motion_of
from ppmcal.report.page import to_html

CONFIGS, PATHS = ROOT / "configs", ROOT / "sample_data" / "paths"


def spiral(rows=41, header="time"):
    """Return a path of a 3-RPR that leaves its limits and crosses singularities."""
    t = np.linspace(0.0, 10.0, rows)
    return {header: t, "x": 500.0 + 60.0 * t * np.cos(1.5 * t),
            "y": 289.0 + 60.0 * t * np.sin(1.5 * t), "rz": 8.0 * t * np.sin(t)}


def figures(result):
    return kinematics_figures(result.record, drawn_columns(result.columns))


@pytest.mark.slow
def test_a_planar_path_over_time_with_what_is_wrong_on_it():
    result = face.inverse(CONFIGS / "3-RPR.yaml", spiral())
    found = figures(result)
    assert list(found) == ["path", "pose", "joints", "rates", "singularity"]
    assert [d.title for d in found["path"]] == ["Path of the platform, x and y"]
    assert [d.title for d in found["pose"]] == ["x over time", "y over time", "rz over time"]
    assert [d.title for d in found["joints"]] == [f"Joint leg{i} over time" for i in (1, 2, 3)]
    assert len(found["rates"]) == 6
    for drawing in (*found["joints"], *found["singularity"], *found["path"]):
        assert {"singular", "limits"} <= {name for _, name in drawing.key}
    assert "Red line: limit." in found["joints"][0].caption
    assert "Ring: outside" in found["joints"][0].caption
    assert "Least " in found["singularity"][0].caption
    assert "red: singular below it" in found["singularity"][0].caption
    for drawings in found.values():
        for drawing in drawings:
            assert svg_of(drawing).startswith("<svg")


def test_the_least_distance_to_singularity_is_told():
    """A path that keeps away from singularities: digits of one that ends in 0 are round-off."""
    path = {name: values[5:] for name, values in spiral().items()}
    result = face.inverse(CONFIGS / "3-RPR.yaml", path)
    least = int(np.nanargmin(result.table.singular_value))
    caption = figures(result)["singularity"][0].caption
    assert result.table.singular_value[least] > 1e-3
    assert f"Least {sig(result.table.singular_value[least])}, at " in caption


def test_a_good_path_has_nothing_marked():
    t = np.linspace(0.0, 1.0, 20)
    found = figures(face.inverse(CONFIGS / "3-RPR.yaml", {
        "time": t, "x": 500.0 + 30.0 * t, "y": 300.0 + 10.0 * t, "rz": np.full(20, 20.0)}))
    assert found["path"][0].key == (("after", "first row"),)
    assert all(not d.key and not d.note for d in (*found["pose"], *found["joints"]))
    assert "Not moving: rz." in found["pose"][0].caption


@pytest.mark.slow_cases("-None")
@pytest.mark.parametrize(("header", "values"), [("", None), ("t", "words"), ("time", "falling")])
def test_without_times_that_go_up_rows_take_their_place(header, values):
    path = spiral()
    time = path.pop("time")
    if header:
        path[header] = ["later"] * 41 if values == "words" else time[::-1]
    found = figures(face.inverse(CONFIGS / "3-RPR.yaml", path))
    assert "rates" not in found
    assert found["pose"][0].title == "x by row"
    assert ("does not go up" in found["pose"][0].caption) is bool(header)


def test_seconds_may_be_called_t():
    found = figures(face.inverse(CONFIGS / "3-RPR.yaml", spiral(header="t")))
    assert found["pose"][0].title == "x over time" and "rates" in found


@pytest.mark.slow
def test_rates_of_a_velocity_table_are_its_own_and_those_of_its_path():
    """Joint rates from the Jacobian against differences of the joints along the path."""
    t = np.linspace(0.0, 1.0, 201)
    path = {"time": t, "x": 500.0 + 40.0 * np.sin(t), "y": 300.0 + 30.0 * np.cos(t),
            "rz": 20.0 + 5.0 * t}
    moves = path | {"vx": 40.0 * np.cos(t), "vy": -30.0 * np.sin(t), "wz": np.full(201, 5.0)}
    result = face.velocity(CONFIGS / "3-RPR.yaml", moves)
    found = figures(result)
    assert "differences" not in found["rates"][0].caption
    assert "differences" in found["rates"][1].caption
    for i in range(3):
        np.testing.assert_allclose(rates(t, result.q[:, i]), result.table.rate[:, i], rtol=0,
                                   atol=1e-6)


@pytest.mark.parametrize("kind", machines.KINDS)
def test_rates_of_every_kind_are_differences_of_the_path(kind):
    """Along a smooth path in the joints, poses by forward kinematics."""
    mechanism = machines.plain(kind)
    model, home, h = Model(mechanism), home_state(mechanism).q, 1e-4
    step = machines.joint_steps(model)
    t = np.linspace(0.2, 2.0, 5)
    phase = np.arange(home.size)

    def poses(at):
        return forward(model, home + step * np.sin(at[:, None] + phase)).pose

    twist = machines.difference(poses(t + h), poses(t - h)) / (2.0 * h)
    table = velocity_table(model, pose_vector(poses(t)), twist)
    expected = step * np.cos(t[:, None] + phase)
    np.testing.assert_allclose(table.rate, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_a_spatial_path_is_seen_from_where_it_is_wide():
    found = figures(face.inverse(CONFIGS / "6-UPS.yaml", PATHS / "6-UPS-helix.csv"))
    assert [d.title.partition(", ")[2] for d in found["path"]] == ["x and y", "x and z", "y and z"]
    assert "Not moving: rx, ry, rz." in found["pose"][0].caption
    flat = {"time": np.arange(5.0), "x": [0.0, 50, 90, 50, 0], "y": [0.0, 30, 0, -30, 0],
            "z": [2000.0] * 5, "rx": [0.0] * 5, "ry": [0.0] * 5, "rz": [0.0] * 5}
    assert len(figures(face.inverse(CONFIGS / "6-UPS.yaml", flat))["path"]) == 1


@pytest.mark.long
def test_of_all_modes_the_machines_own_is_drawn():
    joints = face.inverse(CONFIGS / "3-RPR.yaml", spiral()).q * 1e3
    result = face.forward(CONFIGS / "3-RPR.yaml", joints, all_modes=True)
    motion = motion_of(result.record, drawn_columns(result.columns))
    one = face.forward(CONFIGS / "3-RPR.yaml", joints)
    assert motion.at.size == 41 < len(result.table.status)
    seen = np.isfinite(motion.number("x"))
    assert 10 < seen.sum() < 41
    np.testing.assert_allclose(motion.number("x")[seen], 1e3 * one.pose[seen, 0], atol=1e-6)
    assert np.isnan(one.pose[~seen, 0]).all()


def test_many_rows_are_thinned():
    t = np.linspace(0.0, 1.0, 5000)
    found = figures(face.inverse(CONFIGS / "3-RPR.yaml", {
        "time": t, "x": 500.0 + 30.0 * t, "y": 300.0 + 10.0 * t, "rz": 20.0 + t}))
    assert "Thinned" in found["pose"][0].caption
    assert len(svg_of(found["pose"][0])) < 60_000


def test_the_page_has_them(tmp_path):
    face.inverse(CONFIGS / "3-RPR.yaml", spiral()).save(tmp_path / "path")
    page = to_html(collect([tmp_path / "path"]))
    for title in ("Path of the platform, x and y", "Joint leg2 over time",
                  "Distance to singularity along the path"):
        assert title in page


def test_a_table_of_another_hand_is_still_a_report(tmp_path):
    """Columns of the user's own by our names, and files of an older version."""
    rows = [{"row": "a", "own": "b", "t": "c", "x": 500, "y": 300, "rz": 20},
            {"row": "d", "own": "e", "t": "f", "x": 510, "y": 300, "rz": 20}]
    result = face.inverse(CONFIGS / "3-RPR.yaml", {k: [r[k] for r in rows] for k in rows[0]})
    result.save(tmp_path / "path")
    assert "x by row" in to_html(collect([tmp_path / "path"]))
    (tmp_path / "path" / "kinematics.json").unlink()
    assert "Kinematics" in to_html(collect([tmp_path / "path"]))
