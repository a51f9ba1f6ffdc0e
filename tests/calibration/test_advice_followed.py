"""Advice on columns that are read wrongly, followed word for word: the file is taken then."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from helpers.bodies import machine, measured, wide
from helpers.commands import ppmcal
from helpers.mistakes import MACHINE, scaled, session

LEGS = [f"q_leg{i}" for i in range(1, 7)]


def followed(path: Path, said: str) -> None:
    """Do to a file and its sidecar what an error says."""
    text = " ".join(said.split())
    table, side = path.read_text(), path.with_suffix(".yaml")
    changes = re.findall(r"`([^`]+)` for `([^`]+)`", text)
    for new, old in changes:
        assert table.count(old) == 1, old
        table = table.replace(old, new)
    path.write_text(table)
    blocks = re.findall(r"`(read: [^`]+)`", text)
    assert changes or blocks
    if blocks:
        content = yaml.safe_load(side.read_text())
        content["read"] = yaml.safe_load(blocks[-1])["read"]
        side.write_text(yaml.safe_dump(content))


@pytest.mark.slow
@pytest.mark.parametrize("spelt", ["{name}_{axis} [mm]", "{name}_{axis} (mm)"])
def test_a_unit_in_the_header_is_corrected_there(tmp_path: Path, spelt: str) -> None:
    """The sidecar has no say against a header; lines for it would be refused."""
    machine(tmp_path)
    seen = measured(4, names=("T1", "T2", "T3"))
    path = wide(tmp_path, replace(seen, marks={**seen.marks, "T1": seen.marks["T1"] / 10.0}),
                spelt=spelt)
    run = ppmcal("identify", "bench.yaml", path, "--out", "i", cwd=tmp_path, expect=3)
    words = " ".join((run.out + run.err).split())
    assert "target T1: x and y are in cm, not mm" in words
    assert f"`{spelt.format(name='T1', axis='x').replace('mm', 'cm')}` for " in words
    assert "units: {T1_x" not in words
    followed(path, run.out + run.err)
    ppmcal("identify", "bench.yaml", path, "--out", "i", cwd=tmp_path, expect=0)


@pytest.mark.slow
@pytest.mark.parametrize(("said", "names", "words"), [
    ({"q_*": "cm"}, LEGS, "are in inches, not cm"),
    ({"q_*": "mm"}, LEGS[1:2], "q_leg2 is in inches, not mm")])
def test_a_pattern_that_is_wrong_is_not_contradicted(
        tmp_path: Path, said: dict[str, str], names: list[str], words: str) -> None:
    """Its columns would be declared twice; and the unit that is wrong is the one that it says."""
    path = session(tmp_path, scaled(tuple(names), 1.0 / 25.4))
    side = path.with_suffix(".yaml")
    side.write_text(yaml.safe_dump({**yaml.safe_load(side.read_text()), "read": {"units": said}}))
    run = ppmcal("identify", MACHINE, path, "--out", "i", cwd=tmp_path, expect=3)
    assert words in " ".join((run.out + run.err).split())
    followed(path, run.out + run.err)
    ppmcal("check", MACHINE, path, cwd=tmp_path, expect=0)


@pytest.mark.slow
def test_a_thermometer_in_kelvin_under_celsius(tmp_path: Path) -> None:
    """Header and values do not agree: the header is what is to be changed."""
    def warm(rows: list[dict[str, float]]) -> None:
        for n, row in enumerate(rows):
            row["temperature [C]"] = 294.0 + 0.01 * n

    path = session(tmp_path, warm)
    run = ppmcal("check", MACHINE, path, cwd=tmp_path, expect=1)
    assert "`temperature [K]` for `temperature [C]`" in " ".join(run.out.split())
    followed(path, run.out)
    ppmcal("check", MACHINE, path, cwd=tmp_path, expect=0)
