"""The same machine and the same rows, written down another way, give the same answer.

Order of rows, limbs and columns, units, names, base and measuring frame: rank, what cannot be
identified, which rows are left out, values, sigmas and verdicts must not feel them.
"""

import math
import re

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows
from hypothesis import given, settings
from hypothesis import strategies as st

import ppmcal as face
from ppmcal.calibration.fit.rank import analyse, by_name, slot_of, unidentifiable

PLANAR = ("x", "y", "rz")


# --- one campaign, written in many ways ---------------------------------------------------------


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """Return a planar machine's file, sidecar and rows, one of them wrong, frame unknown."""
    folder = tmp_path_factory.mktemp("campaign")
    ppmcal("init", "3-RPR", "--out", folder / "mine.yaml", expect=0)
    tree = yaml.safe_load((folder / "mine.yaml").read_text())
    scenario = yaml.safe_load((folder / "mine.scenario.yaml").read_text())
    for i, limb in enumerate(tree["limbs"]):
        radius, angle = (limb["platform"]["point"][k] for k in ("radius", "angle"))
        angle = math.radians(angle if not isinstance(angle, dict) else angle["value"])
        radius = radius if not isinstance(radius, dict) else radius["value"]
        # plain points, and no two limbs alike
        limb["platform"]["point"] = [radius * math.cos(angle) + 3.0 * i,
                                     radius * math.sin(angle) - 2.0 * i]
    tree["home"] = {"pose": tree["home"]["pose"]}
    tree.pop("limits", None)
    scenario["errors"] = {"random": {"scale": 1.0}}
    (folder / "mine.yaml").write_text(yaml.safe_dump(tree))
    (folder / "mine.scenario.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", folder / "mine.yaml", folder / "mine.scenario.yaml", "--seed", 2,
           "--out", folder / "s")
    side = yaml.safe_load((folder / "s" / "measurements.yaml").read_text())
    side |= {"frame": "unknown", "target": "unknown"}
    table = {c: np.array([float(r[c]) for r in rows(folder / "s" / "measurements.csv")])
             for c in rows(folder / "s" / "measurements.csv")[0]
             if c.startswith("q_") or c in PLANAR}
    table["x"][5] += 4.0
    return tree, side, table


def turned(points, degrees, shift=(0.0, 0.0)):
    """Return points (2,) or columns (2, N) turned and shifted in the plane."""
    c, s = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    x, y = points
    return c * x - s * y + shift[0], s * x + c * y + shift[1]


def in_other_words(campaign, rows_=None, limbs=None, columns=None, units=("mm", "deg"),
                   names=None, base=0.0, shift=(0.0, 0.0), seen=0.0):
    """Return the campaign as another person would have written it."""
    tree, side, table = (yaml.safe_load(yaml.safe_dump(x)) if i != 2 else dict(x)
                         for i, x in enumerate(campaign))
    names = names or {limb["name"]: limb["name"] for limb in tree["limbs"]}
    for limb in tree["limbs"]:
        limb["name"] = names[limb["name"]]
        limb["base"]["point"] = [float(v) for v in turned(limb["base"]["point"], base, shift)]
    pose = tree["home"]["pose"]
    pose["x"], pose["y"] = (float(v) for v in turned((pose["x"], pose["y"]), base, shift))
    pose["rz"] += base
    table = {**table, **dict(zip("xy", turned((table["x"], table["y"]), seen), strict=True)),
             "rz": (table["rz"] + seen + 180.0) % 360.0 - 180.0}
    table = {("q_" + names[c[2:]]) if c.startswith("q_") else c: v for c, v in table.items()}
    if limbs is not None:
        tree["limbs"] = [tree["limbs"][i] for i in limbs]
    if rows_ is not None:
        table = {c: v[rows_] for c, v in table.items()}
    if columns is not None:
        order = np.random.default_rng(columns).permutation(len(table))
        table = {list(table)[i]: table[list(table)[i]] for i in order}
    length, angle = {"mm": 1.0, "m": 1e-3, "um": 1e3, "in": 1 / 25.4}[units[0]], (
        {"deg": 1.0, "rad": math.pi / 180.0}[units[1]])
    tree["units"] = side["units"] = {"length": units[0], "angle": units[1]}
    for limb in tree["limbs"]:
        for end in ("base", "platform"):
            limb[end]["point"] = [v * length for v in limb[end]["point"]]
    tree["home"]["pose"] = {k: v * (angle if k == "rz" else length) for k, v in pose.items()}
    tree["tolerances"] = {k: v * (angle if k == "angle" else length)
                          for k, v in tree["tolerances"].items()}
    sigma = side["instrument"]["sigma"]
    side["instrument"]["sigma"] = {"position": sigma["position"] * length,
                                   "rotation": sigma["rotation"] * angle}
    table = {c: v * (angle if c == "rz" else length) for c, v in table.items()}
    return tree, side, table, {v: k for k, v in names.items()}


def answer(written):
    """Return what identify says, back in the first words: by name, SI, the base's points left."""
    tree, side, table, old = written
    machine = face.load(tree)
    data = face.read_data(machine, table, sidecar=side, name="run")
    found = face.identify(machine, data, holdout=0).identification

    def plain(name):
        limb, _, rest = name.partition(".")
        return f"{old.get(limb, limb)}.{rest}"

    sets = frozenset((frozenset(plain(s) for s in one.slots), one.combinations)
                     for one in found.unidentifiable)
    own = {plain(e.name): (e.error, e.sigma or 0.0) for e in found.estimates
           if not e.name.endswith((".x", ".y")) or "platform" in e.name}
    limbs = {plain(f"{limb.name}."): limb for limb in machine.limbs}
    at = {n: np.array([next(e.error for e in found.estimates
                            if e.name == f"{limb.name}.base.point.{c}") for c in "xy"])
          for n, limb in limbs.items()}
    out = sorted(found.fit.problem.datasets[0].rows[~found.fit.keep[0]].tolist())
    return found, sets, own, at, out


def assert_same(one, other, turn=0.0):
    """Compare two answers; the second's base is turned by so many degrees."""
    assert other[0].rank == one[0].rank
    assert len(other[0].redundant) == len(one[0].redundant)
    assert other[1] == one[1]
    assert other[0].noise.sigma_ratio == pytest.approx(one[0].noise.sigma_ratio, rel=1e-6)
    assert other[0].noise.failed == one[0].noise.failed
    size = max(abs(v) for v, _ in one[2].values())
    assert other[2].keys() == one[2].keys()
    for name, (error, sigma) in one[2].items():
        assert other[2][name][0] == pytest.approx(error, rel=2e-5, abs=1e-5 * size), name
        assert other[2][name][1] == pytest.approx(sigma, rel=1e-5), name
    for name, error in one[3].items():
        assert np.array(turned(error, turn)) == pytest.approx(other[3][name], abs=1e-5 * size)


@pytest.fixture(scope="module")
def plain(campaign):
    """Return the answer to the campaign as it is."""
    found = answer(in_other_words(campaign))
    assert found[4] == [6]
    assert found[0].unidentifiable
    return found


@pytest.mark.slow
def test_the_order_of_rows_tells_nothing(campaign, plain):
    count = len(campaign[2]["x"])
    order = np.random.default_rng(1).permutation(count)
    found = answer(in_other_words(campaign, rows_=order))
    assert_same(plain, found)
    assert [order[n - 1] + 1 for n in found[4]] == plain[4]


@pytest.mark.parametrize("limbs", [[2, 1, 0], [1, 2, 0]])
@pytest.mark.slow
def test_the_order_of_limbs_tells_nothing(campaign, plain, limbs):
    found = answer(in_other_words(campaign, limbs=limbs))
    assert_same(plain, found)
    # and the single names do not hang on it either
    assert {d.name for d in found[0].redundant} == {d.name for d in plain[0].redundant}
    assert {e.name: e.status for e in found[0].estimates} == {
        e.name: e.status for e in plain[0].estimates}


@pytest.mark.parametrize("units", [("m", "rad"), ("um", "deg"), ("in", "rad")])
@pytest.mark.slow
def test_units_and_the_order_of_columns_tell_nothing(campaign, plain, units):
    found = answer(in_other_words(campaign, units=units, columns=3))
    assert_same(plain, found)
    assert found[4] == plain[4]


@pytest.mark.slow
def test_names_tell_nothing(campaign, plain):
    names = {"leg1": "zulu", "leg2": "alpha10", "leg3": "alpha9"}
    assert_same(plain, answer(in_other_words(campaign, names=names)))


@pytest.mark.parametrize("seed", range(3))    # as many as there are units
@pytest.mark.slow
def test_frames_and_all_else_at_once_tell_nothing(campaign, plain, seed):
    rng = np.random.default_rng(seed)
    base, seen = rng.uniform(-170.0, 170.0, 2)
    units = [("mm", "deg"), ("m", "rad"), ("in", "deg")][seed % 3]
    found = answer(in_other_words(campaign, base=base, shift=tuple(rng.uniform(-900.0, 900.0, 2)),
                                  seen=seen, limbs=rng.permutation(3), units=units, columns=seed))
    assert_same(plain, found, base)
    assert found[4] == plain[4]


@pytest.mark.long
def test_what_is_said_of_it_is_the_same_from_every_side(campaign, tmp_path):
    """The console's own sentence, for check and for identify."""
    said = set()
    for i, changes in enumerate(({}, {"base": 37.0, "limbs": [2, 0, 1]}, {"base": 90.0, "seen": 11},
                                 {"units": ("m", "rad"), "shift": (80.0, -700.0)})):
        tree, side, table, _ = in_other_words(campaign, **changes)
        folder = tmp_path / str(i)
        folder.mkdir()
        (folder / "mine.yaml").write_text(yaml.safe_dump(tree))
        (folder / "run.yaml").write_text(yaml.safe_dump(side))
        lines = [",".join(table), *(",".join(repr(float(v)) for v in row)
                                    for row in zip(*table.values(), strict=True))]
        (folder / "run.csv").write_text("\n".join(lines) + "\n")
        for command in ("check", "identify"):
            run = ppmcal(command, "mine.yaml", "run.csv", cwd=folder)
            (sets,) = re.findall(r"\d+ (?:redundant: )?combinations of parameters [^:]*: (.*?)\.\s",
                                 " ".join(run.out.split()))
            said.add(sets)
    assert len(said) == 1, said


# --- the sets themselves ------------------------------------------------------------------------


def test_limbs_are_sorted_as_people_count():
    names = ["leg10.b", "leg2.z", "leg2.a", "a.b", "leg.x"]
    assert [n for _, n in sorted(zip(by_name(names), names, strict=True))] == [
        "a.b", "leg.x", "leg2.z", "leg2.a", "leg10.b"]


def test_coordinates_of_points_and_directions_are_one_slot():
    assert slot_of("leg1.base.point.radius") == slot_of("leg1.base.point.z") == "leg1.base.point"
    assert slot_of("leg1.base.axis.rx") == "leg1.base.axis"
    assert slot_of("leg1.base.direction.ry") == "leg1.base.direction"
    assert slot_of("leg1.joint1.rz") == "leg1.joint1.rz"
    assert slot_of("leg1.offset") == "leg1.offset"


NAMES = ["a.one", "a.two", "b.one", "b.two", "c.one", "c.two", "d.none"]


def blocked(rng):
    """Return columns of which a's two are one, b and c sum up, and d's is empty."""
    free = rng.normal(size=(20, 4))
    a, b, c, d = free.T
    columns = np.stack([a, 2.0 * a, b, c, d, 3.0 * b - c + 0.5 * d, 0.0 * a], axis=1)
    return columns * rng.uniform(0.2, 5.0, len(NAMES))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10**6), order=st.permutations(range(len(NAMES))),
       scale=st.lists(st.floats(1e-3, 1e3), min_size=len(NAMES), max_size=len(NAMES)))
def test_sets_do_not_depend_on_order_or_scale(seed, order, scale):
    columns = blocked(np.random.default_rng(seed))[:, order] * scale
    names = [NAMES[i] for i in order]
    rank = analyse(columns, len(names), np.ones(len(names)), names=names)
    found = unidentifiable(rank, names)
    assert {(frozenset(s.slots), s.combinations, s.unseen) for s in found} == {
        (frozenset({"a.one", "a.two"}), 1, False),
        (frozenset({"b.one", "b.two", "c.one", "c.two"}), 1, False),
        (frozenset({"d.none"}), 1, True)}
    assert len(rank.kept) == 4


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), turn=st.floats(0.0, 2.0 * math.pi))
def test_a_turned_base_has_the_same_sets(seed, turn):
    """A point of which only z is lost, in axes turned about x, is the same point."""
    rng = np.random.default_rng(seed)
    names = [f"leg{i}.base.point.{c}" for i in (1, 2) for c in "xyz"]
    columns = rng.normal(size=(20, 6))
    columns[:, 2] = 0.0
    columns[:, 5] = columns[:, 3]
    c, s = math.cos(turn), math.sin(turn)
    about = np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])
    away = columns @ np.kron(np.eye(2), about)
    sets = [{(s.slots, s.combinations) for s in unidentifiable(
        analyse(m, 6, np.ones(6), names=names), names)} for m in (columns, away)]
    assert sets[0] == sets[1] == {(("leg1.base.point",), 1), (("leg2.base.point",), 1)}


# --- decisions of diagnose ----------------------------------------------------------------------


@pytest.mark.long
def test_the_verdict_does_not_feel_how_the_campaign_is_written(tmp_path):
    """Limbs in another order and under other names, rows in other units."""
    ppmcal("init", "3-RPR", "--out", tmp_path / "mine.yaml", expect=0)
    scenario = yaml.safe_load((tmp_path / "mine.scenario.yaml").read_text())
    scenario |= {"approach": "both", "effects": [
        {"kind": "backlash", "on": ["leg2"], "parameters": {"width": 0.15}}]}
    (tmp_path / "mine.scenario.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", tmp_path / "mine.yaml", tmp_path / "mine.scenario.yaml", "--seed", 5,
           "--out", tmp_path / "s")
    tree = yaml.safe_load((tmp_path / "mine.yaml").read_text())
    side = yaml.safe_load((tmp_path / "s" / "measurements.yaml").read_text())
    table = rows(tmp_path / "s" / "measurements.csv")
    said = []
    for other in (False, True):
        t, d, data = (yaml.safe_load(yaml.safe_dump(v)) for v in (tree, side, table))
        back = {}
        if other:
            t["limbs"] = t["limbs"][::-1]
            data = [dict(reversed(list(r.items()))) for r in data]
            d["units"]["length"] = "m"
            d["instrument"]["sigma"]["position"] *= 1e-3
            data = [{k: repr(float(v) * 1e-3) if k.startswith("q_") or k in "xy" else v
                     for k, v in r.items()} for r in data]
            back = {"strutC": "leg1", "strutA": "leg2", "strutB": "leg3"}
            text = yaml.safe_dump(t)
            for new, old in back.items():
                text = text.replace(old, new)
                data = [{k.replace(old, new): v for k, v in r.items()} for r in data]
            t = yaml.safe_load(text)
        machine = face.load(t)
        columns = {k: np.array([float(r[k] or "nan") for r in data]) for k in data[0]}
        found = face.diagnose(machine, face.read_data(machine, columns, sidecar=d, name="run"))
        said.append((found.verdict, sorted(
            (e.kind, tuple(sorted(back.get(a, a) for a in e.on))) for e in found.record.effects)))
    assert said[1] == said[0]
    assert said[0][1]
