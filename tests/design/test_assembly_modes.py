"""Assembly modes: all of them, none invented, none lost without a word."""


import numpy as np
import pytest
from helpers.machines import (
    PLANAR,
    Mechanism,
    Model,
    chain_lengths,
    contract_lengths,
    delta,
    full,
    home_state,
    limb_lengths,
    matrices,
    mechanism_text,
    motors,
    plain,
    read_text,
    spread,
)
from helpers.paths import ROOT
from scipy.optimize import brentq

from ppmcal.design.assembly_modes import assembly_modes
from ppmcal.design.assembly_modes_planar import DEGREE, SAMPLES, _even_angles, _rows
from ppmcal.errors import NoResult
from ppmcal.io import read_mechanism
from ppmcal.kinematics.partial_pose import pose_vector
from ppmcal.kinematics.tables import inverse_table

CONFIGS = ROOT / "configs"


def turned(phi):
    c, s, o = np.cos(phi), np.sin(phi), np.zeros_like(phi)
    return np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1),
                     np.stack([o, o, o + 1.0], -1)], -2)


def planar_pose(v):
    """Motors (N, 8) of x, y, rz (N, 3)."""
    return motors(turned(v[:, 2]), np.column_stack([v[:, :2], np.zeros(len(v))]))


def gaps(model, q, v, own=contract_lengths):
    """How far the limbs are from closing (N, 3), m, as written out in tests/machines.py."""
    return limb_lengths(model, np.tile(q, (len(v), 1)), planar_pose(v), own)


def brute_force(model, q, own, starts=260, seed=3):
    """All planar poses x, y, rz that plain Newton finds from drawn starts, by limb formulas."""
    m = model.mechanism
    rng = np.random.default_rng(seed)
    v = rng.uniform(-1.0, 1.0, (starts, 3)) * [1.5 * m.reach, 1.5 * m.reach, np.pi]
    v[:, :2] += m.home_pose[:2]
    h = 1e-7 * np.array([m.reach, m.reach, 1.0])
    solved = []
    for _ in range(25):
        n = len(v)
        shifted = np.concatenate([v, *(v + h[k] * np.eye(3)[k] for k in range(3))])
        f, *more = np.split(gaps(model, q, shifted, own), 4)
        done = np.abs(f).max(axis=1) < 1e-11 * m.reach
        solved.append(v[done])
        slope = np.stack([(g - f) / h[k] for k, g in enumerate(more)], axis=-1)
        left = ~done & (np.abs(np.linalg.det(slope)) > 1e-9)
        v = v[left] - np.linalg.solve(slope[left], f[left][..., None])[..., 0]
        v = v[(np.abs(v[:, :2] - m.home_pose[:2]) < 50.0 * m.reach).all(axis=1)]
        if not len(v):
            break
        assert len(v) <= n
    out = []
    for one in np.concatenate(solved):
        if all(np.hypot(np.linalg.norm(one[:2] - o[:2]) / m.reach,
                        2.0 * np.sin(0.5 * (one[2] - o[2]))) > 1e-6 for o in out):
            out.append(one)
    return np.array(out).reshape(-1, 3)


def as_planar(modes):
    rotation, origin = matrices(modes.motors)
    return np.column_stack([origin[:, :2], np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])])


def agree(model, q, own=contract_lengths):
    """The resultant's modes are those of the search by brute force, one by one."""
    found = assembly_modes(model, q)
    mine, other = as_planar(found), brute_force(model, q, own)
    assert len(mine) == len(other), (mine, other)
    if len(mine):
        assert np.abs(gaps(model, q, mine, own)).max() < 1e-9 * model.mechanism.reach
        away = (mine[:, None] - other[None]) / [model.mechanism.reach, model.mechanism.reach, 2.0]
        apart = np.linalg.norm(away[..., :2], axis=-1) + np.abs(np.sin(away[..., 2]))
        assert apart.min(axis=1).max() < 1e-6
    assert found.complete and found.method == "resultant"
    assert len(found) % 2 == 0
    return found


def three_rpr(base, platform, home):
    limbs = [{"name": f"leg{i + 1}", "kind": "R(P)R", "base": {"point": [float(x) for x in a]},
              "platform": {"point": [float(x) for x in b]}}
             for i, (a, b) in enumerate(zip(base, platform, strict=True))]
    return read_text(mechanism_text(limbs, "planar", dict(zip(("x", "y", "rz"), map(float, home),
                                                              strict=True))))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPR", "3-RRR-1", "3-PPR-1", "3-RRP-2", "mixed-planar"])
def test_planar_configs_against_brute_force(name):
    model = Model(read_mechanism(CONFIGS / f"{name}.yaml"))
    home = home_state(model.mechanism).q
    assert agree(model, home).home == 0
    q, pose = spread(model, 1, seed=4, size=2.0)
    found = agree(model, q[0])
    assert np.abs(matrices(found.motors[found.home][None])[1] - matrices(pose)[1]).max() < 1e-9
    # far from home, where modes may be few or none
    agree(model, home * (1.0 + 0.5 * np.random.default_rng(11).uniform(-1.0, 1.0, home.size)))


@pytest.mark.parametrize("kind", PLANAR)
def test_every_planar_kind_with_all_its_slots(kind):
    model = Model(full(kind))
    q, poses = spread(model, 1, seed=8, size=1.5)
    found = agree(model, q[0], chain_lengths)
    assert found.home == 0
    assert np.allclose(found.motors[0] * np.sign(found.motors[0] @ poses[0]), poses[0], atol=1e-9)


@pytest.mark.slow
def test_three_rpr_has_up_to_six_modes_and_never_more():
    rng = np.random.default_rng(0)
    counts = []
    for _ in range(45):
        base, platform = rng.uniform(-500, 500, (2, 3, 2))
        model = Model(three_rpr(base, platform, [*rng.uniform(-300, 300, 2),
                                                 rng.uniform(-180, 180)]))
        q = home_state(model.mechanism).q
        found = assembly_modes(model, q)
        assert found.complete and found.home == 0
        counts.append(len(found))
        if len(found) == 6 and counts.count(6) == 1:
            assert len(brute_force(model, q, contract_lengths, 1200)) == 6
            # simple roots: det A has either sign as often
            assert sorted(found.sign.tolist()) == [-1] * 3 + [1] * 3
    assert set(counts) == {2, 4, 6}


# surfaces of the limbs -> degree of F in the platform's rotation (design/assembly_modes.py)
MIXES = [(("R(P)R", "(P)RR", "(R)RR"), 3), (("R(P)R", "R(P)R", "(P)PR"), 3),
         (("R(P)R", "R(R)R", "R(P)P"), 3), (("R(P)R", "(P)PR", "(R)PR"), 2),
         (("R(P)R", "(P)PR", "R(P)P"), 3), (("R(P)R", "R(P)P", "(P)RP"), 2),
         (("(P)PR", "P(P)R", "(R)PR"), 1), (("(P)PR", "P(P)R", "(P)RP"), 2),
         (("(P)PR", "R(P)P", "(P)RP"), 2), (("(R)RP", "R(P)P", "(P)RP"), 1)]


@pytest.mark.slow
@pytest.mark.parametrize("kinds,degree", MIXES, ids=lambda v: "+".join(v) if isinstance(v, tuple)
                         else str(v))
def test_degree_of_each_mix(kinds, degree):
    from helpers.machines import CASES

    limbs = [dict(CASES[k].limbs[i]) for i, k in enumerate(kinds)]
    model = Model(read_text(mechanism_text(limbs, "planar", {"x": 4.0, "y": -3.0, "rz": 6.0})))
    home = home_state(model.mechanism).q
    rng = np.random.default_rng(5)
    most = 0
    for q in (home, *(home * (1.0 + 0.2 * rng.uniform(-1.0, 1.0, (3, 3))))):
        value, size = _rows(model.closure(q), _even_angles()).resultant
        spectrum = np.abs(np.fft.rfft(value)) / (SAMPLES * size)    # the largest term = 1
        assert spectrum[degree + 1:].max() < 1e-13
        assert spectrum[degree] > 1e-6
        most = max(most, len(agree(model, q)))
    assert 2 <= most <= 2 * degree <= 2 * DEGREE


def test_no_pose_closes():
    model = Model(read_mechanism(CONFIGS / "3-RPR.yaml"))
    found = assembly_modes(model, np.array([0.01, 0.01, 0.01]))
    assert len(found) == 0 and found.home is None and found.complete


def test_refused_with_a_reason():
    triangle = np.array([[-100.0, -60.0], [100.0, -60.0], [0.0, 110.0]])
    cases = {  # equal triangles on equal legs swing on a circle; a platform that is a point spins
        "translates freely": three_rpr(triangle, triangle, (50, 40, 0)),
        "does not depend on the platform's rotation":
            three_rpr(2 * triangle, 0 * triangle + 5.0, (10, 20, 0))}
    for words, machine in cases.items():
        with pytest.raises(NoResult, match=words):
            assembly_modes(Model(machine), home_state(machine).q)
    model = Model(read_mechanism(CONFIGS / "3-RPR.yaml"))
    with pytest.raises(NoResult, match="missing"):
        assembly_modes(model, np.array([np.nan, 0.3, 0.3]))
    with pytest.raises(NoResult, match=r"leg2.*no length"):
        assembly_modes(model, np.array([0.3, 0.0, 0.3]))


def test_two_modes_that_meet_are_one_and_singular():
    # base and platform similar and parallel: all legs through one point
    triangle = np.array([[-100.0, -60.0], [100.0, -60.0], [0.0, 110.0]])
    machine = three_rpr(2 * triangle, triangle, (10, 20, 0))
    found = assembly_modes(Model(machine), home_state(machine).q)
    assert len(found) == 1 and found.singular[0] and found.singular_value[0] < 1e-6
    # a little turned they are two, mirror-like, and still next to singular
    machine = three_rpr(2 * triangle, triangle, (10, 20, 0.05))
    found = assembly_modes(Model(machine), home_state(machine).q)
    assert len(found) == 2 and found.complete and found.home == 0
    assert sorted(found.sign) == [-1, 1]


def test_parallel_lines_do_not_lose_modes():
    """Collinear joints in one proportion: the circles' radical axes are parallel at every turn."""
    machine = three_rpr([[0, 0], [100, 0], [250, 0]], [[0, 0], [40, 0], [100, 0]], (30, 80, 20))
    found = agree(Model(machine), home_state(machine).q)
    assert len(found) == 4


@pytest.mark.parametrize("machine", [delta("(P)US", 3), delta("(R)US", 3)],
                         ids=["linear", "rotary"])
def test_translational_machines_meet_in_a_point_pair(machine):
    model = Model(machine)
    q, poses = spread(model, 4, size=2.0)
    for row, pose in zip(q, poses, strict=True):
        found = assembly_modes(model, row)
        assert len(found) == 2 and found.complete and found.method == "point pair"
        assert found.home == 0 and sorted(found.sign) == [-1, 1]
        assert np.allclose(matrices(found.motors[:1])[1], matrices(pose)[1], atol=1e-10)
        assert np.abs(limb_lengths(model, np.tile(row, (2, 1)), found.motors)).max() < 1e-9


@pytest.mark.parametrize("name", ["maslow", "hangprinter"])
def test_surplus_ropes_leave_of_the_pair_what_closes_by_all(name):
    """Three lengths close at two points; the fourth says which."""
    model = Model(read_mechanism(CONFIGS / f"{name}.yaml"))
    _, poses = spread(model, 4)
    q = inverse_table(model, pose_vector(poses)).q
    for row, pose in zip(q, poses, strict=True):
        found = assembly_modes(model, row)
        assert len(found) == 1 and found.complete and found.method == "point pair"
        assert np.allclose(matrices(found.motors)[1], matrices(pose)[1], atol=1e-9)


@pytest.mark.slow
def test_delta_where_the_two_modes_meet_and_beyond():
    """One carriage rises until the two points in which the spheres meet are one."""
    machine = delta("(P)US", 3)
    home = home_state(machine).q
    model = Model(machine)

    def centre(q):
        """Trilateration: centres of the spheres of the platform's origin, and half the pair."""
        at = np.array([[c, s, 0.0] for c, s in ((np.cos(a), np.sin(a)) for a in np.radians(
            [10.0, 125.0, 246.0]))]) * 0.115 + np.outer(q, [0.0, 0.0, 1.0])
        x = at[1] - at[0]
        d = np.linalg.norm(x)
        x = x / d
        y = at[2] - at[0]
        i = x @ y
        y = y - i * x
        j = np.linalg.norm(y)
        along, aside = 0.5 * d, 0.5 * (i * i + j * j - d * i) / j
        return 0.25**2 - along**2 - aside**2

    def raised(z):
        return home + np.array([z, 0.0, 0.0])

    assert centre(home) > 0.0 > centre(raised(0.6))
    edge = brentq(lambda z: centre(raised(z)), 0.0, 0.6, xtol=1e-15)
    assert len(assembly_modes(model, raised(edge - 1e-4))) == 2
    assert len(assembly_modes(model, raised(edge + 1e-4))) == 0
    at = assembly_modes(model, raised(edge))
    assert len(at) == 1 and at.singular[0] and at.singular_value[0] < 1e-4


def test_delta_with_centres_on_one_line_is_refused():
    limbs = [{"name": n, "kind": "(P)US", "base": {"point": [x, 0.0, 0.0], "direction": [0, 0, 1]},
              "platform": {"point": [0.0, y, 0.0]}, "length": 250.0, "branch": 1}
             for n, x, y in (("a", -100.0, 0.0), ("b", 0.0, 30.0), ("c", 100.0, 0.0))]
    machine = read_text(mechanism_text(limbs, "translational", {"x": 3.0, "y": 4.0, "z": -100.0}))
    model = Model(machine)
    assert len(assembly_modes(model, home_state(machine).q)) == 2
    with pytest.raises(NoResult, match="one line"):
        flat = machine.with_values(np.array([0.0 if p.name == "b.platform.point.y" else p.value
                                             for p in machine.parameters]))
        assembly_modes(Model(flat), np.zeros(3))


@pytest.mark.long_cases("3-RPS")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["3-RPS", "6-UPS", "delta-rotary-6rods"])
def test_spatial_machines_are_searched(name):
    model = Model(read_mechanism(CONFIGS / f"{name}.yaml"))
    q = home_state(model.mechanism).q
    found = assembly_modes(model, q)
    assert found.method == "search" and not found.complete and found.home == 0
    assert np.abs(limb_lengths(model, np.tile(q, (len(found), 1)), found.motors)).max() < 1e-9
    rotation, origin = matrices(found.motors)
    apart = np.linalg.norm(origin[:, None] - origin[None], axis=-1) + np.linalg.norm(
        rotation[:, None] - rotation[None], axis=(-2, -1))
    assert apart[~np.eye(len(found), dtype=bool)].min() > 1e-3
    other = assembly_modes(model, q, seed=5)
    assert len(other) == len(found) and np.allclose(np.abs(np.sum(other.motors * found.motors, 1)),
                                                    np.sum(found.motors**2, 1), atol=1e-6)


@pytest.mark.slow
def test_a_flat_hexapod_has_each_mode_mirrored_in_its_base():
    """Joints in one plane on either body: what closes above the base closes below it, mirrored."""
    found = assembly_modes(Model(read_mechanism(CONFIGS / "6-UPS.yaml")),
                           home_state(read_mechanism(CONFIGS / "6-UPS.yaml")).q)
    rotation, origin = matrices(found.motors)
    flip = np.diag([1.0, 1.0, -1.0])
    for r, t in zip(flip @ rotation @ flip, origin @ flip, strict=True):
        assert (np.linalg.norm(rotation - r, axis=(1, 2))
                + np.linalg.norm(origin - t, axis=1)).min() < 1e-8


def test_every_plain_machine_finds_its_own_home():
    for kind in PLANAR:
        machine: Mechanism = plain(kind)
        assert assembly_modes(Model(machine), home_state(machine).q).home == 0
