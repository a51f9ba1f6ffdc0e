"""The short form of `make fuzz`: what failed once, moments of each reader, near-valid files."""

import random
import warnings

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fuzz.campaign import Tally, crashes, fuzz
from fuzz.judge import judged
from fuzz.mutations import WAYS, mutated, smaller
from fuzz.readers import readers

READERS = readers()
INPUTS, SECONDS = 40, 0.3
NEAR = settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))


def well(name, data):
    outcome = judged(READERS[name].read, data, 30.0)
    assert not outcome.fault, f"{outcome.fault}\n{outcome.detail}"
    return outcome


@pytest.mark.parametrize(("name", "path"), [
    pytest.param(name, path, id=f"{name}-{path.name}") for name, path in crashes()
    if name != "campaign"])
@pytest.mark.slow_cases("sheet-12750f2b0806")
def test_what_failed_once(name, path):
    if name not in READERS:
        pytest.skip(f"what reads {name} is not installed")
    well(name, path.read_bytes())


@pytest.mark.parametrize("name", READERS)
def test_good_inputs_are_read(name):
    read = [well(name, data).key == "read" for data in READERS[name].seeds]
    assert any(read)


@pytest.mark.parametrize("name", READERS)
@pytest.mark.slow_cases("sheet")
def test_changed_inputs(name):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        tally, _ = fuzz(READERS[name], SECONDS, 1, Tally(), most=INPUTS)
    assert not tally.faults, "\n".join(f"{f}: {d[0]!r}\n{d[1]}" for f, d in tally.faults.items())


def test_the_fuzzer_finds_what_is_wrong():
    def reader(data):
        if b"9" in data and b"\n\n" in data:
            raise ZeroDivisionError

    found = next(d for d in (mutated(b"1,2\n3,4\n", [b"9"], random.Random(i), "csv")
                             for i in range(20_000)) if judged(reader, d).fault)
    assert judged(reader, found).fault.startswith("ZeroDivisionError")
    least = smaller(found, lambda d: bool(judged(reader, d).fault))
    assert len(least) <= len(found) and judged(reader, least).fault


def test_changes_are_drawn_by_the_seed():
    for form in WAYS:
        one, other = ([mutated(b'{"a": [1, 2]}', [b"x"], random.Random(3), form) for _ in range(9)]
                      for _ in range(2))
        assert one == other


NUMBERS = st.one_of(st.floats(), st.integers(-10 ** 400, 10 ** 400), st.integers(-9, 9),
                    st.sampled_from([1e12, 1e15, 1e-300]))
SCALARS = st.one_of(NUMBERS, st.booleans(), st.none(), st.text(max_size=5))
TREES = st.recursive(SCALARS, lambda inner: st.one_of(
    st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=3), inner, max_size=3)))


@st.composite
def near(draw, good):
    """Trees that differ from a good one in one to three places."""
    tree = yaml.safe_load(good)
    for _ in range(draw(st.integers(1, 3))):
        node = tree
        while True:
            keys = list(node) if isinstance(node, dict) else list(range(len(node)))
            if not keys:
                break
            key = draw(st.sampled_from(keys))
            if not isinstance(node[key], dict | list) or not node[key] or draw(st.booleans()):
                node[key] = draw(TREES)
                break
            node = node[key]
    return yaml.safe_dump(tree, allow_unicode=True).encode("utf-8", "surrogatepass")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mechanism", "scenario", "yaml", "batch"])
def test_files_that_are_nearly_right(name):
    @NEAR
    @given(near(READERS[name].seeds[0]))
    def holds(data):
        well(name, data)

    holds()


@NEAR
@given(st.lists(st.lists(st.one_of(NUMBERS.map(str), st.text(max_size=4), st.just("")), min_size=7,
                         max_size=7), min_size=1, max_size=5), st.sampled_from([",", ";", "\t"]))
def test_tables_that_are_nearly_right(rows, mark):
    lines = [mark.join(r) for r in [["pose", "q_leg1", "q_leg2", "q_leg3", "x", "y", "rz"], *rows]]
    data = "\n".join(lines).encode("utf-8", "surrogatepass")
    side = READERS["dataset"].seeds[0].partition(b"\n====\n")[2]
    well("csv", data)
    well("dataset", data + b"\n====\n" + side)


@NEAR
@given(st.lists(st.tuples(st.sampled_from(["setp", "", "net", "source", "SETP", "linkps"]),
                          st.sampled_from(["genhexkins.base.0.x", "genhexkins.", "=", "a",
                                           "genhexkins.screw-lead"]),
                          st.one_of(NUMBERS.map(str), st.text(max_size=6), st.just("[A]B")))))
def test_hal_lines_that_are_nearly_right(lines):
    data = "\n".join(" ".join(line) for line in lines).encode("utf-8", "surrogatepass")
    well("hal", data)
    well("hal", READERS["hal"].seeds[0] + data)


ODD = ("1e400", "-1e400", "9" * 5000, "nan", "inf", "1e", "--1", "1_0", "0x10", "1,5", "٣", "１",
       "²", "½", "1\x00", "1\x0b", "\u2028", "", "[JOINT_0]A", "= 1")
"""What stands in the place of a number."""


@pytest.mark.parametrize("odd", ODD, ids=ascii)
def test_odd_numbers_of_joints_are_refused(odd):
    for line in (f"# HOME = {odd}", f"# HOME = 1\n# HOME_OFFSET = present + {odd} ",
                 f"[JOINT_{odd}]\n# HOME = 1", f"# HOME = 1\n# HOME = {odd}",
                 f"# HOME = 1\n# HOME_OFFSET = present * {odd} + 1"):
        well("hal-joints", f"[JOINT_0]\n{line}\n".encode())
    assert well("hal-joints", f"[JOINT_0]\n# HOME = {odd}\n".encode()).key != "read"
    for line in (f"setp genhexkins.base.0.x {odd}", f"genhexkins.base.0.x={odd}",
                 f"setp genhexkins.base.{odd}.x 1", f"setp genhexkins.screw-lead {odd}"):
        well("hal", READERS["hal"].seeds[0] + f"{line}\n".encode())


@pytest.mark.parametrize("number", ["1", "10", "-1", "", "٣", "99999999999", "00", " 0", "0x0"])
def test_a_joint_out_of_turn_is_refused(number):
    assert well("hal-joints", f"[JOINT_{number}]\n# HOME = 1\n".encode()).key != "read"
    for twice in ("[JOINT_0]\n# HOME = 1\n" * 2, "[JOINT_0]\n# HOME = 1\n[JOINT_2]\n# HOME = 1\n"):
        assert well("hal-joints", twice.encode()).key != "read"


@NEAR
@given(st.lists(st.tuples(
    st.sampled_from(["# HOME = ", "# HOME_OFFSET = present ", "# HOME_OFFSET = present * 2 + ",
                     "[JOINT_1]", "[JOINT_0]", "[JOINT_٣]", "# SCALE = present / "]),
    st.one_of(NUMBERS.map(str), st.text(max_size=6)))))
def test_joint_lines_that_are_nearly_right(lines):
    data = "\n".join(["[JOINT_0]", *("".join(line) for line in lines)])
    well("hal-joints", data.encode("utf-8", "surrogatepass"))
