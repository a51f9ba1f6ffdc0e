"""Every broken mechanism file is refused with file, place and hint; one edit each."""


import pytest
from helpers.broken import GOOD, edited

from ppmcal.errors import BadInput
from ppmcal.io import read_mechanism

BENCH, CRANK, RAILS = "good_bench.yaml", "good_crank.yaml", "good_rails.yaml"

# (name, good file, text to replace, its replacement, place, what the message must say)
BROKEN = [
    ("no format", BENCH, "format: ppmcal/mechanism/1\n", "", "", "format"),
    ("other format", BENCH, "mechanism/1", "mechanism/2", "format", "ppmcal/mechanism/1"),
    ("no units", BENCH, "units: {length: mm, angle: deg}\n", "", "", "units: {length: mm"),
    ("half units", BENCH, "{length: mm, angle: deg}", "{length: mm}", "units", "angle: deg"),
    ("odd unit", BENCH, "length: mm", "length: ft", "units.length", "m, cm, mm, um, in"),
    ("odd angle", BENCH, "angle: deg}\nm", "angle: degrees}\nm", "units.angle", "'deg'"),
    ("no motion", BENCH, "motion: planar\n", "", "", "motion: planar"),
    ("odd motion", BENCH, "motion: planar", "motion: plannar", "motion", "'planar'"),
    ("motion and kind", BENCH, "motion: planar", "motion: spatial", "limbs.leg1.kind", "planar"),
    ("unknown top key", BENCH, "limits:", "limit:", "", "Did you mean 'limits'?"),
    ("unknown limb key", BENCH, "    branch: 1", "    brunch: 1", "limbs.leg2", "'branch'"),
    ("other kind's key", BENCH, "    branch: 1", "    elbow: 1", "limbs.leg2", "elbow"),
    ("unknown base key", BENCH, "base: {point: [0, 0]}", "base: {pont: [0, 0]}",
     "limbs.leg1.base", "'point'"),
    ("unknown kind", BENCH, "kind: 3-R(P)R", "kind: R(P)Q", "limbs.leg1.kind", "R(P)R"),
    ("kind is a number", BENCH, "kind: 3-R(P)R", "kind: 3", "limbs.leg1.kind", "R(P)R"),
    ("no kind", BENCH, "    kind: 3-R(P)R\n", "", "limbs.leg1", "kind"),
    ("no limb name", BENCH, "  - name: leg1\n    kind", "  - kind", "limbs[1]", "name"),
    ("name with comma", BENCH, "- name: leg1", '- name: "a,b"', "limbs[1].name", "letters"),
    ("same limb twice", BENCH, "- name: leg2", "- name: leg1", "limbs[2].name", "leg1"),
    ("no point", BENCH, "base: {point: [0, 0]}", "base: {}", "limbs.leg1.base.point", "[0, 0]"),
    ("no base", BENCH, "    base: {point: [0, 0]}\n", "", "limbs.leg1.base.point", "[0, 0]"),
    ("three coordinates", BENCH, "point: [0, 0]", "point: [0, 0, 0]", "limbs.leg1.base.point",
     "instead of 2"),
    ("word in point", BENCH, "point: [0, 0]", "point: [0, abc]", "limbs.leg1.base.point.y",
     "'abc' is not a number"),
    ("decimal comma", BENCH, "point: [0, 0]", 'point: ["0,5", 0]', "limbs.leg1.base.point.x",
     "decimal point"),
    ("nan in point", BENCH, "point: [0, 0]", "point: [0, .nan]", "limbs.leg1.base.point.y",
     "finite"),
    ("bool in point", BENCH, "point: [0, 0]", "point: [0, true]", "limbs.leg1.base.point.y",
     "not a number"),
    ("point is a word", BENCH, "point: [0, 0]", "point: here", "limbs.leg1.base.point", "[0, 0]"),
    ("half polar", BENCH, "point: [0, 0]", "point: {radius: 3}", "limbs.leg1.base.point",
     "angle"),
    ("polar and x", BENCH, "point: [0, 0]", "point: {radius: 3, angle: 0, x: 1}",
     "limbs.leg1.base.point", "'x'"),
    ("odd slot key", BENCH, "point: [0, 0]", "point: [0, {value: 1, tolerence: 2}]",
     "limbs.leg1.base.point.y", "'tolerance'"),
    ("slot without value", BENCH, "point: [0, 0]", "point: [0, {fixed: true}]",
     "limbs.leg1.base.point.y", "value"),
    ("negative tolerance", BENCH, "point: [0, 0]", "point: [0, {value: 1, tolerance: -2}]",
     "limbs.leg1.base.point.y.tolerance", "standard deviation"),
    ("fixed is a word", BENCH, "point: [0, 0]", "point: [0, {value: 1, fixed: maybe}]",
     "limbs.leg1.base.point.y.fixed", "true or false"),
    ("branch 2", BENCH, "    branch: 1", "    branch: 2", "limbs.leg2.branch", "1 or -1"),
    ("share without value", BENCH, "point: [0, 0]", "point: [{share: b}, 0]",
     "limbs.leg1.base.point.x", "no value"),
    ("share contradicts", BENCH, "point: [0, 0]",
     "point: [{value: 1, share: b}, {value: 2, share: b}]", "limbs.leg1.base.point.y",
     "different"),
    ("share of another quantity", BENCH, "point: [0, 0]",
     "point: {radius: {value: 1, share: b}, angle: {share: b}}", "limbs.leg1.base.point.angle",
     "quantity"),
    ("share is a slot", BENCH, "point: [0, 0]", "point: [{value: 1, share: leg2.offset}, 0]",
     "limbs.leg1.base.point.x", "another name"),
    ("too few limbs", BENCH, "  - name: leg3\n    kind: R(P)R\n    base: {point: [500, 866.025]}\n"
     "    platform: {point: [0, 138.564]}\n", "", "limbs", "2 conditions"),
    ("no limbs", BENCH, "limbs:\n  - name: leg1", "limbs: []\nfree:\n  - name: leg1", "", "limb"),
    ("effects in front", RAILS, "format: ppm", "effects: [1]\nformat: ppm", "effects[1]",
     "a mapping"),
    ("no home", BENCH, "home: {pose: {x: 500, y: 260, rz: 25}, q: {leg1: 400}}\n", "", "", "home"),
    ("no pose", BENCH, "pose: {x: 500, y: 260, rz: 25}, ", "", "home", "pose"),
    ("z in the plane", BENCH, "y: 260", "y: 260, z: 3", "home.pose", "'z'"),
    ("pose incomplete", BENCH, "y: 260, ", "", "home.pose", "'y'"),
    ("pose is a list", BENCH, "{x: 500, y: 260, rz: 25}", "[500, 260, 25]", "home.pose",
     "mapping"),
    ("home.q unknown", BENCH, "q: {leg1: 400}", "q: {leg9: 400}", "home.q", "leg1"),
    ("odd class", BENCH, "{point: 0.5", "{points: 0.5", "tolerances", "'point'"),
    ("negative class", BENCH, "{point: 0.5", "{point: -0.5", "tolerances.point", "0 or more"),
    ("limit of nobody", BENCH, "limits: {leg1", "limits: {leg7", "limits", "leg1"),
    ("limits reversed", BENCH, "[200, 900]", "[900, 200]", "limits.leg1", "[lower, upper]"),
    ("one limit", BENCH, "[200, 900]", "[900]", "limits.leg1", "2 numbers"),
    ("no gravity", BENCH, "gravity: [0, -1, 0]", "gravity: [0, 0, 0]", "gravity", "zero"),
    ("effects", BENCH, "effects: []", "effects: [{kind: backlash, on: [leg1]}]",
     "effects[1].parameters.width", "Add `width: ...` in mm"),
    ("free names nothing", BENCH, "effects: []", 'free: ["*.ofset"]', "free", "offset"),
    ("free is a word", BENCH, "effects: []", "free: yes", "free", ""),
    ("key twice", BENCH, "effects: []", "name: again", ":23:", "stands twice"),
    ("bad indentation", BENCH, "    kind: R(P)R\n    base: {point: [1000, 0]}",
     "   kind: R(P)R\n    base: {point: [1000, 0]}", ":11:", "indentation"),
    ("open bracket", BENCH, "[200, 900]}", "[200, 900", "bench.yaml:", "brackets"),
    ("tag", BENCH, "name: 3-RPR bench", "name: !!python/object:os.system x", "bench.yaml:2",
     "tag"),
    ("circular alias", BENCH, "gravity: [0, -1, 0]", "gravity: &a [*a, *a]", "bench.yaml",
     "endless"),
    *((f"tag {tag}", BENCH, "name: 3-RPR bench", f"name: !!{tag}", "bench.yaml", "YAML") for tag in
      ("bool x", "timestamp x", "timestamp 2001-01-01", "map [1, 2]", "map 3", "float [1]",
       "int [1]", "set {a}", "binary xx")),
    ("extends nothing", BENCH, "effects: []", "extends: nowhere.yaml", "nowhere.yaml",
     "no such file"),
    ("extends itself", BENCH, "effects: []", "extends: bench.yaml", "extends", "circle"),
    ("registration", BENCH, "effects: []", "measurement: {datasets: {a: {frame: {x: 1}}}}",
     "measurement.datasets.a.frame", "'y'"),
    ("no direction", RAILS, "direction: [0, 0, 1]}, platform: {point: [-126",
     "angle: 3}, platform: {point: [-126", "limbs.leg1.base", "direction"),
    ("zero direction", RAILS, "direction: [0, 0, 1]}, platform: {point: [-126",
     "direction: [0, 0, 0]}, platform: {point: [-126", "limbs.leg1.base.direction", "zero"),
    ("flat direction", RAILS, "direction: [0, 0, 1]}, platform: {point: [-126",
     "direction: [0, 1]}, platform: {point: [-126", "limbs.leg1.base.direction", "3 numbers"),
    ("rod of 0", RAILS, "length: 1250, ratio", "length: 0, ratio", "limbs.leg1.length",
     "greater than 0"),
    ("no rod", RAILS, "length: 1250, ratio", "ratio", "limbs.leg1", "'length'"),
    ("ratio 0", RAILS, "ratio: 71.2", "ratio: 0", "limbs.leg1.ratio", "moves nothing"),
    ("ratio on one of two", RAILS, "ratio: 71.2", "ratio: 71.2, actuator: leg2",
     "limbs.leg2.actuator", "ratio"),
    ("quaternion norm", RAILS, "quat_w: 1", "quat_w: 1.1", "home.pose", "length 1"),
    ("quaternion incomplete", RAILS, ", quat_w: 1", "", "home.pose", "quat_w"),
    ("rotation twice", RAILS, "quat_w: 1", "quat_w: 1, rx: 0", "home.pose", "twice"),
    ("slanted zero", CRANK, "zero: [1, 0, 0]", "zero: [1, 0.01, 0]", "limbs.arm1.base.zero",
     "perpendicular"),
    ("zero with tolerance", CRANK, "zero: [1, 0, 0]", "zero: {value: [1, 0, 0], tolerance: 1}",
     "limbs.arm1.base.zero", "base.axis"),
    ("no zero", CRANK, ", zero: [1, 0, 0]", "", "limbs.arm1", "base.zero"),
    ("angle and length share", CRANK, "    proximal: 150\n    distal: 340\n  - name: arm2\n"
     "    kind: (R)US\n    base: {point: [-60, 103.923, 0], axis: [-0.866025404, -0.5, 0], "
     "zero: [-0.5, 0.866025404, 0]}\n    platform: {point: [-20, 34.641, 0]}\n"
     "    proximal: 150\n    distal: 340\n",
     "    proximal: 150\n    distal: 340\n  - name: arm2\n    actuator: arm1\n    kind: U(P)S\n"
     "    base: {point: [-60, 103.923, 0]}\n    platform: {point: [-20, 34.641, 0]}\n",
     "limbs.arm2.actuator", "angle"),
    ("rotation of a delta", CRANK, "z: -300", "z: -300, rz: 1", "home.pose", "'rz'"),
]


@pytest.mark.parametrize(("good", "old", "new", "place", "says"),
                         [pytest.param(*case[1:], id=case[0]) for case in BROKEN])
def test_refused(tmp_path, good, old, new, place, says):
    path = edited(tmp_path, good, (old, new), once=True)
    with pytest.raises(BadInput) as caught:
        read_mechanism(path)
    message = str(caught.value)
    assert path.name in message
    assert place in message
    assert says in message
    assert caught.value.hint
    assert caught.value.where.startswith(str(path))


@pytest.mark.parametrize("good", [BENCH, CRANK, RAILS])
def test_unbroken(good):
    assert read_mechanism(GOOD / good).findings == ()


@pytest.mark.parametrize("content", [
    b"", b"# only a comment\n", b"\x00\x01\x02", b"\xff\xfea\x00", b"\x89PNG\r\n\x1a\n\x00",
    b"- 1\n- 2\n", b"just words", b"a: [", b"\xe9\xe8", b"[" * 100_000, b"{a: " * 5000,
    b"? [1, 2]\n: 3\n", b"a: &x [1]\nb: *y\n", b'a: "\\ud800"\n', b"1: 2\n",
    b"a: " + b"9" * 10_000 + b"\n", b"limbs: {}\n"])
def test_not_a_mechanism_at_all(tmp_path, content):
    path = tmp_path / "bench.yaml"
    path.write_bytes(content)
    with pytest.raises(BadInput, match=r"bench\.yaml") as caught:
        read_mechanism(path)
    assert caught.value.hint


def test_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "bench.yaml").write_text("a: 1\n")
    with pytest.raises(BadInput, match=r"Did you mean 'bench\.yaml'"):
        read_mechanism(tmp_path / "bensh.yaml")


def test_a_folder_is_no_file(tmp_path):
    with pytest.raises(BadInput, match="cannot be read"):
        read_mechanism(tmp_path)


def test_several_problems_are_counted(tmp_path):
    path = edited(tmp_path, BENCH, ("mechanism/1", "x"), ("[200, 900]", "[1]"))
    with pytest.raises(BadInput, match=r"\(\+1 more\)"):
        read_mechanism(path)
