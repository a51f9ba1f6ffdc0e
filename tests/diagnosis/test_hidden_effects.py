"""The generator of campaigns with hidden effects, before anything is concluded from it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import hidden
import hidden_scene
import hidden_session
import hidden_unknown
import numpy as np
import pytest
from scipy.stats import chi2

from ppmcal.calibration.fit.fit_result import FitOptions as FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem, State
from ppmcal.kinematics.closure import Model

SMALL = hidden.Options(poses=30)
USUAL = hidden.Options()


@cache
def sized(machine: str, kind: str) -> hidden.Cause | None:
    """Return a cause of eta = 1, or None where the machine's geometry swallows it."""
    try:
        cause = hidden.draw(machine, 3, kind, USUAL, "all")
        return hidden.scaled(machine, 3, cause, 1.0, USUAL)
    except hidden.Impossible:
        return None


def equal(a: hidden.Hidden, b: hidden.Hidden) -> bool:
    one, two = a.dataset, b.dataset
    return (a.truth == b.truth and all(
        np.array_equal(getattr(one, n), getattr(two, n), equal_nan=True)
        for n in ("q", "position", "rotation", "sigma_position", "sigma_actuator", "groups"))
        and all(np.array_equal(one.columns[c], two.columns[c]) for c in one.columns))


@pytest.mark.parametrize("machine", ["3-RPR", "6-UPS"])
def test_the_seed_decides_everything(machine: str) -> None:
    first = hidden.hide(machine, 5, ["backlash", "random_walk"], 0.5, SMALL)
    hidden._scene.cache_clear()
    hidden._sizing.cache_clear()
    assert equal(first, hidden.hide(machine, 5, ["backlash", "random_walk"], 0.5, SMALL))
    assert not equal(first, hidden.hide(machine, 6, ["backlash", "random_walk"], 0.5, SMALL))


def test_effects_change_neither_noise_nor_conditions() -> None:
    nothing = hidden.campaign("3-RRR-1", 4, (), SMALL)
    something = hidden.campaign("3-RRR-1", 4, [replace(
        hidden.draw("3-RRR-1", 4, "backlash", SMALL), parameters={"width": 0.0})], SMALL)
    assert np.allclose(nothing.dataset.position[:, :2], something.dataset.position[:, :2],
                       rtol=0.0, atol=1e-12)
    assert np.array_equal(nothing.scene.approach, something.scene.approach)


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["3-RPR", "delta-linear", "6-RUS"])
def test_every_pose_is_approached_from_both_sides(machine: str) -> None:
    scene = hidden.campaign(machine, 1, (), hidden.Options(poses=12, repeats=2)).scene
    assert len(scene.q) == 48
    for group in range(12):
        rows = scene.groups == group
        assert rows.sum() == 4
        assert np.all(scene.approach[rows].sum(axis=0) == 0.0)
        assert np.all(scene.q[rows] == scene.q[rows][0])
    assert np.all(np.sign(scene.velocity) == scene.approach)
    assert np.abs(scene.temperature).max() <= 4.0 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("options", [
    USUAL, hidden.Options(row_sigmas=True), hidden.Options(tails="t4"),
    hidden.Options(actuator=(4e-6, 2e-5))], ids=["plain", "row sigmas", "t4", "drives"])
@pytest.mark.parametrize("machine", ["3-RPR", "6-UPS"])
def test_without_effects_the_residuals_are_the_stated_noise(machine: str, options: hidden.Options
                                                            ) -> None:
    total, dof = 0.0, 0
    for seed in (1, 2):
        found = hidden.campaign(machine, seed, (), options)
        problem = Problem(found.mechanism, (found.dataset,), found.mechanism.free)
        fit = identify(problem, FitOptions(method="flat", robust=False))
        sizing = hidden._sizing(machine, seed, options, ())
        total += sum(float(np.sum(r.residual**2)) for r in problem.rows(fit.state, False))
        dof += sizing.basis.shape[0] - sizing.basis.shape[1]
    if options.tails == "t4":
        # the square of a t4 variable has no variance
        assert 0.7 < total / dof < 1.6
    else:
        assert 1e-4 < chi2.sf(total, dof) < 1.0 - 1e-4, total / dof


@pytest.mark.slow
@pytest.mark.parametrize("kind", tuple(hidden.KINDS))
@pytest.mark.parametrize("machine", ["3-RRR-1", "6-UPS"])
def test_a_scaled_effect_has_the_size_it_was_given(machine: str, kind: str) -> None:
    if kind not in hidden.applicable(machine):
        pytest.skip("makes no sense on this machine")
    cause = sized(machine, kind)
    if cause is None:
        pytest.skip("swallowed by this machine's geometry")
    for eta in (0.3, 2.0):
        try:
            again = hidden.scaled(machine, 3, cause, eta, USUAL)
        except hidden.Unphysical:
            continue
        found = hidden.campaign(machine, 3, [again], USUAL)
        assert found.truth[0].eta == pytest.approx(eta, rel=0.05)
    none = hidden.scaled(machine, 3, cause, 0.0, USUAL)
    assert hidden.campaign(machine, 3, [none], USUAL).truth[0].eta == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("kind", tuple(hidden.KINDS))
def test_every_kind_shows_on_some_machine(kind: str) -> None:
    assert any(sized(m, kind) for m in ("3-RPR", "3-RRR-1", "delta-rotary")
               if kind in hidden.applicable(m))


@pytest.mark.parametrize("kind", ["backlash", "leg_thermal", "drift", "kink"])
def test_eta_is_the_excess_of_the_residuals_of_a_fit(kind: str) -> None:
    cause = sized("3-RPR", kind)
    assert cause is not None
    big = hidden.scaled("3-RPR", 3, cause, 3.0, USUAL)
    found = hidden.campaign("3-RPR", 3, [big], USUAL)
    problem = Problem(found.mechanism, (found.dataset,), found.mechanism.free)
    fit = identify(problem, FitOptions(method="flat", robust=False))
    residual = np.concatenate([r.residual.ravel() for r in problem.rows(fit.state, False)])
    dof = residual.size - hidden._sizing("3-RPR", 3, USUAL, ()).basis.shape[1]
    expected = 9.0 + dof / residual.size
    assert np.mean(residual**2) == pytest.approx(expected, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("machine", ["3-RPR", "delta-rotary", "6-UPS"])
def test_the_load_is_what_the_joint_jacobian_says(machine: str) -> None:
    scene = hidden.campaign(machine, 2, (), SMALL).scene
    closure = Model(scene.mechanism, scene.g).closure(scene.q)
    by_joint = -np.linalg.solve(closure.pose_matrix(scene.pose), closure.joint_matrix(scene.pose))
    expected = np.einsum("nck,nc->nk", by_joint, scene.wrench[:, scene.mechanism.dof])
    assert np.allclose(scene.load, expected, rtol=1e-5, atol=1e-5 * np.abs(expected).max())
    if machine == "6-UPS":
        # a weight on six struts: it shortens them, and their vertical parts carry it
        assert np.all(scene.load[scene.payload > 0.0].sum(axis=1) < 0.0)


def test_a_leg_that_grows_by_heat_is_as_long_as_it_says() -> None:
    scene = hidden.campaign("6-UPS", 2, (), SMALL).scene
    cause = hidden.Cause("leg_thermal", (), {"expansion": 1e-5})
    longer = hidden.KINDS["leg_thermal"].change(scene, cause).slots[0, "offset"]
    strut = scene.q[:, 0] + scene.g[scene.mechanism.names.index("leg1.offset")]
    assert np.allclose(longer, 1e-5 * scene.temperature * strut, rtol=1e-12)


@pytest.mark.slow
def test_a_frozen_slot_is_not_free_and_off_its_nominal() -> None:
    found = hidden.hide("3-RRR-1", 3, ["geometry"], 1.0)
    (truth,) = found.truth
    assert len(truth.parameters) == 1
    (name, error), = truth.parameters.items()
    index = found.mechanism.names.index(name)
    assert index not in found.mechanism.free
    assert error != 0.0
    assert found.scene.g[index] == found.mechanism.nominals[index]
    again = found.mechanism.with_free(found.mechanism.free_patterns)
    assert again.free == found.mechanism.free


def test_two_effects_and_options() -> None:
    options = hidden.Options(poses=20, repeats=2, ar=0.6, outliers=0.05, row_sigmas=True,
                             columns=("dir", "time"), payloads=(0.0, 50.0))
    found = hidden.hide("linapod", 9, ["backlash", "base_compliance"], [0.5, 1.0], options)
    assert [t.eta for t in found.truth] == pytest.approx([0.5, 1.0], rel=0.05)
    assert set(found.dataset.columns) == {"time", *(f"dir_leg{i}" for i in range(1, 7))}
    assert len(found.dataset) == 80
    assert len(found.outliers) == 4
    ratio = found.dataset.sigma_position[:, 0] / options.sigma[0]
    assert 0.5 <= ratio.min() < 0.8 < 1.25 < ratio.max() <= 2.0
    assert set(found.scene.payload) == {0.0, 50.0}


def test_noise_has_its_ar_coefficient_and_outliers_their_size() -> None:
    options = hidden.Options(poses=400, ar=0.6, outliers=0.05)
    found = hidden.campaign("3-RPR", 1, (), options)
    clean = hidden_scene.measure(found.scene)
    white = (found.dataset.position - clean[:, :3])[:, :2] / options.sigma[0]
    white = np.column_stack([white, (found.dataset.rotation - clean[:, 3:])[:, 2]
                             / options.sigma[1]])
    sizes = np.linalg.norm(white, axis=1)
    assert np.all(sizes[found.outliers] > 14.0)
    good = np.delete(sizes, found.outliers)
    assert good.max() < 8.0
    usable = np.setdiff1d(np.arange(799), [*found.outliers, *(found.outliers - 1)])
    slope = np.sum(white[usable + 1] * white[usable]) / np.sum(white[usable] ** 2)
    assert slope == pytest.approx(0.6, abs=0.07)
    assert np.mean(np.delete(white, found.outliers, axis=0) ** 2) == pytest.approx(1.0, abs=0.2)


def test_play_is_between_none_and_all_and_remembers() -> None:
    scene = hidden.campaign("3-PRR-1", 2, (), USUAL).scene
    state = hidden_unknown.taken_up(scene, 5)
    assert np.abs(state).max() <= 1.0
    assert 0.5 < np.mean(np.sign(state) == scene.approach) < 1.0
    # the same approach leaves different states behind
    assert np.std(state[scene.approach[:, 0] > 0.0, 0]) > 0.1


@pytest.mark.slow
def test_what_imitates_a_kink_is_the_curvature() -> None:
    cause = sized("3-RPR", "kink")
    assert cause is not None
    name, left = hidden.imitation("3-RPR", 3, replace(cause, on=("leg1",)), USUAL)
    assert name == "curvature"
    assert left < 0.5


def test_options_and_machines_are_checked() -> None:
    with pytest.raises(ValueError, match="tails"):
        hidden.Options(tails="cauchy")
    with pytest.raises(ValueError, match="humidity"):
        hidden.Options(columns=("humidity",))
    with pytest.raises(hidden.Absorbed):
        # a crank machine of another size turns by the same angles
        hidden.scaled("3-RRR-1", 1, hidden.draw("3-RRR-1", 1, "sensor_scale"), 1.0)
    assert hidden_session.machines()["6-UPS"]().name == "6-UPS"


def test_the_true_state_leaves_only_noise() -> None:
    found = hidden.campaign("delta-rotary", 8, (), USUAL)
    problem = Problem(found.mechanism, (found.dataset,), found.mechanism.free)
    state = State(found.scene.g, (found.scene.registration,), (found.scene.pose,))
    residual = np.concatenate([r.residual.ravel() for r in problem.rows(state, False)])
    assert np.std(residual) == pytest.approx(1.0, abs=0.15)
