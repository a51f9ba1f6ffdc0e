"""What may have changed between two sessions beside parameters: homing, bed, instrument, body."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.printers import printer, touches
from helpers.redundant import alone, belts, written
from helpers.sessions import BOX, POSITION, ROTATION, Array, drawn, machine

import ppmcal as ppmcal_of
from ppmcal import algebra as cga
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import noise_check, with_noise
from ppmcal.calibration.fit.prior_information import Posterior
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.sessions.change_detection import Comparison, between, posterior_of
from ppmcal.calibration.sessions.session_posteriors import session_knowledge
from ppmcal.calibration.validation.residual_vectors import residuals
from ppmcal.commands.inputs import prepared
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.kinematics.registration import measured_pose
from ppmcal.model.dataset import Dataset
from ppmcal.model.instruments import find_instrument
from ppmcal.model.mechanism import Mechanism
from ppmcal.model.registration import Registration

PLAIN = FitOptions(robust=False)


def known(mechanism: Mechanism, data: Dataset) -> Posterior:
    """Return what a file would hold of a fit, its noise as the check says."""
    fit = identify(Problem(mechanism, (data,), mechanism.free), PLAIN)
    return posterior_of(with_noise(fit, noise_check(fit).inflation, PLAIN), {})


def values(mechanism: Mechanism, found: Posterior) -> Array:
    """Return the machine's parameters (P,) with those that were fitted."""
    g = mechanism.values.copy()
    g[list(found.places)] = found.value
    return g


def compared(mechanism: Mechanism, old: Dataset, new: Dataset) -> Comparison:
    one, two = known(mechanism, old), known(mechanism, new)
    return between(mechanism.with_values(values(mechanism, two)), one, two, {},
                   np.random.default_rng(0))[0]


def tied(found: Comparison) -> set[str]:
    """Return the first change and what is as likely."""
    return {n for c in found.changes[:1] for n in (c.name, *c.instead)}


def raised(data: Dataset, mechanism: Mechanism, g: Array, bed: tuple[float, float, float]
           ) -> Dataset:
    """Return touches as counted from a bed at height, rx and ry (m, rad)."""
    x, y, _ = cga.translation(forward(Model(mechanism, g), data.q).pose).T
    return replace(data, value=data.value - bed[0] - bed[1] * y + bed[2] * x)


def test_columns_are_what_a_change_does(tmp_path: Path) -> None:
    """Central differences of the rows along the bed's shape, height and homing."""
    mechanism, rng = printer(tmp_path), np.random.default_rng(3)
    g = drawn(mechanism, rng)
    data = touches(mechanism, g, rng, 12)
    fit = identify(Problem(mechanism, (data,), mechanism.free), PLAIN)
    found = session_knowledge(fit)
    assert found.single and "scale of plane" not in found.names
    free, sigma = len(fit.problem.free), data.sigma_value[0]
    before = residuals(fit.problem, fit.state).vector[0][:, 0]
    assert found.right == pytest.approx(before / sigma)

    def column(name: str) -> Array:
        return found.matrix[:, free + found.names.index(name)] * sigma

    step = 1e-6
    q = fit.state.registrations[0].homing
    for name, change in (("homing.a of session", [1.0, 0, 0]), ("homing.c of session",
                                                                [0, 0, 1.0])):
        ends = []
        for way in (step, -step):
            moved = replace(fit.state.registrations[0], homing=q + way * np.array(change) * 1e3)
            state = fit.problem.solve(replace(fit.state, registrations=(moved,)))
            ends.append(residuals(fit.problem, state).vector[0][:, 0])
        assert column(name) == pytest.approx((ends[1] - ends[0]) / (2e3 * step), rel=1e-5,
                                             abs=1e-9)
    x, y, _ = cga.translation(fit.state.poses[0]).T
    assert column("frame.z of plane") == pytest.approx(np.ones(x.size))
    assert column("shape.saddle of plane") == pytest.approx((x**2 - y**2) / mechanism.reach)


@pytest.mark.slow
def test_a_bed_that_moved_is_tied_with_homing(tmp_path: Path) -> None:
    """Seen by its sign and size; a radius or three offsets are not the headline."""
    mechanism, rng = printer(tmp_path, ratio=-0.0125), np.random.default_rng(4)
    g = drawn(mechanism, rng)
    one, two = (touches(mechanism, g, rng, 40) for _ in "ab")
    found = compared(mechanism, one, raised(two, mechanism, g, (2e-4, 0.0, 0.0)))
    assert {"height of the bed", "homing of all joints alike"} <= tied(found)
    first = found.changes[0]
    if first.name == "height of the bed":
        assert first.parts[0].value == pytest.approx(2e-4, abs=3.0 * first.parts[0].sigma)
    same = compared(mechanism, one, two)
    assert not same.changed and same.p_value > 0.01


def test_a_bed_that_tilts_has_its_sign(tmp_path: Path) -> None:
    mechanism, rng = printer(tmp_path, ratio=-0.0125), np.random.default_rng(5)
    g = drawn(mechanism, rng)
    one, two = (touches(mechanism, g, rng, 40) for _ in "ab")
    found = compared(mechanism, one, raised(two, mechanism, g, (0.0, 2e-3, -1e-3)))
    assert "tilt of the bed" in tied(found)
    (change,) = [c for c in found.changes if "tilt of the bed" in c.name] or [None]
    if change is not None:
        by = {p.name: p for p in change.parts}
        assert by["rx"].value == pytest.approx(2e-3, abs=4.0 * by["rx"].sigma)
        assert by["ry"].value == pytest.approx(-1e-3, abs=4.0 * by["ry"].sigma)


def poses(mechanism: Mechanism, name: str, g: Array, rng: np.random.Generator,
          registration: Registration | None = None, q: Array | None = None,
          wave: float = 0.0) -> Dataset:
    """Measure full poses by an instrument that is said to stand in the base."""
    if q is None:
        pose = mechanism.home_pose + rng.uniform(-1.0, 1.0, (120, 6)) * BOX[name]
        found = inverse(Model(mechanism), pose_motor(pose))
        q = found.q[found.reached][:50]
    true = q + wave * np.sin(40.0 * q + np.arange(q.shape[1]))
    seen = measured_pose(registration or Registration(), forward(Model(mechanism, g), true).pose)
    seen = seen + rng.normal(size=seen.shape) * ([POSITION] * 3 + [ROTATION] * 3)
    if mechanism.motion.planar:
        seen[:, [2, 3, 4]] = np.nan
    return Dataset.of_poses("poses", q, seen, (POSITION, ROTATION), False)


def test_an_instrument_that_moved_is_no_change_of_legs() -> None:
    mechanism, rng = machine("3-RPR"), np.random.default_rng(6)
    g = drawn(mechanism, rng)
    moved = Registration.of_pose(np.array([4e-4, -3e-4, 0, 0, 0, 6e-4]))
    found = compared(mechanism, poses(mechanism, "3-RPR", g, rng),
                     poses(mechanism, "3-RPR", g, rng, moved))
    (change,) = found.changes
    assert change.name == "instrument moved" and np.all(found.explained == 0.0)
    by = {p.name: p for p in change.parts}
    assert by["rz"].value == pytest.approx(6e-4, abs=4.0 * by["rz"].sigma)


@pytest.mark.slow
def test_rods_that_all_grow_and_a_scale(tmp_path: Path) -> None:
    """All lengths by one amount are one number; so is the scale of distances."""
    mechanism, rng = printer(tmp_path, ratio=-0.0125), np.random.default_rng(11)
    g = drawn(mechanism, rng)
    h = g.copy()
    h[[i for i, n in enumerate(mechanism.names) if n.endswith(".length")]] += 3e-4
    angle = 2.0 * np.pi * np.arange(40) / 40
    pose = np.zeros((40, 6))
    pose[:, :3] = 0.09 * np.stack([np.cos(angle), np.sin(angle), np.sin(3.0 * angle) + 1.0]).T

    def positions(values: Array) -> Dataset:
        q = inverse(Model(mechanism, values), pose_motor(pose)).q
        data = Dataset.of_poses("a", q, pose + 1e-5 * rng.normal(size=pose.shape), (1e-5, 1e-5),
                                False)
        return replace(data, kind=find_instrument("position"),
                       rotation=np.full((len(q), 3), np.nan))

    found = compared(mechanism, positions(g), positions(h))
    assert "length of all limbs alike" in tied(found)
    grown = [e for n, e in zip(found.names, found.explained, strict=True) if n.endswith("length")]
    if found.changes[0].name == "length of all limbs alike":
        assert grown == pytest.approx([3e-4] * 3, abs=4.0 * found.changes[0].parts[0].sigma)
    one = positions(g)
    two = positions(g)
    found = compared(mechanism, one, replace(two, position=1.001 * two.position))
    assert found.changes[0].name == "scale of the measurements"
    assert found.changes[0].parts[0].value == pytest.approx(
        1e-3, abs=4.0 * found.changes[0].parts[0].sigma)


@pytest.mark.slow
def test_a_body_defined_anew_is_no_change_of_legs() -> None:
    mechanism, rng = machine("6-UPS"), np.random.default_rng(7)
    g = drawn(mechanism, rng)
    anew = Registration.of_pose(np.zeros(6), np.array([5e-4, 0, -4e-4]),
                                np.array([1e-3, -8e-4, 5e-4]))
    found = compared(mechanism, poses(mechanism, "6-UPS", g, rng),
                     poses(mechanism, "6-UPS", g, rng, anew))
    assert found.changes[0].name == "measured body defined anew"
    by = {p.column.split(" ")[0]: p for p in found.changes[0].parts}
    assert by["target_rotation.rx"].value == pytest.approx(
        1e-3, abs=4.0 * by["target_rotation.rx"].sigma)


@pytest.mark.slow
def test_what_both_miss_alike_is_no_noise() -> None:
    """At the same poses again a misfit of six sigma cancels, and a change of two still shows."""
    mechanism, rng = machine("3-RPR"), np.random.default_rng(8)
    g = drawn(mechanism, rng)
    first = poses(mechanism, "3-RPR", g, rng, wave=6.0 * POSITION)
    again = poses(mechanism, "3-RPR", g, rng, q=first.q, wave=6.0 * POSITION)
    same = compared(mechanism, first, again)
    assert known(mechanism, first).inflation > 2.0
    assert same.noise.same and same.noise.share < 0.5 and max(same.noise.old, same.noise.new) < 1.5
    assert not same.changed and 0.3 < same.chi2 / same.freedom < 2.0
    h = g.copy()
    h[mechanism.names.index("leg2.offset")] += 3.0 * POSITION
    found = compared(mechanism, first, poses(mechanism, "3-RPR", h, rng, q=first.q,
                                             wave=6.0 * POSITION))
    assert found.changed and "leg2.offset" in tied(found)


@pytest.mark.long
def test_what_is_missed_at_other_poses_is_noise() -> None:
    """Elsewhere it does not cancel: chi-squared of pairs without a change stays near its mean."""
    mechanism, sizes, named = machine("3-RPR"), [], 0
    for seed in range(12):
        rng = np.random.default_rng([9, seed])
        g = drawn(mechanism, rng)
        found = compared(mechanism, *(poses(mechanism, "3-RPR", g, rng, wave=4.0 * POSITION)
                                      for _ in "ab"))
        assert max(found.noise.old, found.noise.new) > 1.5
        sizes.append(found.chi2 / found.freedom)
        named += found.changed
    assert 0.5 < np.mean(sizes) < 1.5 and named <= 1


def framed(fixed: bool) -> dict[str, Any]:
    """Return the file of four belts; what defines the frame is ``fixed``, or held by a fit."""
    tree = belts()
    for limb, axes in zip(tree["limbs"], ("xy", "y", "", ""), strict=True):
        limb["base"]["point"] = {a: {"value": v, "fixed": True} if fixed and a in axes else v
                                 for a, v in zip("xy", limb["base"]["point"], strict=True)}
    return tree


def in_frame(folder: Path, tree: dict[str, Any], seed: int, errors: dict[str, float],
             homed: tuple[float, ...] = (), low: bool = False) -> tuple[Mechanism, Dataset]:
    """Return belts read at 40 places, and the machine with what defines its frames held.

    ``errors`` in mm; ``homed``: by how much each belt reads more, m; ``low``: all places are on the
    line from one of the lower anchors to the other.
    """
    scenario = alone(tree, {"x": 900, "y": 700}, 40, 0.3, seed=seed,
                     errors={"tl.base.point.x": 10, **errors})
    if low:
        scenario["poses"]["random"] |= {"center": {"x": 1500, "y": 0},
                                        "half_range": {"x": 900, "y": 20}}
    path = written(folder, tree)
    data, = ppmcal_of.simulate(path, scenario).data
    data = replace(data, q=data.q + np.array(homed)) if homed else data
    mechanism, (data,) = prepared(str(path), [data])
    return mechanism, data


@pytest.fixture(scope="module", params=[False, True], ids=["held", "fixed"])
def before(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
           ) -> tuple[dict[str, Any], Path, Posterior]:
    """Return belts' file, a folder, and what is known before anything moves."""
    tree, folder = framed(request.param), tmp_path_factory.mktemp("framed")
    return tree, folder, known(*in_frame(folder, tree, 21, {}))


@pytest.mark.long
@pytest.mark.parametrize(("moved", "homed", "named"), [
    ({"bl.base.point.x": 4}, (), "bl.base.point.x"),
    ({"bl.base.point.y": -4}, (), "bl.base.point.y"),
    ({"br.base.point.y": 4}, (), "br.base.point.y"),
    ({"tr.base.point.x": 4}, (), "tr.base.point.x"),
    ({}, (0.003, -0.004, 0.006, -0.002), "homing of every joint"), ({}, (), "")])
def test_an_anchor_that_defines_the_frame_is_named_where_it_moved(
        before: tuple[dict[str, Any], Path, Posterior], moved: dict[str, float],
        homed: tuple[float, ...], named: str) -> None:
    """It is not fitted, and moves all the others as they are seen: no homing, and no other anchor.

    A free one, joints homed anew and nothing at all are told as such.
    """
    tree, folder, old = before
    mechanism, data = in_frame(folder, tree, 22, moved, homed=homed)
    new = known(mechanism, data)
    found, notes = between(mechanism.with_values(values(mechanism, new)), old, new, {},
                           np.random.default_rng(0))
    assert [c.name for c in found.changes] == [named] * bool(named)
    told = [n for n in notes if n.topic == "gauge"]
    frame = new.defining.names if new.defining else ()
    assert frame == ("bl.base.point.x", "bl.base.point.y", "br.base.point.y")
    assert bool(told) == (named in frame) and all(named in n for n in told)
    for n, size in moved.items():
        part, = found.changes[0].parts
        assert abs(part.value - 1e-3 * size) < 4.0 * part.sigma < 2e-3
        seen = dict(zip(found.names, found.explained.tolist(), strict=True))
        # as the first anchor goes one way, all others are seen to go the other
        if n == "bl.base.point.x":
            assert [seen[f"{b}.base.point.x"] for b in ("br", "tr", "tl")] == pytest.approx(
                [-part.value] * 3)
            assert seen["tr.base.point.y"] == seen["tl.base.point.y"] == 0.0


@pytest.mark.long
def test_an_anchor_that_moved_along_its_rope_is_tied_with_its_homing(tmp_path: Path) -> None:
    """Where that rope always points one way nothing tells the two apart, and both are said."""
    tree = framed(False)
    (mechanism, one), (_, two) = (
        in_frame(tmp_path, tree, seed, moved, low=True)
        for seed, moved in ((23, {}), (24, {"bl.base.point.x": 20})))
    found = compared(mechanism, one, two)
    assert {"bl.base.point.x", "homing of bl"} <= tied(found)


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """idA and idB: leg 2 homed anew between them; idC: the instrument stood elsewhere."""
    folder = tmp_path_factory.mktemp("explained")
    ppmcal("init", "3-RPR", cwd=folder, expect=0)
    scenario = yaml.safe_load((folder / "3-RPR.scenario.yaml").read_text())
    for seed, label in enumerate("AB"):
        scenario |= {"errors": {"leg1.offset": 0.3, "leg2.offset": -0.1 + 0.5 * seed},
                     "seed": seed}
        (folder / f"{label}.yaml").write_text(yaml.safe_dump(scenario))
        ppmcal("simulate", "3-RPR.yaml", f"{label}.yaml", "--out", label, "--quiet", cwd=folder,
               expect=0)
        ppmcal("identify", "3-RPR.yaml", f"{label}/measurements.csv", "--out", f"id{label}",
               "--quiet", cwd=folder, expect=0)
    return folder


@pytest.mark.slow
def test_headline_and_table_agree(folders: Path, tmp_path: Path) -> None:
    """What is named has its size in the table, and where the fits differ otherwise it is said."""
    run = ppmcal("compare", "idA", "idB", "--out", tmp_path / "o", cwd=folders, expect=1)
    found = json.loads((tmp_path / "o" / "comparison.json").read_text())
    (change,) = found["changes"]
    row = next(p for p in found["parameters"] if p["name"] == change["name"])
    assert row["explained"] == pytest.approx(change["value"]) and row["status"] == "changed"
    assert change["value"] == pytest.approx(0.5, abs=4.0 * change["sigma"])
    apart = abs(row["difference"] - row["explained"]) > 0.5 * abs(row["explained"])
    assert apart and "Each fit by itself" in run.out
    assert max(len(line) for line in run.out.splitlines()) <= 80


@pytest.mark.slow
def test_files_without_the_session_still_compare(folders: Path, tmp_path: Path) -> None:
    """As older versions wrote them: parameters alone; nothing of homing or instruments."""
    for label in "AB":
        target = tmp_path / f"id{label}"
        target.mkdir()
        for name in ("identified.yaml", "identification.json"):
            (target / name).write_text((folders / f"id{label}" / name).read_text())
        tree = json.loads((target / "identification.json").read_text())
        assert tree["covariance"].pop("session")["names"]
        (target / "identification.json").write_text(json.dumps(tree))
    run = ppmcal("compare", tmp_path / "idA", tmp_path / "idB", "--json", "--out", tmp_path / "o",
                 cwd=folders, expect=1)
    (change,) = run.json["changes"]
    assert "leg2.offset" in (change["name"], *change["instead"])
    names = {n for c in run.json["changes"] for n in (c["name"], *c["instead"])}
    assert not any(n.startswith(("homing of", "instrument")) for n in names)
