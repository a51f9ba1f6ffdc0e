"""Time grows no faster than an input: a piece repeated as often as a line takes is read at once."""

import pytest

from fuzz.judge import judged
from fuzz.readers import readers
from ppmcal.wording import collapse_similar

LONG = 120_000
"""Bytes: a line may have 200,000, and a cell what the csv module takes."""
HEAD = b"pose,q_leg1,q_leg2,q_leg3,x,y,rz\n"
RUNS = {
    "a number that ends in a letter": ("csv", HEAD + b"1,", b"9", b"x,3,4,5,6,7\n"),
    "spaces within a cell": ("csv", HEAD + b"1,2", b" ", b"3,4,5,6,7,8\n"),
    "a number in a list of points": ("foreign", b"P1 1.0 2.0 ", b"9", b"x\nP2 2 3 4\n"),
    "a unit": ("foreign", b"a;x;y;z\na;(", b" ", b"x;mm;mm\nP;1;2;3\n"),
    "marks at the end of a row": ("foreign", b"name;x [mm];y [mm];z [mm]\nA;1;2;3", b";", b"\n"),
    "a time": ("foreign", b"time,x,y,z\n2026-01-01T10:10:10", b" ", b"x,1,2,3\n"),
    "a name in a log": ("foreign", b"stepper: ", b"stepper_", b"\n"),
    "blank lines of a log": ("foreign", b"Recv: x\n", b"\n", b"stepper: a:x"),
    "a value of printer.cfg": ("klipper", b"[printer]\nkinematics: delta\n[stepper_a]\n"
                               b"[printer]\ndelta_radius: ", b"9", b"x\n"),
    "spaces in printer.cfg": ("klipper", b"[printer]\n", b" ", b"b\n"),
    "a key of printer.cfg": ("klipper", b"[printer]\na", b" ", b"b\n"),
    "a remark in printer.cfg": ("printer", b"[printer]\n#key: ", b"9", b"x\n"),
    "a touch": ("klipper-log", b"probe at ", b"9", b"\n"),
    "lists of a command": ("reprap", b"M665 L", b"11:", b".:\n"),
    "a number of a command": ("reprap", b"M665 L", b"1", b"..\n"),
    "a field of a height map": ("heightmap", b"RepRapFirmware height map file v2\n", b"9",
                                b"9" * 50_000 + b"\n1\n1\n1\n"),
    "a pin": ("hal", b"setp genhexkins.base.0.x ", b"9", b"x\n"),
    "the home of a joint": ("hal-joints", b"[JOINT_0]\n# HOME = ", b"9", b"x\n"),
    "a joint table": ("triplets", b"0 0.1 ", b"9", b"x\n"),
    "brackets in YAML": ("yaml", b"a: ", b"[", b"]\n"),
    "spaces in YAML": ("yaml", b"a:\n", b" ", b"\tb: 1\n"),
    "digits in YAML": ("yaml", b"a: ", b"9", b"x\n"),
    "digits in JSON": ("record-plan", b'{"format": ', b"9", b"}"),
    "brackets in JSON": ("record-plan", b'{"format": ', b"[", b"]}"),
}


@pytest.mark.parametrize(("name", "before", "piece", "after"), RUNS.values(), ids=RUNS)
def test_a_long_run_is_read_or_refused_soon(name, before, piece, after):
    outcome = judged(readers()[name].read, before + piece * (LONG // len(piece)) + after)
    assert not outcome.fault, f"{outcome.fault}\n{outcome.detail}"


def test_blank_lines_of_a_configuration_cost_no_more_than_others(tmp_path):
    from ppmcal.controllers.reprap.controller import _PROBE

    assert not judged(lambda data: _PROBE.findall(data.decode()), b"\n" * 2_000_000 + b"x").fault


def test_sentences_of_one_kind_are_counted_whatever_stands_in_them():
    lines = [f"file '{i} a': row {i}, column x{i}: {'y' * LONG} is odd" for i in range(5)]
    assert not judged(lambda _: collapse_similar(lines, "x.csv"), b"").fault
    assert collapse_similar(lines, "x.csv")[0].count("likewise") == 1
    assert len(collapse_similar([*lines[:2], "another"], "x.csv")) == 3
