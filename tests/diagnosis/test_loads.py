"""What gives way to a load, and in which way: the kinds are told from each other."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.diagnoses import diagnose, effect, named, simulate

from ppmcal.io.results.diagnosis_parts import DiagnosedEffect, EffectValue, kind_of
from ppmcal.io.results.diagnosis_wording import own_values

FINE: dict[str, Any] = {"instrument": {"kind": "pose", "sigma": {"position": 0.002,
                                                                 "rotation": 0.0004}}}
HARDENED = effect("compliance", stiffness=1500.0, hardening=0.02)
ALONG = effect("compliance", stiffness=6000.0, by_stroke=0.003)
BASE = effect("plate_compliance", base=8e-4, reach=700.0)
PLATFORM = effect("plate_compliance", platform=2e-4, reach=250.0)
BESIDE = [effect("payload_offset", x=60.0, y=-90.0, z=0.0), effect("compliance", stiffness=3000.0)]
INCLINED = [effect("gravity_tilt", first=25.0, second=-18.0), effect("compliance", stiffness=800.0)]

CASES: dict[str, tuple[str, list[dict[str, Any]], dict[str, float]]] = {
    "hardening": ("3-RPR", [HARDENED], {"hardening": 0.02}),
    "along the stroke": ("3-RPR", [ALONG], {"by_stroke": 0.003}),
    "base": ("6-UPS", [BASE], {"base": 8e-4, "reach": 700.0}),
    "platform": ("6-UPS", [PLATFORM], {"platform": 2e-4, "reach": 250.0}),
    "payload off centre": ("6-UPS", BESIDE, {"x": 60.0, "y": -90.0}),
    "inclined": ("6-UPS", INCLINED, {"first": 25.0, "second": -18.0})}


@pytest.mark.long
@pytest.mark.parametrize("case", ["along the stroke", "base"])
def test_it_is_named_with_its_values(case: str, tmp_path: Path) -> None:
    """The kinds of what was simulated and no others, values within four sigmas.

    One of a planar and one of a spatial machine; campaigns of the others are in docs/rates.
    """
    machine, effects, expected = CASES[case]
    simulate(tmp_path, machine, effects, count=40 if machine == "3-RPR" else 20, **FINE)
    _, found = diagnose(tmp_path)
    assert found["verdict"] in ("named", "named-set")
    assert set(named(found)) == {e["kind"] for e in effects}
    got = {n: v for e in found["effects"] for n, v in e["parameters"].items()}
    for name, wanted in expected.items():
        assert abs(got[name]["value"] - wanted) < 4.0 * got[name]["sigma"], name
        assert got[name]["sigma"] < 0.5 * abs(wanted), name


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_a_fit_recovers_it(case: str, tmp_path: Path) -> None:
    """With the kinds in the file, started aside, identify finds their values."""
    machine, effects, expected = CASES[case]
    simulate(tmp_path, machine, effects, count=40, **FINE)
    free = [{**e, "parameters": {n: {"value": 0.8 * v if v else 0.0, "free": True}
                                 for n, v in e["parameters"].items()}} for e in effects]
    file = tmp_path / "m.yaml"
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | {"effects": free}))
    ppmcal("identify", "m.yaml", "s/measurements.csv", "--out", "i", cwd=tmp_path)
    found = yaml.safe_load((tmp_path / "i" / "identified.yaml").read_text())["effects"]
    got = {n: v for e in found for n, v in e["parameters"].items()}
    for name, wanted in expected.items():
        assert abs(got[name]["value"] - wanted) < 4.0 * got[name]["sigma"], name


@pytest.mark.long
def test_a_clearance_is_no_hardened_compliance(tmp_path: Path) -> None:
    simulate(tmp_path, "3-RPR", [effect("clearance", width=0.03)], count=40, **FINE)
    _, found = diagnose(tmp_path)
    assert set(named(found)) == {"clearance"}
    assert np.isfinite(found["effects"][0]["parameters"]["width"]["value"])


@pytest.mark.parametrize(("label", "kind"), [
    ("plate_compliance base", "plate_compliance"), ("backlash on leg1, leg2", "backlash"),
    ("backlash x temperature on leg1", "backlash x temperature"),
    ("leg_thermal from motion on leg2", "leg_thermal from motion"),
    ("geometry leg1.base.x", "geometry leg1.base.x")])
def test_an_alternative_is_a_kind_without_its_part(label: str, kind: str) -> None:
    assert kind_of(label) == kind


def test_values_of_one_hypothesis_are_one_line() -> None:
    """Range, values and the widest interval; a few values, or others of one kind, stay apart."""
    group = [DiagnosedEffect(kind="gain", on=(f"leg{i}",), probability=0.9, parameters={
        "gain": EffectValue(value=0.01 * i, sigma=0.001 * i, unit="")}) for i in (1, 2, 3)]
    text = own_values(group)
    assert text == ("gain 0.01 to 0.03 (leg1 0.01, leg2 0.02, leg3 0.03; "
                    "+- 0.0059 at most)")
    assert own_values(group[:2]) == ""
    near = [g.changed(parameters={"period": EffectValue(
        value=v, sigma=0.004, unit="mm")})
        for g, v in zip(group, (3.999, 4.005, 4.0), strict=True)]
    assert own_values(near).startswith("period 3.999 to 4.005 mm (")
    assert own_values([*group[:2], group[2].changed(probability=0.8)]) == ""
