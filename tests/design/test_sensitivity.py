"""J_g and what follows from it, against other ways to the same numbers and [LIN]'s figures."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import columns, number, ppmcal, rows, write_csv
from helpers.paths import ROOT

from ppmcal import algebra as cga
from ppmcal.design.error_jacobian import (
    Linearity,
    Poses,
    covariance,
    determinants,
    displacement,
    error_jacobian,
    root_sum_square,
    survey,
    worst_case,
)
from ppmcal.design.error_sources import all_components, geometry_only, group_of, sources, tolerances
from ppmcal.design.sensitivity import SensitivityOptions, analyse
from ppmcal.io import read_mechanism
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.mechanism import Mechanism

CONFIGS = ROOT / "configs"
MACHINES = sorted(p.stem for p in CONFIGS.glob("*.yaml"))
SOME = ("3-RPR", "mixed-planar", "3-RPS", "6-UPS", "linapod", "delta-rotary-6rods")
"""Of each motion, and with limbs that share a drive; every kind of limb is in tests/model."""
TOOL = np.array([0.03, -0.02, 0.05])


def machine(name: str) -> Mechanism:
    return geometry_only(read_mechanism(CONFIGS / f"{name}.yaml"))


def near_home(mechanism: Mechanism, count: int = 4) -> Poses:
    """Poses that the machine takes at joint values around home, and a tool off its origin."""
    rng = np.random.default_rng(3)
    q = home_state(mechanism).q
    step = np.array([0.02 * mechanism.reach if u == "length" else 0.05
                     for u in mechanism.actuator_quantity])
    bare = np.array([abs(limb.slots.values(mechanism.values).get("ratio", 1.0))
                     for limb in mechanism.limbs])
    scale = np.array([bare[[limb.actuator == a for limb in mechanism.limbs]][0]
                      for a in range(len(q))])
    q = q + rng.uniform(-1.0, 1.0, (count, len(q))) * step / scale
    found = forward(Model(mechanism), q)
    assert found.converged.all()
    tool = TOOL * [1, 1, 0] if mechanism.motion.planar else TOOL
    return Poses(q, found.pose, tool)


def free_of(mechanism: Mechanism) -> list[int]:
    return [s.parameter for s in sources(mechanism)]


# ---------------------------------------------------------------- three ways to J_g

@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_by_leg_lines_is_by_refitted_forward_kinematics(name: str) -> None:
    m = machine(name)
    at, free = near_home(m), free_of(m)
    lines = error_jacobian(Model(m), at, free)
    h = 1e-6
    for column, p in enumerate(free):
        step = np.zeros(len(m.parameters))
        step[p] = h
        plus, minus = (displacement(Model(m), at, np.tile(m.values + s * step, (len(at.q), 1)))
                       for s in (1.0, -1.0))
        np.testing.assert_allclose((plus - minus) / (2 * h), lines[..., column], rtol=2e-6,
                                   atol=2e-7 * max(1.0, np.abs(lines).max()), err_msg=m.names[p])


@pytest.mark.parametrize("name", ["6-UPS", "linapod", "6-RUS", "3-RPR", "3-RPS", "delta-linear"])
def test_by_leg_lines_is_by_unit_loads(name: str) -> None:
    """[LIN] section 2.5: unit loads at the tool, carried into the legs, times frame twists."""
    m = all_components(machine(name))
    at, free = near_home(m), free_of(m)
    closure = Model(m).closure(at.q, free)
    wrenches = cga.rotation_matrix(at.motor) @ at.tool
    found = error_jacobian(Model(m), at, free)
    a, b = closure.pose_matrix(at.motor), closure.error_matrix(at.motor, free)
    dof = list(m.dof)
    for k in range(6):
        load = np.zeros((len(at.q), 6))
        load[:, k] = 1.0
        if k < 3:  # a force at the tool is also a moment about the platform origin
            load[:, 3:] = np.cross(wrenches, load[:, :3])
        legs = np.linalg.solve(np.swapaxes(a, 1, 2), load[:, dof, None])[..., 0]
        by_load = -np.einsum("nd,ndp->np", legs, b)
        np.testing.assert_allclose(found[:, k], by_load, atol=1e-9 * np.abs(found).max())


@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
@pytest.mark.parametrize("everything", [False, True], ids=["file", "components"])
def test_covariance_without_the_jacobian_is_with_it(name: str, everything: bool) -> None:
    m = all_components(machine(name)) if everything else machine(name)
    at, free = near_home(m), free_of(m)
    sigma = np.random.default_rng(1).uniform(0.1, 2.0, len(free))
    dense = error_jacobian(Model(m), at, free) * sigma
    whole = dense @ np.swapaxes(dense, 1, 2)
    np.testing.assert_allclose(covariance(Model(m), at, free, sigma), whole,
                               atol=1e-10 * np.abs(whole).max())


def test_machines_of_their_own_are_machines_one_by_one() -> None:
    for name in ("3-RPR", "delta-linear", "linapod", "3-RPS"):
        m = machine(name)
        tau = np.array([p.tolerance or 0.0 for p in m.parameters])
        g = m.values + np.random.default_rng(5).normal(size=(4, len(tau))) * np.where(
            np.isfinite(tau), tau, 0.0)
        q = np.tile(home_state(m).q, (4, 1))
        one_by_one = np.concatenate([forward(Model(m, row), q[:1]).pose for row in g])
        np.testing.assert_allclose(forward(Model(m, g), q).pose, one_by_one, atol=1e-14)
        keep = np.array([2, 0])
        np.testing.assert_allclose(forward(Model(m, g).take(keep), q[keep]).pose,
                                   one_by_one[keep], atol=1e-14)


# ---------------------------------------------------------------- components

@pytest.mark.parametrize("name", ["6-UPS", "6-PUS", "6-RUS", "linapod"])
def test_components_are_21_for_a_leg(name: str) -> None:
    m = all_components(machine(name))
    assert len(m.free) == 126
    assert {group_of(m.names[p].partition(".")[2]) for p in m.free} == {
        "joint1", "joint2", "joint3", "platform.point"}


@pytest.mark.parametrize("name", MACHINES)
def test_components_do_not_move_the_machine(name: str) -> None:
    m = machine(name)
    apart = all_components(m)
    q = home_state(m).q[None]
    np.testing.assert_allclose(Model(apart).closure(q).misclosure(m.home[None]),
                               Model(m).closure(q).misclosure(m.home[None]), atol=1e-13)
    assert (tolerances(apart, sources(apart)) > 0.0).all()


@pytest.mark.parametrize(("name", "own", "slot", "class_tolerance"), [
    ("6-UPS", True, "joint1.x", 0.5e-3), ("3-RRR-1", False, "joint2.rz", np.radians(0.1))])
def test_components_have_the_tolerance_of_their_class(
        name: str, own: bool, slot: str, class_tolerance: float) -> None:
    """Not that of the first slot of the class, and also where the file has no such slot."""
    tree = yaml.safe_load((CONFIGS / f"{name}.yaml").read_text(encoding="utf-8"))
    if own:
        tree["limbs"][0]["base"]["point"]["z"] = {"value": 0, "tolerance": 7}
    m = all_components(geometry_only(read_mechanism(tree)))
    found = {p.name: p for p in m.parameters}
    limb = m.limbs[0].name
    assert found[f"{limb}.{slot}"].tolerance == pytest.approx(class_tolerance, rel=1e-12)


def test_what_the_closure_cancels_does_nothing() -> None:
    """A U(P)S strut does not feel its second joint turn about the centre of its first."""
    m = all_components(machine("6-UPS"))
    free = free_of(m)
    jacobian = error_jacobian(Model(m), near_home(m), free)
    size = {m.names[p]: float(np.abs(jacobian[..., i]).max()) for i, p in enumerate(free)}
    assert size["leg1.joint1.rx"] < 1e-12 and size["leg1.joint1.rz"] < 1e-12
    assert size["leg1.joint3.z"] > 0.1 and size["leg1.platform.point.x"] > 0.01


# ---------------------------------------------------------------- worst case

@pytest.mark.parametrize("flat", [False, True], ids=["space", "plane"])
def test_the_worst_case_is_the_worst_of_all_signs(flat: bool) -> None:
    rng = np.random.default_rng(8)
    for count in (1, 3, 6, 9, 11):
        jacobian = rng.normal(size=(60, 6, count))
        if flat:
            jacobian[:, 2:5] = 0.0
        limits = rng.uniform(0.1, 1.0, count)
        signs = np.array(list(itertools.product((-1.0, 1.0), repeat=count))) * limits
        every = np.einsum("nkp,sp->nks", jacobian, signs)
        position, rotation = worst_case(jacobian, limits)
        np.testing.assert_allclose(position, np.linalg.norm(every[:, :3], axis=1).max(axis=1))
        np.testing.assert_allclose(rotation, np.linalg.norm(every[:, 3:], axis=1).max(axis=1))


def test_root_sum_square_is_between_one_error_and_the_worst_case() -> None:
    m = machine("6-UPS")
    at, free = near_home(m), free_of(m)
    tau = tolerances(m, sources(m))
    over = survey(Model(m), at, free, tau, tau)
    dense = error_jacobian(Model(m), at, free) * tau
    largest = np.linalg.norm(dense[:, :3], axis=1).max(axis=1)
    assert (over.position > largest).all() and (over.worst_position > over.position).all()
    np.testing.assert_allclose(over.position, root_sum_square(
        covariance(Model(m), at, free, tau))[0])
    np.testing.assert_allclose(np.sum((over.by_position * tau) ** 2), np.mean(over.position**2))


# ---------------------------------------------------------------- the Linapod of [LIN]

def linapod(tmp_path: Path, *options: object) -> dict:
    return ppmcal("sensitivity", CONFIGS / "linapod.yaml", "--json", "--out", tmp_path / "o",
                  *options).json


@pytest.mark.slow
def test_six_bars_ten_micrometres_too_long(tmp_path: Path) -> None:
    found = linapod(tmp_path, "--all-components", "--home-only", "--together", "*.joint3.z",
                    "--size", 1e-5)
    assert found["errors"] == 126 and found["together"]["errors"] == 6
    assert found["together"]["exact"] == pytest.approx(11.528e-6, abs=0.002e-6)
    assert found["together"]["relative"] == pytest.approx(1.31e-6, rel=0.01)
    large = linapod(tmp_path, "--home-only", "--together", "*.length", "--size", 0.01)
    assert large["together"]["relative"] == pytest.approx(1.30e-3, rel=0.01)


@pytest.mark.slow
def test_figure_9_grows_with_the_square_of_the_error(tmp_path: Path) -> None:
    linapod(tmp_path, "--home-only", "--together", "*.length")
    table = rows(tmp_path / "o" / "linearity.csv")
    size, apart = (np.array([number(r, c) for r in table]) for c in ("size", "difference"))
    use = (size > 1e-5) & (size < 1e-2)
    slope = np.polyfit(np.log(size[use]), np.log(apart[use]), 1)[0]
    assert slope == pytest.approx(2.0, abs=0.01)


@pytest.mark.long
def test_amplification_is_least_at_the_centre_and_roughly_circular(tmp_path: Path) -> None:
    """[LIN] section 4.2 and Fig. 10, read off a map of the 126 components."""
    linapod(tmp_path, "--all-components", "--grid", "x=-0.3:0.3:41,y=-0.3:0.3:41")
    table = rows(tmp_path / "o" / "map.csv")
    x, y, index = (np.array([number(r, c) for r in table])
                   for c in ("x", "y", "amplification_position"))
    least = np.nanargmin(index)
    assert np.hypot(x[least], y[least]) < 0.03
    radius = np.hypot(x, y)
    rings = [index[(radius > r - 0.01) & (radius < r + 0.01)] for r in (0.1, 0.2, 0.3)]
    middles = [float(np.nanmean(r)) for r in rings]
    assert np.nanmin(index) < middles[0] < middles[1] < middles[2]
    for ring, middle in zip(rings, middles, strict=True):
        # round: along a ring it differs by much less than it has risen from the centre
        assert np.nanstd(ring) < 0.25 * (middle - np.nanmin(index))


# ---------------------------------------------------------------- linear against nonlinear

def test_the_linear_model_is_told_where_it_ends() -> None:
    scale = np.array([0.1, 1.0, 10.0])
    both = np.stack([scale, scale], axis=1)
    apart = np.array([[0.0001, 0.0], [0.0, 0.005], [0.5, 0.0]])
    curve = Linearity(scale, both, both, apart, 1.0)
    assert curve.holds_to(0.01) == 1.0
    assert curve.holds_to(1e-6) == 0.0 and curve.holds_to(1.0) == np.inf
    # a size at which the machine cannot go is a size at which the model is wrong
    lost = Linearity(scale, both, both, np.array([[0.0001, 0.0], [np.nan] * 2, [np.nan] * 2]), 1.0)
    assert lost.holds_to(0.01) == 0.1
    # what does not turn is not wrong about turning
    level = Linearity(scale, both * [1, 0], both * [1, 0], apart * [1, 0], 1.0)
    assert level.holds_to(0.01) == 1.0


@pytest.mark.slow
def test_near_a_singularity_the_command_says_so(tmp_path: Path) -> None:
    text = (CONFIGS / "3-RPR.yaml").read_text()
    home = text.index("home:")
    end = text.index("\n", home)
    path = tmp_path / "near.yaml"
    path.write_text(text[:home] + "home: {pose: {x: 500, y: 288.675, rz: 1}}" + text[end:])
    run = ppmcal("sensitivity", path, "--home-only", "--out", tmp_path / "o", "--json")
    assert run.code == 1
    assert any("linear model is wrong" in f for f in run.json["findings"])


# ---------------------------------------------------------------- the command

@pytest.mark.slow
@pytest.mark.parametrize("name", SOME)
def test_every_machine(name: str, tmp_path: Path) -> None:
    m = machine(name)
    run = ppmcal("sensitivity", CONFIGS / f"{name}.yaml", "--home-only", "--json", "--out",
                 tmp_path / "o")
    assert run.code in (0, 1), run.err
    found = run.json
    table = rows(tmp_path / "o" / "sensitivity.csv")
    assert len(table) == len(sources(m)) == found["errors"]
    share = [number(r, "share_position") for r in table]
    assert sum(share) == pytest.approx(1.0)
    told_apart = [round(s, 9) for s in share]    # equal legs stay in the file's order
    assert told_apart == sorted(told_apart, reverse=True)
    assert sum(g["share_position"] for g in found["groups"]["limb"]) == pytest.approx(1.0)
    # units: the table's columns times the tolerance are the root sum square at home
    away = np.array([[number(r, f"d{c}") * number(r, "tolerance") for c in m.coordinates
                      if c in "xyz"] for r in table])
    assert np.sqrt(np.sum(away**2)) == pytest.approx(found["home"]["rss_position"], rel=1e-9)
    assert ("rotation" in columns(tmp_path / "o" / "sensitivity.csv")) is (
        m.motion.turns)


@pytest.mark.slow
def test_units_do_not_matter(tmp_path: Path) -> None:
    """The same machine in metres and radians."""
    from dataclasses import replace

    from ppmcal.io import write_mechanism
    from ppmcal.units import Units

    m = read_mechanism(CONFIGS / "6-UPS.yaml")
    (tmp_path / "si.yaml").write_text(write_mechanism(replace(m, units=Units("m", "rad"))))
    mm, si = (ppmcal("sensitivity", p, "--home-only", "--json", "--out", tmp_path / "o",
                     "--tool", tool).json["home"]
              for p, tool in ((CONFIGS / "6-UPS.yaml", "10,0,-120"),
                              (tmp_path / "si.yaml", "0.01,0,-0.12")))
    assert mm["rss_position"] == pytest.approx(1e3 * si["rss_position"])
    assert mm["worst_rotation"] == pytest.approx(np.degrees(si["worst_rotation"]))
    assert mm["amplification_position"] == pytest.approx(si["amplification_position"])
    assert mm["amplification_rotation"] == pytest.approx(
        np.degrees(si["amplification_rotation"]) / 1e3)


def test_poses_of_a_file_and_their_jacobians(tmp_path: Path) -> None:
    write_csv(tmp_path / "p.csv", [{"x": 500, "y": 290, "rz": 30}, {"x": 5000, "y": 0, "rz": 0},
                                   {"x": 520, "y": 280, "rz": 25}])
    run = ppmcal("sensitivity", CONFIGS / "3-RPR.yaml", "--poses", tmp_path / "p.csv", "--out",
                 tmp_path / "o", expect=1)
    assert "row 2" in run.out
    table = rows(tmp_path / "o" / "map.csv")
    assert [r["status"] for r in table] == ["ok", "limits", "ok"] or table[1]["status"] != "ok"
    assert np.isnan(number(table[1], "rss_position"))
    entries = rows(tmp_path / "o" / "jacobian.csv")
    assert {r["row"] for r in entries} == {"1", "3"}
    tau = {r["name"]: number(r, "tolerance") for r in rows(tmp_path / "o" / "sensitivity.csv")}
    first = [r for r in entries if r["row"] == "1"]
    total = sum((number(r, c) * tau[r["name"]]) ** 2 for r in first for c in ("dx", "dy"))
    assert np.sqrt(total) == pytest.approx(number(table[0], "rss_position"), rel=1e-9)


@pytest.mark.slow
def test_a_map_has_its_pictures_and_the_right_place(tmp_path: Path) -> None:
    run = ppmcal("sensitivity", CONFIGS / "delta-linear.yaml", "--grid", "x=-50:50:5,y=-40:40:7",
                 "--json", "--out", tmp_path / "o", expect=0)
    table = rows(tmp_path / "o" / "map.csv")
    assert len(table) == 35 and number(table[1], "y") == pytest.approx(-40 + 80 / 6)
    for picture in run.json.get("pictures", {}):
        assert (tmp_path / "o" / picture).read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "o" / "map_rss_position.png").exists()
    assert not (tmp_path / "o" / "map_rss_rotation.png").exists()


@pytest.mark.parametrize(("options", "words"), [
    (("--grid", "u=1:2"), "unknown pose coordinate 'u'"),
    (("--grid", "x=2:1"), "lower to a higher"),
    (("--grid", "x=1:2:1"), "fewer than 2"),
    (("--grid", "x=a:b"), "not a number"),
    (("--grid", "x,x"), "twice"),
    (("--grid", "x=0:1:3000,y=0:1:3000"), "the limit is 2,000,000"),
    (("--grid", ""), "names no coordinate"),
    (("--tool", "1"), "is not a point"),
    (("--tool", "nan,0"), "is not a point"),
    (("--metric", "-1"), "is not a length"),
    (("--free", "nothing"), "unknown parameter"),
    (("--together", "nothing"), "names none of the errors"),
    (("--together", "*"), "same amount"),
    (("--size", "1"), "goes with --together"),
    (("--home-only", "--grid", "x"), "only one of"),
    (("--sigmas", "0"), "standard deviations"),
    (("--sigmas", "inf"), "standard deviations"),
    (("--sigmas", "nan"), "standard deviations"),
])
@pytest.mark.slow_cases("options11-names none of the errors")
def test_bad_options_are_refused(options: tuple[str, ...], words: str, tmp_path: Path) -> None:
    machine_file = CONFIGS / ("6-RUS.yaml" if options == ("--together", "*") else "3-RPR.yaml")
    run = ppmcal("sensitivity", machine_file, *options, "--out", tmp_path / "o", expect=2)
    assert words in run.err.replace("\n", " ")
    assert not (tmp_path / "o").exists()


def test_a_singular_home_is_refused(tmp_path: Path) -> None:
    text = (CONFIGS / "3-RPR.yaml").read_text()
    home = text.index("home:")
    (tmp_path / "m.yaml").write_text(text[:home] + "home: {pose: {x: 500, y: 288.675, rz: 0}}"
                                     + text[text.index("\n", home):])
    run = ppmcal("sensitivity", tmp_path / "m.yaml", "--out", tmp_path / "o")
    assert run.code == 3 and "singular" in run.err and not (tmp_path / "o").exists()


@pytest.mark.slow
def test_the_size_of_errors_moved_together_is_in_their_unit(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_text((CONFIGS / "3-PRR-1.yaml").read_text() + '\nfree: ["*.base.angle"]\n')
    found = ppmcal("sensitivity", path, "--home-only", "--together", "*", "--size", 1, "--json",
                   "--out", tmp_path / "o").json["together"]
    assert found["size"] == pytest.approx(1.0) and found["size_unit"] == "deg"
    run = ppmcal("sensitivity", CONFIGS / "3-RPR.yaml", "--home-only", "--together", "*.offset",
                 "--size", 1e6, "--out", tmp_path / "p")
    assert "too large" in run.out and "nan" not in run.out


def test_no_error_is_refused(tmp_path: Path) -> None:
    text = (CONFIGS / "3-RPR.yaml").read_text()
    path = tmp_path / "m.yaml"
    assert "\nfree:" not in text
    path.write_text(text.replace("tolerances:", "free: []\ntolerances:", 1))
    run = ppmcal("sensitivity", path, "--out", tmp_path / "o", expect=2)
    assert "no parameter is free" in run.err


def test_effects_and_their_parameters_are_no_geometry() -> None:
    m = read_mechanism(CONFIGS / "3-RPR.yaml")
    found = analyse(m, SensitivityOptions(np.zeros(3), m.length_scale))
    assert all("effect" not in m.names[s.parameter] for s in found.sources)


def test_the_determinant_changes_sign_where_the_machine_is_singular() -> None:
    m = machine("3-RPR")
    q = home_state(m).q[None]
    assert determinants(Model(m), q, m.home[None])[0] == pytest.approx(1.0)
