"""The published cases of [IK] and [LIN], computed again from the papers' own formulas."""

from __future__ import annotations

import csv
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from helpers import machines
from helpers.commands import ppmcal
from helpers.machines import Array
from helpers.paths import ROOT
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from ppmcal.calibration.interpretation.data_check import check
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import home_state, inverse
from ppmcal.kinematics.partial_pose import inverse_partial
from ppmcal.kinematics.path_rates import rates
from ppmcal.kinematics.tables import pose_vector, velocity_table
from ppmcal.model.mechanism import Mechanism

# --- [IK] section 3.1 and 3.2: 3-RPS ------------------------------------------------

L_A, L_B, H = 0.085, 0.051, 0.017
THIRDS = 2.0 * np.pi / 3.0 * np.arange(3)


@cache
def tripod() -> Model:
    """Hinges tangential to the circle of radius l_a; written to full precision, in m."""
    limbs = [{"name": f"leg{i + 1}", "kind": "R(P)S",
              "base": {"point": [L_A * float(np.cos(t)), L_A * float(np.sin(t)), 0.0],
                       "axis": [-float(np.sin(t)), float(np.cos(t)), 0.0]},
              "platform": {"point": [L_B * float(np.cos(t)), L_B * float(np.sin(t)), 0.0]}}
             for i, t in enumerate(THIRDS)]
    home = {"x": 0.0, "y": 0.0, "z": 0.1, "rx": 0.0, "ry": 0.0, "rz": 0.0}
    return Model(machines.read_text(machines.mechanism_text(
        limbs, "spatial", home, units={"length": "m", "angle": "rad"})))


def tilted(alpha: Array, beta: Array, gamma: Array) -> Array:
    """Return R = Rz(gamma) Ry(beta) Rx(alpha) (N, 3, 3), [IK] eq. 21."""
    return Rotation.from_euler("ZYX", np.stack([gamma, beta, alpha], axis=-1)).as_matrix()


def parasitic(alpha: Array, beta: Array) -> tuple[Array, Array, Array]:
    """Return gamma, x_p, y_p, [IK] eq. 27."""
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    gamma = np.arctan(sa * sb / (ca + cb))
    cg, sg = np.cos(gamma), np.sin(gamma)
    return gamma, L_B * (cb * cg - ca * cg - sa * sb * sg) / 2.0, -L_B * sg * cb


def motor_at(alpha: Array, beta: Array, z: Array) -> Array:
    gamma, x, y = parasitic(alpha, beta)
    return machines.motors(tilted(alpha, beta, gamma), np.stack([x, y, z], axis=-1))


def closed_form_legs(alpha: Array, beta: Array, z: Array) -> Array:
    """Return q (N, 3), [IK] eq. 29-31, for joints u, v, w = (l_b cos t, l_b sin t, 0).

    With D = 1 + ca cb, eq. 27 gives cos(gamma) = (ca + cb)/D and sin(gamma) = sa sb/D, since
    (ca + cb)^2 + (sa sb)^2 = D^2; put into eq. 25 they leave the printed expressions. The
    three equations are one, with three sets of joint coordinates.
    """
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    legs = []
    for t in THIRDS:
        xa, ya, za = L_A * np.cos(t), L_A * np.sin(t), 0.0
        u, v, w = L_B * np.cos(t), L_B * np.sin(t), 0.0
        x = ((-L_B * ca**2 + 2 * L_B + 2 * u) * cb**2
             + (2 * (w * sb + u) * ca + 2 * sa * v * sb) * cb + 2 * w * sb - L_B) / (
                 2 * (ca * cb + 1))
        y = ((-sa * w * ca + ca**2 * v - v) * cb**2
             + (v * ca - ((L_B - u) * sb + w) * sa) * cb + v) / (ca * cb + 1)
        legs.append(np.sqrt((xa - x)**2 + (ya - y)**2
                            + (za - (v * cb * sa + w * cb * ca - u * sb + z))**2))
    return np.stack(legs, axis=-1)


def point_h(alpha: Array, beta: Array, z: Array) -> Array:
    """Return H's coordinates (N, 3), [IK] eq. 36."""
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    return np.stack([-L_B * (1 + ca**2 * cb**2 - 2 * cb**2) / (2 * ca * cb + 2) + H * sb,
                     -L_B * sa * sb * cb / (cb * ca + 1) - H * sa * cb,
                     z + H * ca * cb], axis=-1)


def helix(theta: Array, diameter: float, lead: float, height: float) -> Array:
    return np.stack([diameter / 2 * np.cos(theta), diameter / 2 * np.sin(theta),
                     height + lead * theta / (2 * np.pi)], axis=-1)


def on_helix(theta: Array) -> tuple[Array, Array, Array]:
    """Return alpha, beta, z_p that put H on the helix of diameter 10 mm and lead 2 mm."""
    out = []
    for target in helix(theta, 0.010, 0.002, 0.115):
        start = [-target[1] / H, target[0] / H, target[2] - H] if not out else out[-1]
        found, _, state, message = fsolve(
            lambda p, goal=target: (point_h(*np.array(p)[:, None])[0] - goal) / H, start,
            xtol=1e-14, full_output=True)
        assert np.abs(point_h(*found[:, None])[0] - target).max() < 1e-15, (state, message)
        out.append(found)
    return tuple(np.array(out).T)


def tilts() -> tuple[Array, Array, Array]:
    rng = np.random.default_rng(3)
    return rng.uniform(-0.5, 0.5, 30), rng.uniform(-0.5, 0.5, 30), rng.uniform(0.08, 0.12, 30)


def test_the_parasitic_motion_closes_the_tripod() -> None:
    """[IK] eq. 27: what the program leaves open it finds where the formulas have it."""
    alpha, beta, z = tilts()
    model, pose = tripod(), motor_at(alpha, beta, z)
    found = inverse(model, pose)
    assert found.reached.all()
    assert np.abs(model.closure(found.q).lengths(pose)).max() < 1e-15
    wanted = pose_vector(pose)
    wanted[:, [0, 1, 5]] = np.nan  # x, y and the turn about z are the parasitic motion
    solved = inverse_partial(model, wanted)
    assert solved.reached.all()
    assert np.abs(machines.difference(solved.pose, pose)).max() < 1e-13
    gamma, beta_found, alpha_found = Rotation.from_matrix(
        machines.matrices(solved.pose)[0]).as_euler("ZYX").T
    np.testing.assert_allclose(np.tan(gamma) * (np.cos(alpha_found) + np.cos(beta_found)),
                               np.sin(alpha_found) * np.sin(beta_found), rtol=0, atol=1e-13)
    assert np.abs(gamma).max() > 0.05


def test_the_closed_form_legs_are_the_inverse_kinematics() -> None:
    """[IK] eq. 29-31 at tilts up to 0.5 rad."""
    alpha, beta, z = tilts()
    np.testing.assert_allclose(inverse(tripod(), motor_at(alpha, beta, z)).q,
                               closed_form_legs(alpha, beta, z), rtol=0, atol=1e-15)


def test_point_h_of_the_tripod_runs_along_the_helix() -> None:
    """[IK] section 3.2: legs from eq. 29-31, poses from forward kinematics, H on its helix."""
    theta = np.linspace(0.0, 4.0 * np.pi, 61)
    alpha, beta, z = on_helix(theta)
    q = closed_form_legs(alpha, beta, z)
    found = forward(tripod(), q)
    assert found.converged.all()
    rotation, origin = machines.matrices(found.pose)
    h = origin + rotation @ np.array([0.0, 0.0, H])
    np.testing.assert_allclose(h, helix(theta, 0.010, 0.002, 0.115), rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.hypot(h[:, 0], h[:, 1]), 0.005, rtol=0, atol=1e-14)
    np.testing.assert_allclose(h, point_h(alpha, beta, z), rtol=0, atol=1e-14)
    np.testing.assert_allclose(inverse(tripod(), found.pose).q, q, rtol=0, atol=1e-14)


def test_joint_rates_of_the_tripod_on_the_helix() -> None:
    """[IK] eq. 32-35 (G is lost in print): J = Jq^-1 G against the closed form's slope."""
    theta = np.linspace(0.0, 2.0 * np.pi, 13)
    h = 1e-4
    after, now, before = (on_helix(theta + s) for s in (h, 0.0, -h))
    expected = (closed_form_legs(*after) - closed_form_legs(*before)) / (2.0 * h)
    twist = machines.difference(motor_at(*after), motor_at(*before)) / (2.0 * h)
    pose = pose_vector(motor_at(*now))
    table = velocity_table(tripod(), pose, twist)
    assert table.status == ("ok",) * 13
    np.testing.assert_allclose(table.rate, expected, rtol=0, atol=1e-10)
    assert np.abs(expected).max() > 1e-2
    # three velocities are enough: the parasitic ones follow
    twist[:, [0, 1, 5]] = np.nan
    np.testing.assert_allclose(velocity_table(tripod(), pose, twist).rate, expected,
                               rtol=0, atol=1e-10)


# --- [IK] section 3.3 and 3.4: 6-UPS ------------------------------------------------

BASE_ANGLES = np.radians([10.0, 110.0, 130.0, 230.0, 250.0, 350.0])
PLATFORM_ANGLES = np.radians([50.0, 70.0, 170.0, 190.0, 290.0, 310.0])


def hexagon(radius: float, angles: Array) -> Array:
    return radius * np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], axis=-1)


@cache
def stewart() -> Model:
    """l_a = 2345, l_b = 1000 mm; the joints' angles are not printed: semi-regular hexagons."""
    limbs = [{"name": f"leg{i + 1}", "kind": "U(P)S", "base": {"point": a.tolist()},
              "platform": {"point": b.tolist()}} for i, (a, b) in enumerate(zip(
                  hexagon(2.345, BASE_ANGLES), hexagon(1.0, PLATFORM_ANGLES), strict=True))]
    home = {"x": 0.0, "y": 0.0, "z": 2.0, "rx": 0.0, "ry": 0.0, "rz": 0.0}
    return Model(machines.read_text(machines.mechanism_text(
        limbs, "spatial", home, units={"length": "m", "angle": "rad"})))


def stewart_legs(alpha: Array, beta: Array, gamma: Array, p: Array) -> Array:
    """Return q (N, 6), [IK] eq. 43-48."""
    ca, sa, cb, sb = np.cos(alpha), np.sin(alpha), np.cos(beta), np.sin(beta)
    cg, sg = np.cos(gamma), np.sin(gamma)
    legs = []
    for (xa, ya, za), (u, v, w) in zip(hexagon(2.345, BASE_ANGLES),
                                       hexagon(1.0, PLATFORM_ANGLES), strict=True):
        legs.append(np.sqrt(
            (xa - cb * cg * u - (sa * sb * cg - sg * ca) * v
             - (sg * sa + sb * ca * cg) * w - p[:, 0])**2
            + (ya - sg * cb * u - (sa * sb * sg + ca * cg) * v
               - (sb * sg * ca - sa * cg) * w - p[:, 1])**2
            + (za + sb * u - sa * cb * v - ca * cb * w - p[:, 2])**2))
    return np.stack(legs, axis=-1)


def stewart_path(theta: Array) -> tuple[Array, Array, Array, Array]:
    """A helix of diameter 200 and lead 50 mm, tilting by up to 0.1 rad on the way."""
    return (0.1 * np.sin(theta), 0.08 * np.cos(2 * theta), 0.05 * np.sin(3 * theta),
            helix(theta, 0.200, 0.050, 2.0))


def test_the_stewart_platform_on_its_helix() -> None:
    """[IK] section 3.4: legs of eq. 43-48, forward back to the helix, rates of eq. 49-52."""
    theta = np.linspace(0.0, 4.0 * np.pi, 41)
    alpha, beta, gamma, p = stewart_path(theta)
    for turn in (0.0, 1.0):  # level, as in the paper, and tilting
        q = stewart_legs(turn * alpha, turn * beta, turn * gamma, p)
        pose = machines.motors(tilted(turn * alpha, turn * beta, turn * gamma), p)
        found = inverse(stewart(), pose)
        np.testing.assert_allclose(found.q, q, rtol=0, atol=3e-15)
        back = forward(stewart(), q)
        assert back.converged.all()
        assert np.abs(machines.difference(back.pose, pose)).max() < 1e-13


def test_joint_rates_of_the_stewart_platform_on_its_helix() -> None:
    theta = np.linspace(0.0, 2.0 * np.pi, 13)
    h = 1e-5
    after, now, before = (stewart_path(theta + s) for s in (h, 0.0, -h))
    expected = (stewart_legs(*after) - stewart_legs(*before)) / (2.0 * h)
    up, here, down = (machines.motors(tilted(*path[:3]), path[3])
                      for path in (after, now, before))
    table = velocity_table(stewart(), pose_vector(here),
                           machines.difference(up, down) / (2.0 * h))
    np.testing.assert_allclose(table.rate, expected, rtol=0, atol=1e-9)
    assert np.abs(expected).max() > 0.05


def test_two_regular_hexagons_are_singular() -> None:
    """Why the angles had to be chosen: regular and aligned, all six legs leave one freedom."""
    angles = np.radians(60.0 * np.arange(6))
    limbs = [{"name": f"leg{i + 1}", "kind": "U(P)S", "base": {"point": a.tolist()},
              "platform": {"point": b.tolist()}} for i, (a, b) in enumerate(zip(
                  hexagon(2.345, angles), hexagon(1.0, angles), strict=True))]
    mechanism = machines.read_text(machines.mechanism_text(
        limbs, "spatial", {"x": 0.0, "y": 0.0, "z": 2.0, "rx": 0.0, "ry": 0.0, "rz": 0.0},
        units={"length": "m", "angle": "rad"}))
    found = check(mechanism)
    assert found.singular_value < 1e-9
    assert any("singularity at home" in text for text in found.findings)


def by_command(folder: Path, machine: str, *options: str) -> tuple[dict[str, Array], Array]:
    """Run the shipped path of a shipped machine; return its columns and the joints (N, k), mm."""
    ppmcal("kinematics", "inverse", ROOT / "configs" / f"{machine}.yaml",
           ROOT / "sample_data" / "paths" / f"{machine}-helix.csv", *options, cwd=folder, expect=0)
    with (folder / "kinematics" / "kinematics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    columns = {k: np.array([float(r[k]) for r in rows]) for k in rows[0]
               if k not in ("status", "reason")}
    return columns, np.stack([v for k, v in columns.items() if k.startswith("q_")], axis=-1)


@pytest.mark.long
def test_the_helix_of_the_tripod_through_files(tmp_path: Path) -> None:
    """[IK] section 3.2: H on the helix, legs by eq. 29-31, the turn by eq. 27, and back."""
    columns, q = by_command(tmp_path, "3-RPS", "--tool", "0,0,17", "--rotation", "euler-xyz")
    theta = 2.0 * np.pi * columns["time"] / 6.0
    alpha, beta, z = on_helix(theta)
    np.testing.assert_allclose(q, 1e3 * closed_form_legs(alpha, beta, z), rtol=0, atol=2e-5)
    found = [np.radians(columns[f"euler_{i}"]) for i in (1, 2, 3)]
    np.testing.assert_allclose(np.stack(found), [alpha, beta, parasitic(alpha, beta)[0]], rtol=0,
                               atol=1e-6)
    assert np.ptp(q) > 30.0
    ppmcal("kinematics", "forward", ROOT / "configs" / "3-RPS.yaml", "kinematics/kinematics.csv",
           "--tool", "0,0,17", "--method", "intersection", "--out", "back", cwd=tmp_path, expect=0)
    with (tmp_path / "back" / "kinematics.csv").open(newline="") as file:
        back = [[float(r[c]) for c in "xyz"] for r in csv.DictReader(file)]
    np.testing.assert_allclose(back, np.stack([columns[c] for c in "xyz"], axis=-1), rtol=0,
                               atol=1e-9)


def test_the_helix_of_the_stewart_platform_through_files(tmp_path: Path) -> None:
    """[IK] section 3.4: legs by eq. 43-48, and their rates over time."""
    columns, q = by_command(tmp_path, "6-UPS")
    theta = 2.0 * np.pi * columns["time"] / 6.0
    level = np.zeros_like(theta)
    np.testing.assert_allclose(q, 1e3 * stewart_legs(level, level, level, helix(
        theta, 0.200, 0.050, 2.0)), rtol=0, atol=2e-5)
    fine = np.array([-1e-4, 0.0, 1e-4])
    slope = [np.diff(stewart_legs(*np.zeros((3, 3)), helix(t + fine, 0.200, 0.050, 2.0))[::2],
                     axis=0)[0] / 2e-4 for t in theta]
    exact = 1e3 * 2.0 * np.pi / 6.0 * np.array(slope)
    for i in range(6):
        rate = rates(columns["time"], q[:, i])
        assert np.abs(rate - exact[:, i])[1:-1].max() < 0.01 * np.abs(exact).max()


# --- [LIN] section 4.1: Linapod -----------------------------------------------------

LINAPOD = (  # a, b, l, q as printed in [LIN] Table 1, m
    ("[0.250, 0.886, 0.0]", "[-0.126, 0.180, 0.2]", 1.25, 1.221),
    ("[-0.780, -0.421, 0.0]", "[-0.093, -0.199, 0.2]", 1.25, 1.221),
    ("[0.755, -0.465, 0.0]", "[0.219, 0.019, 0.2]", 1.25, 1.221),
    ("[-0.250, 0.886, 0.0]", "[0.115, 0.164, 0.4]", 1.70, 1.933),
    ("[-0.755, -0.465, 0.0]", "[-0.199, 0.017, 0.4]", 1.70, 1.933),
    ("[0.780, -0.421, 0.0]", "[0.085, -0.181, 0.4]", 1.70, 1.933),
)
LONGER = 10e-6


@cache
def linapod(corrected: bool, with_q: bool = True) -> Mechanism:
    """The table as it is printed, or with 0.025 for the two 0.250 that do not close."""
    lines = ["format: ppmcal/mechanism/1", "name: linapod", "units: {length: m, angle: deg}",
             "motion: spatial", "limbs:"]
    for i, (a, b, length, _) in enumerate(LINAPOD):
        point = a.replace("0.250", "0.025") if corrected else a
        lines.append(f"  - {{name: leg{i + 1}, kind: (P)US, base: {{point: {point}, "
                     f"direction: [0, 0, 1]}}, platform: {{point: {b}}}, length: {length}}}")
    lines += ["home:", "  pose: {x: 0, y: 0, z: 0, rx: 0, ry: 0, rz: 0}"]
    if with_q:
        lines.append("  q: {" + ", ".join(f"leg{i + 1}: {row[3]}"
                                          for i, row in enumerate(LINAPOD)) + "}")
    lines.append("tolerances: {point: 0.0002, length: 0.0001, angle: 0.01, offset: 0.0005}")
    return machines.read_text("\n".join(lines) + "\n")


def bars(corrected: bool, q: Array) -> tuple[Array, Array, Array, Array]:
    """Return platform joints b, unit vectors along the bars, their spans and lengths, pose zero."""
    a = np.array([eval_row(row[0], corrected) for row in LINAPOD])
    b = np.array([eval_row(row[1], False) for row in LINAPOD])
    span = b - a - q[:, None] * [0.0, 0.0, 1.0]
    size = np.linalg.norm(span, axis=1)
    return b, span / size[:, None], size, np.array([row[2] for row in LINAPOD])


def eval_row(text: str, corrected: bool) -> list[float]:
    shown = text.replace("0.250", "0.025") if corrected else text
    return [float(part) for part in shown.strip("[]").split(",")]


def longer(mechanism: Mechanism, by: float) -> Model:
    g = mechanism.values.copy()
    g[[i for i, n in enumerate(mechanism.names) if n.endswith(".length")]] += by
    return Model(mechanism, g)


def shift(mechanism: Mechanism, q: Array, by: float) -> tuple[float, float]:
    """Return how far the platform moves for six bars too long: linear, and by forward, m."""
    model = Model(mechanism)
    pose = forward(model, q).pose
    wanted = [i for i, n in enumerate(mechanism.names) if n.endswith(".length")]
    closure = model.closure(q, wanted)
    jacobian = -np.linalg.solve(closure.pose_matrix(pose), closure.error_matrix(pose, wanted))
    moved = machines.difference(forward(longer(mechanism, by), q).pose, pose)[0, :3]
    return (float(np.linalg.norm(jacobian[0, :3].sum(axis=1) * by)),
            float(np.linalg.norm(moved)))


def test_the_printed_linapod_does_not_close_and_check_names_the_two_legs() -> None:
    found = check(linapod(False))
    assert [g.limb for g in found.gaps if g.open] == ["leg1", "leg4"]
    named = [text for text in found.findings if "does not close at home" in text]
    assert len(named) == 2
    assert "'leg1'" in named[0]
    assert "'leg4'" in named[1]
    q = np.array([row[3] for row in LINAPOD])
    _, _, size, length = bars(False, q)
    np.testing.assert_allclose([g.gap for g in found.gaps], size - length, rtol=0, atol=1e-15)
    for g in found.gaps:
        # centimetres where it is wrong, the table's last digit elsewhere
        assert (0.01 < abs(g.gap) < 0.1) if g.open else (2e-4 < abs(g.gap) < 7e-4)


def test_the_corrected_linapod_closes_to_the_tables_rounding() -> None:
    found = check(linapod(True))
    assert not [g.limb for g in found.gaps if g.open]
    assert not [text for text in found.findings if "close" in text]
    assert 2e-4 < max(abs(g.gap) for g in found.gaps) < 7e-4
    # the closing q are within a millimetre of the printed ones
    exact = home_state(linapod(True, False)).q
    assert 1e-4 < np.abs(exact - [row[3] for row in LINAPOD]).max() < 1e-3


def test_six_bars_too_long_by_10_um_move_linapod_by_11_528_um() -> None:
    """[LIN] section 4.1: 11.528 um, from pose zero (statics), closed, and from the printed q."""
    printed = np.array([row[3] for row in LINAPOD])
    b, e, _, _ = bars(True, printed)
    wrenches = np.concatenate([e, np.cross(b, e)], axis=1)
    statics = np.linalg.norm(np.linalg.solve(wrenches, np.full(6, LONGER))[:3])
    closed = shift(linapod(True), home_state(linapod(True, False)).q[None], LONGER)
    from_q = shift(linapod(True), printed[None], LONGER)
    assert 1e6 * statics == pytest.approx(11.5276, abs=5e-5)
    assert 1e6 * closed[0] == pytest.approx(11.5288, abs=5e-5)
    assert 1e6 * closed[1] == pytest.approx(11.5288, abs=5e-5)
    assert 1e6 * from_q[0] == pytest.approx(11.5296, abs=5e-5)
    assert 1e6 * from_q[1] == pytest.approx(11.5296, abs=5e-5)
    for value in (statics, *closed, *from_q):
        assert 1e6 * value == pytest.approx(11.528, abs=0.002)


@pytest.mark.parametrize(("by", "relative"), [(10e-6, 1.3e-6), (10e-3, 1.3e-3)])
def test_linear_against_nonlinear_linapod(by: float, relative: float) -> None:
    """[LIN] claims nine digits at 10 um and 1 % at 10 mm; it is 1.3e-6 and 0.13 %."""
    linear, exact = shift(linapod(True), home_state(linapod(True, False)).q[None], by)
    assert linear / exact - 1.0 == pytest.approx(relative, rel=0.02)
