"""What `check` finds at home, and who else says what it finds of units and limits."""

import json

import pytest
import yaml
from helpers import bodies
from helpers.commands import ppmcal
from helpers.machines import CASES, mechanism_text, plain, plain_text, read_text
from helpers.paths import ROOT

from ppmcal.calibration.interpretation.data_check import check
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closed_at_home import DEAD_POINT, transmissions

CONFIGS = sorted((ROOT / "configs").glob("*.yaml"))


def dead(mechanism):
    """Return what check finds of dead points."""
    return [f for f in check(mechanism).findings if "dead point" in f]


def config(name, limb, **slots):
    """Return a shipped planar machine at 0, 0, 0 with slots of one limb changed; mm."""
    path = next(p for p in CONFIGS if p.name == name)
    tree = yaml.safe_load(path.read_text())
    tree["limbs"][limb] |= slots
    tree["home"]["pose"] = dict.fromkeys(tree["home"]["pose"], 0)
    tree.pop("limits", None)
    return tree


STRETCHED = {
    # |B - A| is 250: crank 220 and rod 30 just reach, as does a rod of 470, folded back; then 200
    "(R)RR stretched": ("3-RRR-1.yaml", 2, {"distal": 30}),
    "(R)RR folded": ("3-RRR-1.yaml", 2, {"distal": 470}),
    "R(R)R stretched": ("3-RRR-2.yaml", 2, {"distal": 30, "proximal": 170}),
    # the joint on the platform is 110.94 from the rail
    "(P)RR square to its rail": ("3-PRR-1.yaml", 0, {"length": 110.94}),
}


@pytest.mark.parametrize("case", STRETCHED)
def test_a_limb_at_a_dead_point_at_home_is_named(case):
    name, limb, slots = STRETCHED[case]
    machine = read_text(yaml.safe_dump(config(name, limb, **slots)))
    (found,) = dead(machine)
    assert f"limb 'leg{limb + 1}'" in found
    assert "serial singularity" in found and "Choose a home pose" in found
    assert transmissions(machine)[limb].value < DEAD_POINT


@pytest.mark.slow
def test_a_limb_is_named_that_its_tolerances_can_bring_to_a_dead_point():
    long = {"distal": 30.4}
    near = read_text(yaml.safe_dump(config("3-RRR-1.yaml", 2, **long)))
    (found,) = dead(near)
    assert transmissions(near)[2].value > DEAD_POINT
    assert "within its tolerances" in found and "0.4 mm short" in found and "leg3" in found
    tight = config("3-RRR-1.yaml", 2, **long)
    tight["tolerances"] = {"point": 0.01, "length": 0.01, "angle": 0.1, "offset": 0.1}
    tight["limbs"][2]["distal"] = 30.4123
    assert not dead(read_text(yaml.safe_dump(tight).replace("350\n", "350.0001\n")))


def test_the_dead_point_does_not_depend_on_the_units_or_the_size():
    tree = config("3-RRR-1.yaml", 2, distal=31)
    small = yaml.safe_load(yaml.safe_dump(tree))
    small["units"]["length"] = "um"
    assert [t.value for t in transmissions(read_text(yaml.safe_dump(tree)))] == pytest.approx(
        [t.value for t in transmissions(read_text(yaml.safe_dump(small)))])


@pytest.mark.long_cases("cable-8-pulleys")
@pytest.mark.slow
@pytest.mark.parametrize("path", CONFIGS, ids=lambda p: p.stem)
def test_no_shipped_machine_is_at_a_dead_point(path):
    assert not dead(read_mechanism(path))


def test_home_off_the_surface_that_passive_limbs_leave_is_said():
    """A centre leg without a drive slides through its joint: no joint value closes it beside."""
    tree = yaml.safe_load(next(p for p in CONFIGS if p.name == "tricept.yaml").read_text())

    def said():
        found = check(read_text(yaml.safe_dump(tree))).findings
        return [f for f in found if "does not close at home" in f]

    assert not said()
    tree["home"]["pose"]["x"] = 30
    (found,) = said()
    assert found.startswith("limb 'centre'") and "30 mm" in found and "the home pose" in found


@pytest.mark.parametrize("kind", CASES)
def test_transmission_is_what_the_joint_moves(kind):
    """1 for a strut that pushes along itself, and never outside 0 to 1."""
    for t in transmissions(plain(kind)):
        assert 0.0 <= t.value <= 1.0 + 1e-12
        assert t.value == pytest.approx(1.0) or kind not in ("R(P)R", "U(P)S", "R(P)S")


# --- limits and units -------------------------------------------------------------------------

RUN = "q_leg1,q_leg2,q_leg3,x,y,rz\n" + "".join(
    f"{330 + 7 * (i % 5)},{331 + 9 * (i % 4)},{329 + 5 * (i % 7)},{2 * (i % 5)},{i % 3},0\n"
    for i in range(20))
SIDECAR = """format: ppmcal/dataset/1
units: {length: mm, angle: deg}
instrument: {kind: pose, sigma: {position: 0.01, rotation: 0.002}}
frame: known
target: known
"""


def bench(folder, limits, sidecar=SIDECAR):
    """Write a 3-RPR machine with these limits and a run of its joints."""
    (folder / "m.yaml").write_text(plain_text("R(P)R", limits=limits))
    (folder / "d.csv").write_text(RUN)
    (folder / "d.yaml").write_text(sidecar)
    return folder


def said(run):
    """Return what a command printed, unwrapped."""
    return " ".join(run.out.split())


@pytest.mark.slow
def test_home_outside_its_limits_is_said_and_the_columns_are_not_blamed(tmp_path):
    bench(tmp_path, {"leg2": [100, 200]})
    run = ppmcal("check", "m.yaml", "d.csv", "--json", cwd=tmp_path, expect=1)
    (found,) = [f for f in run.json["findings"] if "limits" in f]
    assert "home is outside the limits of leg2 (limb 'leg2')" in found
    assert "limits [100, 200] mm" in found and " mm at home" in found
    assert ppmcal("check", "m.yaml", "--json", cwd=tmp_path, expect=1).json["findings"] == [found]


@pytest.mark.slow
def test_columns_outside_the_limits_are_blamed_where_home_is_inside(tmp_path):
    bench(tmp_path, {"leg2": [340, 420]})
    findings = ppmcal("check", "m.yaml", "d.csv", "--json", cwd=tmp_path, expect=1).json["findings"]
    (found,) = [f for f in findings if "limits" in f]
    assert "column q_leg2" in found and "outside the limits of leg2" in found


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.slow
def test_a_refused_fit_repeats_what_check_says_of_units(tmp_path, command):
    folder = bench(tmp_path, {}, SIDECAR.replace("length: mm", "length: m"))
    run = ppmcal(command, "m.yaml", "d.csv", "--out", "o", cwd=folder)
    assert run.code in (2, 3) and "has a pose" in run.err
    assert "perhaps a factor 1000: mm against m" in run.err
    assert not (folder / "o").exists()


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.slow
def test_a_fit_repeats_what_check_says_of_units(tmp_path, command):
    scenario = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
                "poses": {"random": {"center": dict(CASES["R(P)R"].home), "count": 30,
                                     "half_range": {"x": 40, "y": 40, "rz": 8}}},
                "instrument": {"kind": "pose", "sigma": {"position": 0.01, "rotation": 0.002}},
                "seed": 3}
    (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
    case = CASES["R(P)R"]
    (tmp_path / "free.yaml").write_text(mechanism_text(case.limbs, case.motion, case.home))
    ppmcal("simulate", "free.yaml", "s.yaml", "--out", "s", cwd=tmp_path, expect=0)
    bench(tmp_path, {"leg3": [1, 5]})
    run = ppmcal(command, "m.yaml", "s/measurements.csv", "--out", "o", cwd=tmp_path, expect=1)
    assert "home is outside the limits of leg3" in said(run)
    name = {"identify": "identification", "diagnose": "diagnosis"}[command]
    found = json.loads((tmp_path / "o" / f"{name}.json").read_text())["findings"]
    assert any("home is outside the limits of leg3" in f for f in found)


# --- ropes that do not hold ---------------------------------------------------------------------

SPIDER = """
format: ppmcal/mechanism/1
name: spider
units: {length: mm, angle: deg}
motion: MOTION
limbs:
  - {name: c1, kind: rope, base: {point: P1}, platform: {point: O}}
  - {name: c2, kind: rope, base: {point: P2}, platform: {point: O}}
  - {name: c3, kind: rope, base: {point: P3}, platform: {point: O}}
  - {name: c4, kind: rope, base: {point: P4}, platform: {point: O}}
home: {pose: HOME}
tolerances: {point: 3, offset: 3}
"""
LINE = ("planar-point", "[0, 0]", "[0, 0]", "[1000, 0]", "[2000, 0]", "[3000, 0]")
CEILING = ("translational", "[0, 0, 0]", "[0, 0, 3000]", "[1000, 0, 3000]", "[0, 1000, 3000]",
           "[1000, 1000, 3000]")


@pytest.mark.parametrize(("anchors", "hangs", "stands", "where"), [
    (LINE, "{x: 1450, y: -1200}", "{x: 1450, y: 1200}", "line"),
    (CEILING, "{x: 450, y: 400, z: 1000}", "{x: 450, y: 400, z: 4000}", "plane")])
def test_ropes_hold_where_the_platform_hangs_and_not_on_the_other_side(
        tmp_path, anchors, hangs, stands, where):
    text = SPIDER
    for key, value in zip(("MOTION", "O}", "P1", "P2", "P3", "P4"), anchors, strict=True):
        text = text.replace(key, value + "}" * (key == "O}"))
    said = []
    for home in (hangs, stands):
        (tmp_path / "m.yaml").write_text(text.replace("HOME", home), encoding="utf-8")
        said.append([str(f) for f in check(read_mechanism(tmp_path / "m.yaml")).findings])
    assert said[0] == []
    (told,) = said[1]
    assert "cannot hold the platform at home" in told
    assert f"anchors lie in one {where}" in told and "gravity" in told


@pytest.mark.parametrize("name", ["cable-4-planar", "cable-8", "hangprinter", "maslow"])
def test_ropes_of_shipped_machines_hold(name):
    machine = read_mechanism(ROOT / "configs" / f"{name}.yaml")
    assert not [f for f in check(machine).findings if "hold the platform" in str(f)]


def test_check_says_how_far_the_nominal_machine_misses(tmp_path):
    bodies.machine(tmp_path)
    bodies.wide(tmp_path, bodies.measured(3))
    found = ppmcal("check", "bench.yaml", "wide.csv", "--json", cwd=tmp_path, expect=0)
    misses = json.loads(found.out)["misses"]["position"]
    assert 0.005 < misses["rms"] < 5.0 and misses["unit"] == "mm"

    bench = tmp_path / "bench.yaml"
    bench.write_text(bench.read_text().replace("point: [1000, 0]", "point: [1006, 0]"))
    found = ppmcal("check", "bench.yaml", "wide.csv", cwd=tmp_path, expect=1)
    assert "Errors of the nominal machine before any fit of its geometry: position" in found.out
    assert "farther from nominal than tolerances allow: leg2.base.point.x by" in found.out
