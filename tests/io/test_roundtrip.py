"""What is written reads back equal, to the last bit; and no bytes give a traceback."""

import dataclasses

import numpy as np
import pytest
import yaml
from helpers.paths import ROOT
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from ppmcal.errors import BadInput
from ppmcal.io import read_dataset, read_mechanism, read_poses, read_scenario, write_mechanism
from ppmcal.io.yaml import decimals, dump_yaml, number_text, read_yaml
from ppmcal.model.limbs import kinds
from ppmcal.units import to_file

GOOD = ROOT / "tests" / "broken"
SETTINGS = settings(max_examples=30, deadline=None,
                    suppress_health_check=[HealthCheck.function_scoped_fixture])


def assert_same(a, b, exact_nominals=True):
    """Everything of two mechanisms is equal but where they were read from."""
    for f in dataclasses.fields(a):
        x, y = getattr(a, f.name), getattr(b, f.name)
        if f.name in ("source", "findings", "digits", "limbs", "registrations", "parameters"):
            continue
        if isinstance(x, np.ndarray):
            np.testing.assert_array_equal(x, y, err_msg=f.name)
        else:
            assert x == y, f.name
    for p, q in zip(a.parameters, b.parameters, strict=True):
        if exact_nominals:
            assert p == q
        else:
            assert dataclasses.replace(p, nominal=0.0) == dataclasses.replace(q, nominal=0.0)
            assert p.nominal == pytest.approx(q.nominal, rel=1e-12, abs=1e-14)
    for m, n in zip(a.limbs, b.limbs, strict=True):
        assert (m.name, m.kind, m.actuator, m.slots, m.branch) == (
            n.name, n.kind, n.actuator, n.slots, n.branch)
        assert list(m.constants) == list(n.constants)
        for name in m.constants:
            np.testing.assert_array_equal(m.constants[name], n.constants[name])
    assert list(a.registrations) == list(b.registrations)
    for name, r in a.registrations.items():
        for f in dataclasses.fields(r):
            np.testing.assert_array_equal(getattr(r, f.name),
                                          getattr(b.registrations[name], f.name))


def back(mechanism, path, comment=""):
    path.write_text(write_mechanism(mechanism, comment), encoding="utf-8")
    return read_mechanism(path)


numbers = st.one_of(st.floats(-2000, 2000).map(lambda v: round(v, 3)), st.floats(-2e3, 2e3))
positive = st.floats(0.01, 2000)
spread = st.one_of(st.floats(1e-6, 10), st.just(float("inf")), st.just(0.0))


@st.composite
def slots(draw, value=numbers):
    out = {"value": draw(value)}
    if draw(st.booleans()):
        return out["value"]
    for key, strategy in (("tolerance", spread), ("nominal", value), ("fixed", st.booleans()),
                          ("sigma", st.floats(0, 3))):
        if draw(st.booleans()):
            out[key] = draw(strategy)
    return out


@st.composite
def points(draw, size, shares):
    form = draw(st.sampled_from(["list", "map", "polar", "shared"]))
    axes = "xyz"[:size]
    if form == "list":
        return [draw(slots()) for _ in axes]
    if form == "map":
        return {a: draw(slots()) for a in axes}
    radius = draw(slots(positive))
    if form == "shared":
        radius = {"share": "b"} if shares else {"value": draw(positive), "share": "b"}
        shares.append("b")
    return {"radius": radius, "angle": draw(slots()), **({"z": draw(slots())} if size == 3 else {})}


def put(tree, path, value):
    """Write a value under a path, such as base.pulley.center."""
    *heads, last = path.split(".")
    for head in heads:
        tree = tree.setdefault(head, {})
    tree[last] = value


@st.composite
def limbs(draw, kind, name, shares):
    out = {"name": name, "kind": kind.name}
    size = 2 if kind.planar else 3
    for spec in kind.slots:
        point, _, tail = spec.name.rpartition(".")
        if point.endswith((".point", ".center")):
            if tail == "x":
                put(out, point, draw(points(size, shares)))
        elif spec.name in ("offset", "lateral", "ratio"):
            if draw(st.booleans()):
                out[spec.name] = draw(slots(positive if spec.name == "ratio" else numbers))
        elif spec.default is None:
            put(out, spec.name, draw(slots(positive)))
    for direction in kind.directions:
        zero = direction in kind.zeros.values()
        axis = [0.6, 0.0, 0.8] if zero else [0.8, 0.0, -0.6]
        if kind.planar:
            axis = [0.6, 0.8, 0.0] if zero else [0.0, 0.0, -1.0]
        if direction == "base.direction":
            axis = [draw(st.floats(-1, 1)), draw(st.floats(-1, 1)), 1.0]
        if not (zero or kind.planar) and draw(st.booleans()):
            axis = {"value": axis, "tolerance": draw(spread), "sigma": [0.1, 0.2, 0.3]}
        put(out, direction, axis)
    if kind.branch and draw(st.booleans()):
        out[kind.branch] = draw(st.sampled_from([1] if kind.strut else [1, -1]))
    if kind.joint_slots and draw(st.booleans()):
        out["joint1"] = {"rz": draw(slots()), "x": draw(slots())}
    return out


@st.composite
def mechanism_trees(draw):
    kind = kinds()[draw(st.sampled_from(sorted(kinds())))]
    still = kind.surface.angles or not kind.driven    # one such limb, the others move it
    motion = "planar" if kind.planar else "spatial" if still else draw(
        st.sampled_from(["spatial", "translational"]))
    conditions = kind.surface.equations
    count, rest = divmod(6 if motion == "spatial" else 3, conditions)
    shares = []
    strut = kinds()["U(P)S"]
    if still:
        made = [draw(limbs(strut, f"leg{i}", shares)) for i in range(6 - conditions)]
        made.append(draw(limbs(kind, "last", shares)))
    else:
        made = [draw(limbs(kind, f"leg{i}", shares)) for i in range(count)]
    if rest and not still:
        made.append(draw(limbs(strut, "last", shares)))
    coordinates = {"planar": ("x", "y", "rz"), "translational": ("x", "y", "z"),
                   "spatial": ("x", "y", "z", "rx", "ry", "rz")}[motion]
    tree = {"format": "ppmcal/mechanism/1", "name": draw(st.text(st.characters(
                codec="utf-8", categories=("L", "N", "P")), min_size=1)).strip() or "m",
            "units": {"length": draw(st.sampled_from(["mm", "m", "in", "um"])),
                      "angle": draw(st.sampled_from(["deg", "rad"]))},
            "motion": motion, "limbs": made,
            "home": {"pose": {c: draw(st.floats(-3, 3)) for c in coordinates}}}
    if draw(st.booleans()):
        tree["home"]["q"] = {"leg0": draw(numbers)}
    if draw(st.booleans()):
        tree["tolerances"] = {c: draw(spread) for c in ("point", "length", "angle", "offset")
                              if draw(st.booleans())}
    if draw(st.booleans()):
        tree["limits"] = {"leg0": [draw(st.floats(-9, -1)), draw(st.floats(0, 9))]}
    if draw(st.booleans()):
        tree["free"] = ["*.base.point.?"] + ["*.joint1.*"] * draw(st.integers(0, 1))
    if draw(st.booleans()):
        planar = {"x": 1.5, "y": -2.25, "rz": 0.3}
        tree["measurement"] = {"datasets": {"run 1": {
            "frame": planar if motion == "planar" else {**planar, "z": 0, "rx": 0.1, "ry": 0.2},
            "target": [1.1, 2.2, 0 if motion == "planar" else 3.3],
            "target_rotation": [0, 0, 0.123]}}}
    return tree


@SETTINGS
@given(tree=mechanism_trees())
@pytest.mark.long
def test_mechanisms_read_back_equal(tmp_path, tree):
    path = tmp_path / "m.yaml"
    path.write_text(dump_yaml(tree), encoding="utf-8")
    try:
        first = read_mechanism(path)
    except BadInput as refused:
        assert "names no parameter" in str(refused)  # all points polar
        return
    second = back(first, path, "a comment\nof two lines")
    if len(tree.get("tolerances", {})) == 4:  # else defaults, which no file number may hit
        assert_same(first, second)
    assert_same(second, back(second, path))


@pytest.mark.long
@SETTINGS
@given(seed=st.integers(0, 1000), scale=st.sampled_from([0.0, 1e-9, 1e-3, 0.02]),
       good=st.sampled_from(["bench", "crank", "rails"]))
def test_fitted_machines_read_back_equal(tmp_path, seed, scale, good):
    """Values of a fit survive to 1 ulp, and from then on exactly; so does every direction."""
    rng = np.random.default_rng(seed)
    m = read_mechanism(GOOD / f"good_{good}.yaml")
    fitted = dataclasses.replace(m, parameters=tuple(
        dataclasses.replace(p, value=p.value + scale * rng.normal(),
                            sigma=None if p.fixed else abs(rng.normal()) * 1e-3)
        for p in m.parameters))
    once = back(fitted, tmp_path / "m.yaml")
    twice = back(once, tmp_path / "m.yaml")
    assert_same(once, twice, exact_nominals=False)
    plain = [i for i, n in enumerate(m.names) if n.rpartition(".")[2] not in ("rx", "ry", "rz")]
    np.testing.assert_allclose(once.values[plain], fitted.values[plain], rtol=4e-16)
    np.testing.assert_allclose(once.nominals[plain], fitted.nominals[plain], rtol=4e-16)
    assert once.free == fitted.free
    sigmas = np.array([[np.nan if p.sigma is None else p.sigma for p in x.parameters]
                       for x in (once, fitted)])
    np.testing.assert_allclose(sigmas[0], sigmas[1], rtol=4e-16)


def test_another_choice_of_free_parameters_is_written(tmp_path):
    m = read_mechanism(GOOD / "good_bench.yaml").with_free(["*.offset"])
    again = back(m, tmp_path / "m.yaml")
    assert again.free == m.free
    assert again.free_patterns == ("leg1.offset", "leg2.offset", "leg3.offset")


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e250, max_value=1e250),
       st.sampled_from([1.0, 1e-3, 1e-6, 0.0254, np.pi / 180]))
@settings(deadline=None)
def test_numbers_cross_the_border_exactly(printed, factor):
    value = printed * factor
    if abs(value) > 1e-250 or value == 0.0:
        assert to_file(value, factor) * factor == value


@given(st.floats())
@settings(deadline=None)
@example(1e-5)
@example(1e22)
@example(-0.0)
def test_number_text_is_exact(value):
    import math

    import yaml

    text = number_text(value)
    read = yaml.safe_load(text)
    assert isinstance(read, int | float)
    assert math.isnan(read) if math.isnan(value) else float(read) == value


@pytest.mark.parametrize(("value", "places"), [
    (500, 0), (-69.282, 3), (1e-7, 7), (1.5e-7, 8), (1e20, 0), (1.25e1, 1), (float("inf"), 0)])
def test_decimals(value, places):
    assert decimals(value) == places


words = st.text(st.characters(codec="utf-8", exclude_categories=("Cs", "Cc")), max_size=8)
plain_data = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(-10**6, 10**6),
              st.floats(allow_nan=False), words,
              st.sampled_from(["1e5", "on", "010", "1:30", ".5", "null", "~", "yes", "2020-01-01",
                               "1_000", "0x1f", "=", "<<", "- a", "a: b", "#", ""])),
    lambda inner: st.one_of(st.lists(inner, max_size=3),
                            st.dictionaries(words, inner, max_size=3)), max_leaves=8)


@pytest.mark.slow
@given(st.dictionaries(words, plain_data, min_size=1, max_size=4))
@SETTINGS
def test_yaml_reads_back_equal(tmp_path, tree):
    path = tmp_path / "t.yaml"
    path.write_text(dump_yaml(tree), encoding="utf-8")
    assert read_yaml(path) == tree


BENCH = read_mechanism(GOOD / "good_bench.yaml")
TEXTS = {name: (GOOD / f"good_{name}").read_bytes()
         for name in ("bench.yaml", "rails.yaml", "crank.yaml", "run.csv", "run.yaml",
                      "scenario.yaml")}
junk = st.one_of(st.binary(max_size=4), st.sampled_from(
    [b"", b"\n", b",", b"{", b"}", b"[", b"]", b": ", b"- ", b"nan", b".inf", b"1e999", b"-", b"0",
     b"null", b"true", b"&a ", b"*a", b"!!map ", b'"', b"'", b"\t", b"#", b"\xff", b"\x00", b"~",
     b"9" * 400, b"share", b"value", b"\r", b"%", b"|", b"_"]))


@settings(max_examples=200, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(name=st.sampled_from(sorted(TEXTS)), data=st.data())
@pytest.mark.slow
def test_no_bytes_give_a_traceback(tmp_path, name, data):
    text = TEXTS[name]
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = min(len(text), start + data.draw(st.integers(0, 12)))
        text = text[:start] + data.draw(junk) + text[stop:]
    for other in ("run.csv", "run.yaml"):
        (tmp_path / other).write_bytes(TEXTS[other])
    path = tmp_path / name
    path.write_bytes(text)
    try:
        if name == "scenario.yaml":
            read_scenario(path, BENCH)
        elif name.startswith("run"):
            read_dataset(tmp_path / "run.csv", BENCH)
            read_poses(tmp_path / "run.csv", BENCH)
        else:
            back(read_mechanism(path), path)
    except BadInput as refused:
        assert "/" in refused.where
        assert refused.hint


@settings(max_examples=60, deadline=None,
          suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(content=st.binary(max_size=300))
def test_random_bytes_give_no_traceback(tmp_path, content):
    for name, read in (("a.yaml", read_mechanism), ("a.csv", lambda p: read_poses(p, BENCH))):
        (tmp_path / name).write_bytes(content)
        try:
            read(tmp_path / name)
        except BadInput as refused:
            assert refused.hint


def test_the_tolerances_stay_those_of_the_file(tmp_path):
    """Also where most slots have one of their own, and where no slot is of the class."""
    tree = yaml.safe_load((ROOT / "configs" / "6-UPS.yaml").read_text(encoding="utf-8"))
    tree["tolerances"] = {"point": 0.5, "length": 0.7, "angle": 0.01, "offset": 1.0}
    for limb in tree["limbs"][1:]:
        for where in ("base", "platform"):
            radius = limb[where]["point"]["radius"]
            limb[where]["point"]["radius"] = {"value": radius, "tolerance": 0.25}
            limb[where]["point"]["z"] = {"value": 0, "tolerance": 0.25}
    path = tmp_path / "a.yaml"
    path.write_text(dump_yaml(tree), encoding="utf-8")
    m = read_mechanism(path)
    assert yaml.safe_load(write_mechanism(m))["tolerances"] == tree["tolerances"]
    assert_same(m, back(m, path))
