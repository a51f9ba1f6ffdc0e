"""The machine, drawn: what the scene holds, the page, its names, and what a browser makes of it."""

import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import yaml
from helpers import constrained
from helpers.commands import ppmcal
from helpers.machines import CASES, KINDS, mechanism_text, plain, read_text
from helpers.paths import ROOT
from helpers.redundant import machine as redundant_machine
from helpers.redundant import rope_cage

import ppmcal as face
from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism
from ppmcal.io.results.scene import Scene
from ppmcal.io.results.scene_machine import MeasuredPose
from ppmcal.model.limbs import kinds as limb_kinds
from ppmcal.report.drawing import drawing_page
from ppmcal.report.machine_section import findings

CONFIGS = sorted(p.stem for p in (ROOT / "configs").glob("*.yaml"))
LARGEST = 5_000_000
EVIL = "</script><img src=x onerror=alert(1)> & \u2028 'leg'"


def config(name):
    return read_mechanism(ROOT / "configs" / f"{name}.yaml")


@cache
def scene_of(name):
    return Scene.of(config(name) if name in CONFIGS else plain(name))


def scenes_in(page):
    """Return the scenes that a page holds."""
    return [json.loads(text) for text in re.findall(
        r'<script type="application/json" class="scene">(.*?)</script>', page, re.S)]


def scene_in(page):
    """Return the scene that a page holds."""
    return scenes_in(page)[0]


@pytest.mark.slow_cases(
    "6-PUS", "6-RUS", "cable-8-pulleys", "delta-linear-6rods", "delta-rotary-6rods", "(R)US",
    "(P)US", "U(P)S", "3-UPU", "cable-8", "delta-parallelograms", "linapod", "mixed-spatial",
    "passive-legs", "stewart-7")
@pytest.mark.parametrize("name", [*CONFIGS, *KINDS])
def test_every_machine_is_drawn_with_all_its_limbs(name):
    machine = config(name) if name in CONFIGS else plain(name)
    scene = scene_of(name)
    page = drawing_page(scene)
    assert len(page) < LARGEST
    held = scene_in(page)
    drawn = held["machines"][0]
    assert [limb["name"] for limb in drawn["limbs"]] == [limb.name for limb in machine.limbs]
    assert held["flat"] == (machine.motion.planar)
    assert sorted(drawn["platform_outline"]) == list(range(len(machine.limbs)))
    assert set(held["order"]) == set(range(len(drawn["frames"])))
    for frame in drawn["frames"]:
        for limb, placed in zip(drawn["limbs"], frame["limbs"], strict=True):
            count = len(limb_kinds()[limb["kind"]].joint_slots) // 6
            assert count == 3 or limb["kind"] in constrained.MACHINES or (
                limb_kinds()[limb["kind"]].pulls_only)
            assert len(placed.get("joints", ())) == len(limb.get("joints", ())) == count
            assert len(placed["links"]) == len(limb["links"]) > 0
            assert np.isfinite(np.concatenate([np.ravel(v) for v in placed["links"]])).all()
    home = drawn["frames"][0]
    factors = [machine.units.factor("length" if c < 3 else "angle") for c in machine.dof]
    np.testing.assert_allclose(home["pose"], machine.home_pose[list(machine.dof)] / factors,
                               rtol=1e-6, atol=1e-12)
    f = machine.units.factor("length")
    for limb, placed in zip(machine.limbs, home["limbs"], strict=True):
        v = limb.slots.values(machine.values)
        point = [v.get(f"{limb.kind.point('base')}.{c}", 0.0) / f for c in "xyz"]
        np.testing.assert_allclose(placed["base"], point, rtol=1e-6, atol=1e-9)


def test_a_wrong_sign_is_another_drawing():
    """The same machine with a rail turned round, or the other elbow."""
    def middle(change):
        limbs = [change(i, dict(limb)) for i, limb in enumerate(CASES["(R)RR"].limbs)]
        machine = read_text(mechanism_text(limbs, "planar", CASES["(R)RR"].home))
        return Scene.of(machine).machines[0].frames[0].limbs[0].joints[1]

    right = middle(lambda i, limb: limb)
    other = middle(lambda i, limb: limb | ({"elbow": -1} if i == 0 else {}))
    assert np.linalg.norm(np.subtract(right, other)) > 100.0


def marked(text):
    scene = Scene.of(read_text(text))
    return {m.kind for m in scene.machines[0].frames[0].marks}, findings(scene)


@pytest.mark.slow
def test_what_needs_a_look_is_marked_and_said():
    text = (ROOT / "configs/3-RRR-1.yaml").read_text()
    assert marked(text) == (set(), [])
    kinds, said = marked(text.replace("distal: 220", "distal: 30.1"))
    assert kinds == {"stretched"} and "leg1 is stretched out or folded" in said[0]
    kinds, said = marked(text.replace("limits: {leg1: [-80, 40]", "limits: {leg1: [0, 40]"))
    assert kinds == {"travel"} and "leg1 is outside of its travel: -25.38 of 0 to 40 deg" in said[0]
    kinds, said = marked(text.replace("distal: 220", "distal: 20", 1))
    assert kinds == {"gap"} and "leg1 does not close: 10 mm are missing" in said[0]
    kinds, said = marked(turned((ROOT / "configs/3-RPR.yaml").read_text()))
    assert "links" in kinds and any("links of leg1 and leg2 cross" in t for t in said)


def test_a_home_q_that_does_not_close_is_drawn_open():
    text = (ROOT / "configs/3-RPR.yaml").read_text()
    q = dict(zip(("leg1", "leg2", "leg3"), Scene.of(read_text(text)).machines[0].frames[0].q,
                 strict=True))
    file = yaml.safe_load(text)
    file["home"]["q"] = q | {"leg2": q["leg2"] + 20.0}
    scene = Scene.of(read_text(yaml.safe_dump(file)))
    home = scene.machines[0].frames[0]
    assert [m.limbs for m in home.marks if m.kind == "gap"] == [(1,)]
    assert "leg2 does not close: 20 mm" in findings(scene)[0]
    assert home.limbs[1].gap_ends is not None and home.limbs[0].gap_ends is None
    assert len(scene.machines[0].frames) > 5


def turned(text):
    """Return the file with its platform turned so far that legs cross, and no limits."""
    file = yaml.safe_load(text)
    file["home"]["pose"]["rz"] = 160
    return yaml.safe_dump({k: v for k, v in file.items() if k != "limits"})


def test_joints_in_one_place_are_said_but_no_alarm():
    machine = config("6-UPS")
    slots = {p.name: p for p in machine.parameters}
    g = machine.values.copy()
    for c in ("radius", "angle", "z"):
        g[machine.names.index(f"leg1.platform.point.{c}")] = slots[
            f"leg2.platform.point.{c}"].value
    page = drawing_page(Scene.of(replace(machine.with_values(g), parameters=tuple(
        replace(p, nominal=p.value) for p in machine.with_values(g).parameters))))
    assert "Joints in one place: leg1 and leg2." in page and 'class="m-look"' not in page


def test_ropes_that_touch_as_drawn_are_said_but_no_alarm(tmp_path):
    cage = rope_cage()
    page = drawing_page(Scene.of(redundant_machine(tmp_path, cage)))
    assert "Links that touch at home: r1 and r5, r2 and r6, r3 and r7, r4 and r8." in page
    assert 'class="m-look"' not in page and "e-13 mm" not in page
    cage["limbs"][0]["platform"]["point"][0] += 40     # in each other's way, not in one point
    scene = Scene.of(redundant_machine(tmp_path, cage))
    assert re.match(r"At home links of r1 and r5 are 2\d mm apart\.", findings(scene)[0])
    assert {m.kind for m in scene.machines[0].frames[0].marks} == {"links", "touching"}


def test_the_other_branch_of_a_limb_is_another_line():
    machine = scene_of("3-RRR-1").machines[0]
    for limb, placed, other in zip(machine.limbs, machine.frames[0].limbs, machine.other,
                                   strict=True):
        assert limb.kind == "(R)RR" and len(other) == 3
        np.testing.assert_allclose([other[0], other[2]], [placed.base, placed.platform], atol=1e-6)
        bars = np.linalg.norm(np.diff(other, axis=0), axis=1)
        np.testing.assert_allclose(bars, 220.0, atol=1e-6)
        assert np.linalg.norm(np.subtract(other[1], placed.joints[1])) > 10.0
    assert scene_of("6-UPS").machines[0].other == ((),) * 6


@pytest.mark.slow
def test_present_values_lie_over_the_nominal_ones_and_are_magnified():
    machine = plain("U(P)S")
    g = machine.values.copy()
    g[machine.names.index("leg1.base.point.x")] += 0.3e-3
    scene = Scene.of(machine.with_values(g))
    one, two = scene.machines
    apart = np.subtract(two.frames[0].limbs[0].base, one.frames[0].limbs[0].base)
    np.testing.assert_allclose(apart, [0.3, 0.0, 0.0], atol=1e-9)
    seen = scene.magnification * 0.3
    assert 0.01 * scene.reach < seen <= 0.05 * scene.reach
    assert f"{scene.magnification:g} times" in drawing_page(scene)
    assert len(scene_of("6-UPS").machines) == 1 and scene_of("6-UPS").magnification == 1.0


def test_measured_poses_and_errors_are_in_the_scene():
    found = MeasuredPose(label="row 1", point=(1.0, 2.0, 3.0), value=0.4, error=(0.1, 0.0, 0.0))
    scene = Scene.of(config("3-RPR"), [found], "error", "mm")
    held = scene_in(drawing_page(scene))
    assert held["measured"][0]["error"] == [0.1, 0.0, 0.0] and held["value"] == "error"
    assert held["error_magnification"] * 0.1 <= 0.05 * held["reach"]
    assert held["magnification"] == 1.0


def test_names_cannot_break_the_page():
    machine = config("3-RPR")
    bad = replace(machine, name=EVIL, limbs=(replace(machine.limbs[0], name=EVIL),
                                             *machine.limbs[1:]))
    page = drawing_page(Scene.of(bad), EVIL)
    assert "<img" not in page.replace(page[page.index("/* plotly.js "):], "")
    assert page.count("</script>") == 3
    held = scene_in(page)
    assert held["name"] == EVIL and held["machines"][0]["limbs"][0]["name"] == EVIL


def test_the_page_needs_no_network():
    page = drawing_page(scene_of("3-RPS"))
    assert not re.search(r"<(?:script|link|img|iframe)[^>]*\s(?:src|href)=[\"'](?!data:)", page)
    assert "default-src 'none'" in page and "Licensed under the MIT license" in page


# --- the command --------------------------------------------------------------------------------


@pytest.mark.slow
def test_check_draws_and_says_where(tmp_path):
    ppmcal("init", "3-RPS", "--out", "mine.yaml", cwd=tmp_path, expect=0)
    plain_run = ppmcal("check", "mine.yaml", "--json", cwd=tmp_path, expect=0).json
    assert "drawing" not in plain_run
    run = ppmcal("check", "mine.yaml", "--draw", "new/machine.html", cwd=tmp_path, expect=0)
    assert "The machine, drawn: new/machine.html" in run.out
    held = scene_in((tmp_path / "new/machine.html").read_text(encoding="utf-8"))
    assert [m["name"] for m in held["machines"][0]["limbs"]] == ["leg1", "leg2", "leg3"]
    again = ppmcal("check", "mine.yaml", "--draw", "new/machine.html", "--json", cwd=tmp_path,
                   expect=0)
    assert again.json == {**plain_run, "drawing": "new/machine.html"}
    assert [p.name for p in (tmp_path / "new").iterdir()] == ["machine.html"]


@pytest.mark.slow
def test_no_input_and_nothing_foreign_is_replaced(tmp_path):
    ppmcal("init", "3-RPR", "--out", "base.yaml", cwd=tmp_path, expect=0)
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"extends": "base.yaml"}))
    (tmp_path / "page.html").write_text("<p>mine</p>")
    (tmp_path / "folder").mkdir()
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()}
    for target in ("mine.yaml", "base.yaml", "page.html", "page.html/x.html"):
        run = ppmcal("check", "mine.yaml", "--draw", target, cwd=tmp_path, expect=2)
        assert target.split("/")[0] in run.err and "Traceback" not in run.err
    ppmcal("check", "mine.yaml", "--draw", "folder", cwd=tmp_path, expect=2)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir() if p.is_file()} == before


def test_the_record_of_check_draws_too(tmp_path):
    result = face.check(face.shipped("3-RPR"))
    assert result.scene.name == "3-RPR" and not result.findings
    assert result.draw(tmp_path / "a.html") == tmp_path / "a.html"
    (tmp_path / "b.html").write_text("not a drawing")
    with pytest.raises(BadInput, match="did not draw it"):
        result.draw(tmp_path / "b.html")
