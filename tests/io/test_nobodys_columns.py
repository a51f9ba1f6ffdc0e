"""Columns that nobody needs: left alone with a note by every command that reads measurements."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from helpers.commands import ppmcal as run
from helpers.mistakes import SAMPLE

import ppmcal
from ppmcal.errors import BadInput

MACHINE = SAMPLE / "hexapod.yaml"


def with_columns(folder: Path, more: dict[str, str]) -> Path:
    """Write the sample's first rows with more columns."""
    with (SAMPLE / "measurements.csv").open(newline="", encoding="utf-8") as file:
        rows = [{**row, **more} for row in list(csv.DictReader(file))[:40]]
    with (folder / "run.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, rows[0].keys())
        writer.writeheader()
        writer.writerows(rows)
    (folder / "run.yaml").write_bytes((SAMPLE / "measurements.yaml").read_bytes())
    return folder / "run.csv"


STRANGE = {"pressure [bar]": "1.01", "operator": "Smith, J.", "Humidity (%)": "1e300"}


def test_they_are_left_alone_and_named(tmp_path: Path) -> None:
    path = with_columns(tmp_path, STRANGE)
    (data,) = ppmcal.read_data(MACHINE, path)
    (said,) = [f for f in data.findings if "nobody knows" in f]
    for name in ("pressure", "operator", "Humidity"):
        assert name in said
    # the line that it offers is one that works
    block = said[said.index("`") + 1:said.rindex("`")]
    with path.with_suffix(".yaml").open("a", encoding="utf-8") as sidecar:
        sidecar.write(f"\n{block}\n")
    assert not any("nobody" in f for (d,) in [ppmcal.read_data(MACHINE, path)] for f in d.findings)
    (bare,) = ppmcal.read_data(MACHINE, with_columns(tmp_path, {}))
    np.testing.assert_array_equal(data.position, bare.position)
    assert data.columns.keys() == bare.columns.keys()


@pytest.mark.slow
def test_check_identify_and_read_agree(tmp_path: Path) -> None:
    path = with_columns(tmp_path, STRANGE)
    for words in (("check", MACHINE, path), ("identify", MACHINE, path, "--out", tmp_path / "out"),
                  ("read", path, "--mechanism", MACHINE, "--out", tmp_path / "b.csv")):
        done = run(*words, cwd=tmp_path)
        assert done.code in (0, 1) and "operator" in done.out + done.err, done.err


@pytest.mark.parametrize("name", ["sigma_q [mm]", "q_leg9", "dir_leg9", "temprature", "payloads"])
def test_what_was_meant_to_be_one_of_ours_is_refused_by_all(tmp_path: Path, name: str) -> None:
    path = with_columns(tmp_path, {name: "1"})
    for read in (lambda: ppmcal.read_data(MACHINE, path), lambda: ppmcal.read(path, MACHINE)):
        with pytest.raises(BadInput, match=rf"unknown column '{name.split(' ')[0]}'.*"):
            read()


def test_words_where_numbers_belong_are_refused(tmp_path: Path) -> None:
    path = with_columns(tmp_path, {})
    path.write_text(path.read_text().replace("\n1,", "\n1,x", 1))
    with pytest.raises(BadInput, match="is not a number"):
        ppmcal.read_data(MACHINE, path)
