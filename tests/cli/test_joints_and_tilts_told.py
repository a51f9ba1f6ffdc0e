"""Encoders at joints and inclinometers through the commands: what is told is in angles."""

import json
import re

import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.paths import ROOT

SCENARIO = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": {"center": {"x": 500, "y": 288.675, "rz": 30},
                                 "half_range": {"x": 100, "y": 100, "rz": 20}, "count": 30}},
            "errors": {"leg1.offset": 0.3, "leg2.offset": -0.4, "leg3.base.point.x": 0.2}}


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """Return a folder with a 3-RPR, three encoders' files, one of tilts, and what was found."""
    folder = tmp_path_factory.mktemp("joints")
    (folder / "m.yaml").write_text((ROOT / "configs" / "3-RPR.yaml").read_text(encoding="utf-8"))
    joints = {f"e{n}": {"kind": "joint", "at": f"leg{n}.joint1", "sigma": {"value": 0.002},
                        "offset": 10 * n} for n in (1, 2, 3)}
    for seed, (name, instrument) in enumerate({**joints, "tilt": {
            "kind": "inclinometer", "sigma": {"rotation": 0.002}}}.items()):
        (folder / "s.yaml").write_text(yaml.safe_dump(SCENARIO | {
            "instrument": instrument, "seed": seed,
            **({"target_rotation": [0, 0, 5]} if name == "tilt" else {})}))
        ppmcal("simulate", "m.yaml", "s.yaml", "--out", name, cwd=folder)
    told = ppmcal("identify", "m.yaml", *(f"{e}/measurements.csv" for e in joints), "--out", "i",
                  cwd=folder)
    return folder, flat(told.out)


def flat(text):
    return re.sub(r"\s+", " ", text)


@pytest.mark.slow
def test_what_identify_tells(desk):
    folder, told = desk
    assert re.search(r"e2: the encoder at leg2.joint1 reads (19.99|20.0)\S* deg more than is true "
                     r"\(\+- 0.0\d+ deg, 95 %\)", told)
    assert re.search(r"after rotation [0-9. ]+ deg", told)
    assert " mm rms" not in told
    table = rows(folder / "i" / "residuals.csv")
    assert {"before_turn_leg1.joint1", "after_turn_leg3.joint1"} <= set(table[0])
    found = json.loads((folder / "i" / "identification.json").read_text(encoding="utf-8"))
    units = found["column_units"]["residuals.csv"] if "residuals.csv" in found.get(
        "column_units", {}) else found["tables"]["residuals.csv"]
    assert units["after_turn_leg1.joint1"] == "deg"
    stands = found["datasets"][1]["registration"]
    assert stands["unit"] == "deg"
    assert abs(stands["encoder_offset"] - 20.0) < 0.05
    # no measuring frame is among what a model keeps
    assert "datasets" not in (yaml.safe_load((folder / "i" / "identified.yaml").read_text())
                              .get("measurement") or {})


@pytest.mark.long
def test_what_follows_identify(desk):
    folder, _ = desk
    told = flat(ppmcal("validate", "i", "e1/measurements.csv", "--out", "v", cwd=folder,
                       expect=1).out)
    assert "fitted: the encoder's offset. Noise 0.002 deg, as its sidecar states." in told
    (folder / "t.csv").write_text("x,y,rz\n500,300,30\n520,280,25\n")
    assert "in the frame of the base" in flat(ppmcal("compensate", "i", "t.csv", "--out", "c",
                                                     cwd=folder).out)
    told = flat(ppmcal("identify", "m.yaml", "tilt/measurements.csv", "e1/measurements.csv",
                       "--out", "it", cwd=folder).out)
    assert "rotation" in told
    assert {"after_roll", "after_turn_leg1.joint1"} <= set(rows(folder / "it" / "residuals.csv")[0])
    ppmcal("report", "i", "it", "--out", "r", cwd=folder)
    page = (folder / "r" / "report.html").read_text(encoding="utf-8")
    assert "turn_leg1.joint1 (deg)" in page and "roll (deg)" in page


@pytest.mark.long
def test_diagnose_takes_both(desk):
    folder, _ = desk
    told = flat(ppmcal("diagnose", "m.yaml", *(f"e{n}/measurements.csv" for n in (1, 2, 3)),
                       "--out", "d", cwd=folder).out)
    assert "Rotation error, rms" in told
    told = flat(ppmcal("diagnose", "m.yaml", "tilt/measurements.csv", "e2/measurements.csv",
                       "--out", "dt", cwd=folder).out)
    assert "No missing effect is detectable" in told
