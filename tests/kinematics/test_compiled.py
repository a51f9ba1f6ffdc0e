"""The compiled path against NumPy's: every kind, every slot, and what has no compiled form."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers import constrained, machines
from helpers.machines import KINDS, Array
from helpers.paths import ROOT

from ppmcal.kinematics import compilation, compiled_limbs
from ppmcal.kinematics.closure import Closure, Model
from ppmcal.kinematics.compiled_closure import by_equation
from ppmcal.kinematics.forward import forward, newton
from ppmcal.model.effects import Shift
from ppmcal.model.limbs import kinds
from ppmcal.model.limbs.chain import Chain, ChainStep, U, slide
from ppmcal.model.limbs.driven import cut_at_drive
from ppmcal.model.mechanism import Mechanism, joint_points
from ppmcal.wording.progress import Watch, watching

# on a new machine each of these compiles for seconds
pytestmark = pytest.mark.slow
COUNT = 37
"""Rows: no multiple of those that are made together."""


def on_pulleys(motion: str) -> Mechanism:
    """Return a machine on as many ropes over pulleys as it has freedoms, some that swivel."""
    tree = yaml.safe_load((ROOT / "configs" / ("cable-4-pulleys.yaml" if motion == "planar" else
                                               "cable-8-pulleys.yaml")).read_text(encoding="utf-8"))
    tree["limbs"] = tree["limbs"][:3] if motion == "planar" else [
        tree["limbs"][i] for i in (0, 1, 4, 5, 6, 7)]
    tree.pop("limits", None)
    for number, limb in enumerate(tree["limbs"]):
        limb["name"] = f"l{number}"
    return machines.read_text(yaml.safe_dump(tree))


MACHINES: dict[str, Callable[[], Mechanism]] = {
    **{f"{kind} plain": lambda kind=kind: machines.plain(kind) for kind in KINDS},
    **{f"{kind} full": lambda kind=kind: machines.full(kind) for kind in KINDS},
    "mixed planar": lambda: machines.mixed("planar"),
    "mixed spatial": lambda: machines.mixed("spatial"),
    "delta, linear": lambda: machines.delta("(P)US", 3),
    "delta, rotary": lambda: machines.delta("(R)US", 3),
    "pulleys in the plane": lambda: on_pulleys("planar"),
    "pulleys in space": lambda: on_pulleys("spatial"),
    **{f"{kind} frames": lambda kind=kind: constrained.with_joint_frames(kind)
       for kind in constrained.MACHINES},
}
every_machine = pytest.mark.parametrize("name", MACHINES)


@contextmanager
def rows_from(count: int) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled_limbs, "MANY", count)
        yield


def compiled(closure: Closure, rows: int = COUNT) -> compiled_limbs.CompiledLimbs | None:
    with rows_from(1):
        return compiled_limbs.compiled_limbs(closure, rows)


@cache
def rows_of(name: str) -> tuple[Mechanism, Array, Array]:
    """Return a machine with all its parameters off nominal, joint values and poses."""
    mechanism = MACHINES[name]()
    rng = np.random.default_rng(2)
    # axes that do not meet have no compiled form
    off = np.array([0.0 if p.per_unit or p.name.endswith("axis_offset") else
                    {"length": 1e-4 * mechanism.reach, "angle": 1e-3}[p.quantity]
                    for p in mechanism.parameters])
    mechanism = mechanism.with_values(mechanism.values + off * rng.uniform(-1.0, 1.0, off.size))
    # six ropes about a platform far smaller than they are long: it soon meets a singularity
    q, pose = machines.spread(Model(mechanism), COUNT, seed=3,
                              size=0.3 if name == "pulleys in space" else 1.0)
    return mechanism, q, pose


def numpy_columns(closure: Closure, pose: Array, by_pose: Array, asked: Sequence[int]) -> Array:
    """Return -by_pose A^-1 (Bg, Jq) from the matrices themselves."""
    a = closure.pose_matrix(pose)
    both = np.concatenate([closure.error_matrix(pose, asked), closure.joint_matrix(pose)],
                          axis=-1)
    return -by_pose[..., closure.model.mechanism.dof] @ np.linalg.solve(a, both)


@every_machine
def test_columns_are_those_of_the_matrices(name: str) -> None:
    mechanism, q, pose = rows_of(name)
    # wanted, an offset makes the joint's turn depend on the pose
    asked = [i for i, n in enumerate(mechanism.names) if not n.endswith("axis_offset")]
    count = len(asked)
    closure = Model(mechanism).closure(q, asked)
    by_pose = np.random.default_rng(1).normal(size=(COUNT, 4, 6))
    tables = compiled(closure)
    assert tables is not None, "every kind of the package has a compiled form"
    out = np.zeros((COUNT, 4, count + len(mechanism.actuators)))
    assert tables.error_columns(pose, by_pose, {p: i for i, p in enumerate(asked)}, out, count)
    wanted = numpy_columns(closure, pose, by_pose, asked)
    size = np.abs(wanted).max(axis=(0, 1), initial=1e-300)
    apart = np.abs(out - wanted).max(axis=(0, 1))
    # columns that are round-off themselves are round-off of the largest ones
    condition = np.linalg.cond(closure.pose_matrix(pose)).max()
    assert (apart <= 1e-13 * np.maximum(size, 1e-2 * size.max()) * max(1.0, condition / 30.0)).all()


@every_machine
def test_newton_takes_the_same_way(name: str) -> None:
    mechanism, q, _ = rows_of(name)
    closure = Model(mechanism).closure(q)
    start = np.tile(mechanism.home, (COUNT, 1))
    with rows_from(10 * COUNT):
        plain = newton(closure, start)
    with rows_from(1):
        fast = newton(closure, start)
    np.testing.assert_array_equal(fast[1], plain[1])
    assert fast[1].any()
    np.testing.assert_allclose(fast[0][fast[1]], plain[0][plain[1]], rtol=0.0,
                               atol=1e-13 * max(mechanism.reach, 1.0))
    np.testing.assert_allclose(fast[2][fast[1]], plain[2][plain[1]], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", ["(R)RR full", "U(P)S full", "R(P)S plain", "mixed planar"])
def test_far_poses_are_led_to_the_same_place(name: str) -> None:
    """Joints far from home, some out of reach: the same rows converge, at the same poses."""
    mechanism, _, _ = rows_of(name)
    model = Model(mechanism)
    home = forward(model, machines.spread(model, 1)[0])
    assert home.converged.all()
    away = np.random.default_rng(4).uniform(-8.0, 8.0, (COUNT, len(mechanism.actuators)))
    q = machines.spread(model, 1, size=0.0)[0] + machines.joint_steps(model) * away
    q[3] = np.nan
    with rows_from(10 * COUNT):
        plain = forward(model, q)
    with rows_from(1):
        fast = forward(model, q)
    np.testing.assert_array_equal(fast.converged, plain.converged)
    assert fast.converged.any()
    np.testing.assert_allclose(fast.pose, plain.pose, rtol=0.0,
                               atol=1e-11 * max(mechanism.reach, 1.0))


def test_a_singular_pose_gives_nan() -> None:
    mechanism = machines.plain("(P)RR")
    closure = Model(mechanism).closure(np.zeros((1, 3)), [0])
    tables = compiled(closure, 1)
    assert tables is not None
    flat = tables.limbs._replace(axis=tables.limbs.axis, ends=np.zeros_like(tables.limbs.ends))
    out = np.zeros((1, 6, 1))
    replace(tables, limbs=flat).error_columns(mechanism.home[None], np.eye(6)[None], {0: 0}, out)
    assert np.isnan(out).any()


def test_a_shift_of_joints_is_compiled_and_one_of_struts_is_not() -> None:
    mechanism, q, pose = rows_of("(P)US plain")
    step = np.linspace(0.0, 1e-4, COUNT)
    joint = Model(mechanism, shift=Shift({(1, "offset"): step})).closure(q, [0, 1])
    tables = compiled(joint)
    assert tables is not None
    place = {p: i for i, p in enumerate(mechanism.free)}
    asked = Model(mechanism, shift=Shift({(1, "offset"): step})).closure(q, mechanism.free)
    out = np.zeros((COUNT, 6, len(place)))
    again = compiled(asked)
    assert again is not None
    assert again.error_columns(pose, np.eye(6)[None], place, out)
    wanted = -np.linalg.solve(asked.pose_matrix(pose), asked.error_matrix(pose, mechanism.free))
    np.testing.assert_allclose(out, wanted, rtol=0.0, atol=1e-13 * np.abs(wanted).max())
    strut = Model(mechanism, shift=Shift({(1, "length"): step})).closure(q, [0, 1])
    assert compiled(strut) is None


def test_a_surface_without_forms_goes_through_numpy() -> None:
    """A plug-in's own surface: no compiled form for the machine, and the same poses."""
    mechanism, q, pose = rows_of("(P)RR full")
    kind = mechanism.limbs[0].kind
    own = replace(kind, surface=replace(kind.surface, forms=()))
    plugged = replace(mechanism, limbs=tuple(replace(limb, kind=own) for limb in mechanism.limbs))
    assert compiled(Model(plugged).closure(q)) is None
    with rows_from(1):
        found = forward(Model(plugged), q)
    assert found.converged.all()
    np.testing.assert_allclose(found.pose, pose, rtol=0.0, atol=1e-13 * mechanism.reach)


def test_a_step_that_does_not_declare_its_drive_has_no_form() -> None:
    known = slide(U, "x")
    own = ChainStep((), known.motor, known.twists)
    by_get = ChainStep((), lambda v: known.motor({U: v.get(U, 0.0)}), known.twists)
    values = {U: np.linspace(0.0, 1.0, COUNT)[:, None], "bar": np.array([[0.3]])}
    bar = slide("bar", "x")
    assert cut_at_drive(Chain((known, bar)), values, {U, "bar"}, 1) is not None
    assert cut_at_drive(Chain((own, bar)), values, {"bar"}, 1) is None
    assert cut_at_drive(Chain((by_get, bar)), values, {"bar"}, 1) is None
    assert cut_at_drive(Chain((known, known)), values, {"bar"}, 1) is None
    differs = values | {"bar": values[U]}
    assert cut_at_drive(Chain((known, bar)), differs, {"bar"}, 1) is None


def test_offset_joints_that_turn_go_through_numpy() -> None:
    mechanism = machines.offset_joints("U(P)S", "base")
    q, _ = machines.spread(Model(mechanism), COUNT)
    assert compiled(Model(mechanism).closure(q)) is None


def test_every_kind_declares_its_form() -> None:
    assert not [name for name, kind in kinds().items() if not kind.surface.forms]


def test_a_pulley_that_loops_do_not_know_goes_through_numpy() -> None:
    """A plug-in's own: its surface says nothing, or its rope leaves over no pulley that is told."""
    mechanism, q, _ = rows_of("pulleys in space")
    assert compiled(Model(mechanism).closure(q)) is not None
    kind = mechanism.limbs[0].kind
    for own in (replace(kind, surface=replace(kind.surface, forms=())),
                replace(kind, pulley=None)):
        plugged = replace(mechanism, limbs=tuple(replace(limb, kind=own)
                                                 for limb in mechanism.limbs))
        assert compiled(Model(plugged).closure(q)) is None


def test_a_pulley_that_is_another_in_each_row_goes_through_numpy() -> None:
    mechanism, q, _ = rows_of("pulleys in space")
    step = np.linspace(0.0, 1e-4, COUNT)
    shift = Shift({(1, "base.pulley.radius"): step})
    assert compiled(Model(mechanism, shift=shift).closure(q)) is None
    paid_out = Shift({(1, "offset"): step})
    assert compiled(Model(mechanism, shift=paid_out).closure(q)) is not None


def test_a_rope_that_ends_inside_its_pulley_has_no_pose() -> None:
    mechanism, q, _ = rows_of("pulleys in space")
    centres = [mechanism.names.index(f"l0.base.pulley.center.{a}") for a in "xyz"]
    g = mechanism.values.copy()
    g[centres] = joint_points(mechanism)[1][0]
    model = Model(mechanism, g)
    start = np.tile(mechanism.home, (COUNT, 1))
    with rows_from(1):
        assert not newton(model.closure(q), start)[1].any()
    with rows_from(10 * COUNT):
        assert not newton(model.closure(q), start)[1].any()


@pytest.mark.parametrize("broken", [0.0, np.nan])
def test_nothing_is_solved_with_what_has_no_inverse(broken: float) -> None:
    """The order of the rows is not complete then: what stood there before is no row of them."""
    A, order = np.eye(3), np.full(3, 10**12)
    A[1, 1] = broken
    G = np.empty((3, 2))
    by_equation(A, order, np.ones((2, 3)), np.arange(3), G)
    assert np.isnan(G).all()


def test_what_is_kept_goes_by_what_is_in_the_files(tmp_path: Path) -> None:
    """A sign that was mended has the size of the one that was not, and maybe the same time."""
    source = tmp_path / "loops.py"
    found = []
    for text in ("x = +1\n", "x = -1\n"):
        source.write_text(text)
        compilation._folder.cache_clear()
        found.append(compilation._folder(str(source)))
    assert all(found)
    assert found[0] != found[1]


@pytest.fixture
def kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    compilation._folder.cache_clear()
    yield tmp_path / "cache"
    compilation._folder.cache_clear()


def test_nothing_is_kept_in_the_package(kept: Path) -> None:
    """What an installer did not write stays when it takes the package away."""
    folder = Path(compilation._folder(compiled_limbs.__file__))
    assert folder.parent == kept / "ppmcal"
    assert Path(compilation.__file__).parents[1] not in folder.parents


def test_compiling_is_said_once_and_then_kept(kept: Path) -> None:
    def doubled(x: float) -> float:
        return 2.0 * x

    heard: list[str] = []
    with watching(Watch(heard.append)):
        assert compilation.compiled(doubled)(2.0) == 4.0
        again = compilation.compiled(doubled)
        assert again(2.0) == 4.0
    assert [h for h in heard if compilation.COMPILING in h] == heard[:1] != []


def test_a_user_without_a_home_compiles_without_keeping(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(compilation.os.path, "expanduser", lambda path: path)
    compilation._folder.cache_clear()
    try:
        assert compilation._folder(compiled_limbs.__file__) == ""
    finally:
        compilation._folder.cache_clear()


def test_few_rows_and_help_do_not_import_the_compiler() -> None:
    code = ("import sys, numpy as np, ppmcal\n"
            "from ppmcal.kinematics.closure import Model\n"
            "from ppmcal.kinematics.forward import forward\n"
            "from ppmcal.kinematics.inverse import home_state\n"
            "import ppmcal.calibration.fit.fitting\n"
            "machine = ppmcal.load(ppmcal.shipped('6-UPS'))\n"
            "forward(Model(machine), np.tile(home_state(machine).q, (20, 1)))\n"
            "assert 'numba' not in sys.modules\n")
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("name", ["mixed planar", "U(P)S full", "(R)RR full"])
def test_no_rows_have_no_equations(name: str) -> None:
    """Where nothing is known of the load there are no rows, and groups of limbs still agree."""
    mechanism, q, pose = rows_of(name)
    closure = Model(mechanism).closure(q[:0])
    assert closure.lines(pose[:0]).shape == (0, mechanism.equations, 6)
    assert closure.misclosure(pose[:0]).shape == (0, mechanism.equations)
