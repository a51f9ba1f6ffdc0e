"""Hangprinter: samples of its auto-calibration as machines, and anchors as M669 has them."""

import itertools
import json

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT
from helpers.redundant import written

from ppmcal import export, identify, import_config
from ppmcal.controllers.hangprinter.controller import HANGPRINTER, read
from ppmcal.controllers.hangprinter.reading import Spools, parse_config
from ppmcal.errors import BadInput

ANCHORS = np.array([[15.8, -1591.9, -125.6], [1294.6, 1231.8, -169.7], [-1397.4, 727.8, -147.2],
                    [23.9, 1.9, 2354.9]])
CONFIG = ("M669 K6 A10:-1600:-120 B1300:1240:-165 C-1400:720:-150 D20:0:2350 P2000 ; anchors\n"
          "M666 Q0.05 R75.8:75.9:75.4:75.1 U2:2:2:4 O1:1:1:1 L20 H255 J25:25:25:25\n")
Q, R, U = 0.05, np.array([75.8, 75.9, 75.4, 75.1]), np.array([2.0, 2.0, 2.0, 4.0])


def places(count, seed=1):
    return np.random.default_rng(seed).uniform([-500, -500, 0], [500, 500, 900], (count, 3))


def lines(points):
    """Return line positions, mm."""
    return np.linalg.norm(points[:, None] - ANCHORS, axis=2) - np.linalg.norm(ANCHORS, axis=1)


def motors(points):
    """Return motor positions, degrees, as the firmware computes them from steps per mm and k0."""
    k2 = -U * Q
    k0 = 2.0 * (255 / 20 * U * 360.0 / (2.0 * np.pi)) / k2
    return k0 * (np.sqrt(R**2 + lines(points) * k2) - R)


def script(path, points, measured, comment="# by hand"):
    """Write arrays as the auto-calibration's script has them."""
    def array(name, rows):
        cells = ",\n       ".join(f"[{', '.join(f'{v:.9g}' for v in row)}]" for row in rows)
        return f"{name} = np.array(\n    [\n       {cells},  {comment}\n    ])\n"

    path.write_text("import numpy as np\n" + array("motor_pos_samp", motors(points))
                    + array("xyz_of_samp", points[:measured]))


def test_motor_positions_are_line_positions_by_what_is_on_the_spools():
    points = places(50)
    spools = parse_config(CONFIG, "x").spools
    np.testing.assert_allclose(spools.line_positions(motors(points)), lines(points), atol=1e-9)
    bare = Spools(buildup=(0.0,))
    np.testing.assert_allclose(
        bare.line_positions(np.full((1, 5), 360.0 * 255 / 20)),
        [[2 * np.pi * 75 / u for u in (2, 2, 2, 2, 4)]], rtol=1e-14)


def test_json_lines_are_sets_of_samples(tmp_path):
    points = places(20)
    config = {"spool_buildup_factor": Q, "spool_r_in_origin": R.tolist(),
              "mechanical_advantage": U.tolist(), "lines_per_spool": 1.0, "motor_gear_teeth": 20,
              "spool_gear_teeth": 255}
    sets = [{"anchors": (ANCHORS + 20.0).tolist(), "real_xyz": points[:n].tolist(), "config": {},
             "motor_samples": motors(points).tolist(), "config_used": config} for n in (20, 12)]
    path = tmp_path / "samples.jsonl"
    path.write_text("".join(json.dumps(one) + "\n" for one in sets))
    found = import_config("hangprinter", path)
    assert found.imported.entries["runs"] == [20, 12, 8]
    assert "40 samples of 4 lines, 32 of them at measured places" in found.headline()
    assert not found.findings
    files = found.files()
    assert "kind: position" in files["run_1.yaml"] and "kind: none" in files["run_3.yaml"]
    assert "samples 13 to 20 of line 2 of samples.jsonl" in files["run_3.yaml"]
    tree = yaml.safe_load(files["machine.yaml"])
    assert tree["limbs"][0]["base"]["point"] == pytest.approx((ANCHORS[0] + 20.0).tolist())
    assert tree["tolerances"]["point"] == 50


@pytest.mark.long
def test_arrays_and_the_machines_own_config_give_its_anchors(tmp_path):
    """Import, fit, export: what the firmware makes of M669 then suits the lines."""
    points = places(24)
    script(tmp_path / "run.py", points, 18)
    (tmp_path / "config.g").write_text(CONFIG)
    found = import_config("hangprinter", tmp_path / "run.py", anchors=tmp_path / "config.g")
    assert not found.findings
    found.save(tmp_path / "o")
    fit = identify(tmp_path / "o" / "machine.yaml",
                   [tmp_path / "o" / f"run_{n}.csv" for n in (1, 2)])
    fit.save(tmp_path / "fit")
    made = export("hangprinter", tmp_path / "fit", old=tmp_path / "config.g")
    text = made.exported.files[HANGPRINTER.file]
    np.testing.assert_allclose(read(text, "x"), ANCHORS, atol=0.3)
    assert text.splitlines()[-1].startswith("M669 A15.")
    assert made.exported.after.rms < 1e-5 < 1e-3 < made.exported.before.rms
    olds = {n.name: n.old for n in made.exported.numbers}
    assert olds["M669 Dz"] == 2350.0


@pytest.mark.slow
def test_line_positions_alone_give_the_shape(tmp_path):
    points = places(60)
    (tmp_path / "samp.py").write_text(f"samp = {lines(points).tolist()}\n")
    (tmp_path / "config.g").write_text(CONFIG)
    found = import_config("hangprinter", tmp_path / "samp.py", anchors=tmp_path / "config.g")
    tree = yaml.safe_load(found.files()["machine.yaml"])
    held = [f"{limb['name']}{c}" for limb in tree["limbs"]
            for c, v in dict(limb["base"]["point"] if isinstance(limb["base"]["point"], dict)
                             else {}).items() if isinstance(v, dict)]
    assert held == ["Ax", "Ay", "Az", "Bx", "Bz", "Cz"]
    found.save(tmp_path / "o")
    fit = identify(tmp_path / "o" / "machine.yaml", tmp_path / "o" / "measurements.csv")
    assert fit.identification.rank == 10
    machine = fit.mechanism
    at = np.array([[machine.values[machine.names.index(f"{limb}.base.point.{c}")] for c in "xyz"]
                   for limb in "ABCD"])
    for i, j in itertools.combinations(range(4), 2):
        assert np.linalg.norm(at[i] - at[j]) * 1e3 == pytest.approx(
            np.linalg.norm(ANCHORS[i] - ANCHORS[j]), abs=2.0)


def test_spools_that_nobody_says_are_a_finding(tmp_path):
    script(tmp_path / "run.py", places(24), 18)
    told = ppmcal("import", "hangprinter", "run.py", cwd=tmp_path, expect=1)
    said = " ".join(told.out.split())
    assert "how large the spools are is not said" in said
    assert "the firmware's own, which are rough" in said


def test_older_configurations_have_a_height_for_d():
    found = parse_config("M669 A0.0:-1604.54:-114.08 B1312.51:1270.88:-162.19 "
                         "C-1440.27:741.63:-161.23 D2345.00\nM666 Q0.035620 R65.239:65.135:65.1\n"
                         "; M669 A9:9:9\nm669 a1:-1600:-110 ; later lines win\n", "x")
    np.testing.assert_array_equal(found.matrix("x")[[0, 3]], [[1, -1600, -110], [0, 0, 2345]])
    assert found.spools.radius == (65.239, 65.135, 65.1) and found.spools.buildup == (0.03562,)


ROW = [1.0, 2.0, 3.0, 4.0]


@pytest.mark.parametrize(("text", "says", "place"), [
    ("hello = 3", "holds no samples", "s.txt"),
    ("{\"a\": 1}", "holds no samples", "line 1"),
    ("{\"motor_samples\": [[1, 2, 3, 4]]}\n{oops", "is not one JSON object", "line 2"),
    ("{\"motor_samples\": 3}", "samples of 1 line are", "line 1: motor_samples"),
    ("{\"motor_samples\": [[1, 2], [1]]}", "not a table of numbers", "line 1: motor_samples"),
    ("{\"motor_samples\": [[1, 2, 3, null]]}", "implausible", "motor_samples: row 1"),
    (json.dumps({"motor_samples": [ROW, [1e9, 0, 0, 0]]}), "implausible", "motor_samples: row 2"),
    (json.dumps({"motor_samples": [ROW], "real_xyz": [[0, 0, 0], [1, 1, 1]]}),
     "2 places were measured of 1 samples", "line 1"),
    (json.dumps({"motor_samples": [ROW], "anchors": [[0, 0, 0]]}), "1 anchors do not hold 4 lines",
     "line 1: anchors"),
    (json.dumps({"motor_samples": [ROW], "config": {"spool_r": -1}}),
     "spool_r is not a number from", "line 1"),
    (json.dumps({"motor_samples": [ROW] * 5, "real_xyz": [[0, 0, 1]] * 2}),
     "say 11 numbers, and 16 of the machine are open", "s.txt"),
    (json.dumps({"samp": [ROW] * 9}), "say 9 numbers, and 10", "s.txt"),
    ("samp = [[1, 2, 3, x]]", "is no array of numbers", "samp"),
    ("samp = [[1, 2, 3, 4],", "is no array of numbers", "samp"),
    (json.dumps({"samp": [ROW]}) + "\n" + json.dumps({"samp": [[*ROW, 5.0]]}),
     "samples are of 4 and 5 lines", "s.txt"),
], ids=str)
def test_what_cannot_be_read_is_one_message(tmp_path, text, says, place):
    (tmp_path / "s.txt").write_text(text)
    told = ppmcal("import", "hangprinter", "s.txt", cwd=tmp_path, expect=2)
    said = " ".join(told.err.split())
    assert says in said and place in said and "Traceback" not in said


@pytest.mark.parametrize(("config", "says"), [
    ("M665 R3", "M669 has no A and no B and no C and no D"),
    (CONFIG.replace("A10:-1600:-120", "A10:-1600"), "M669 A is not x:y:z"),
    (CONFIG.replace("H255", "H0"), "M666 H is not a number from 0.01"),
    (CONFIG.replace("Q0.05", "Q5e9"), "M666 Q is not a number from 0 to 10"),
    (CONFIG.replace(" P2000", " I0:0:2000"), "5 anchors, and samples are of 4 lines")])
def test_configurations_that_cannot_be_used(tmp_path, config, says):
    script(tmp_path / "run.py", places(24), 18)
    (tmp_path / "config.g").write_text(config)
    with pytest.raises(BadInput, match=says):
        import_config("hangprinter", tmp_path / "run.py", anchors=tmp_path / "config.g")


# --- export -------------------------------------------------------------------------------------


def machine(tmp_path, shift, extra=0.0):
    """Return the file of the true machine, its base shifted against the firmware's origin."""
    fixed = {c: {"value": 0, "fixed": True} for c in "xyz"}
    limbs = [{"name": name, "kind": "rope",
              "base": {"point": {c: {"value": float(v), "nominal": float(v + 10.0)}
                                 for c, v in zip("xyz", place + shift, strict=True)}},
              "platform": {"point": fixed}, "offset": float(np.linalg.norm(place)) + extra * i}
             for i, (name, place) in enumerate(zip("ABCD", ANCHORS, strict=True))]
    return written(tmp_path, {
        "format": "ppmcal/mechanism/1", "name": "lines", "motion": "translational",
        "units": {"length": "mm", "angle": "deg"}, "limbs": limbs,
        "home": {"pose": dict(zip("xyz", (np.array([0.0, 0.0, 400.0]) + shift).tolist(),
                                  strict=True))},
        "tolerances": {"point": 10, "offset": 10},
        "limits": {"A": [-900, 900], "B": [-900, 900], "C": [-900, 900], "D": [-1500, 100]}})


@pytest.mark.parametrize("shift", [(0.0, 0.0, 0.0), (40.0, -30.0, 12.0)])
def test_the_origin_is_where_all_line_positions_are_zero(tmp_path, shift):
    found = export("hangprinter", machine(tmp_path, np.array(shift))).exported
    np.testing.assert_allclose(read(found.files[HANGPRINTER.file], "x"), ANCHORS, atol=6e-3)
    assert any("line positions are 0" in note for note in found.notes) == any(shift)
    assert found.after.rms < 2e-5 and not found.not_expressed


def test_lines_that_do_not_meet_at_the_origin_are_told(tmp_path):
    found = export("hangprinter", machine(tmp_path, np.zeros(3), extra=2.0)).exported
    (lack,) = found.not_expressed
    assert "ropes are longer than they read by" in lack.what and 1e-4 < lack.cost.rms < 1e-2


def test_other_machines_are_refused():
    with pytest.raises(BadInput, match="four or five ropes to one point in space"):
        export("hangprinter", ROOT / "configs" / "maslow.yaml")


@pytest.mark.slow
def test_the_shipped_machine_is_one(tmp_path):
    found = export("hangprinter", ROOT / "configs" / "hangprinter.yaml").exported
    np.testing.assert_allclose(read(found.files[HANGPRINTER.file], "x"),
                               [[0, -1600, -120], [1300, 1250, -160], [-1400, 750, -150],
                                [20, 10, 2350]], atol=0.02)
