"""``ppmcal diagnose`` on campaigns as people bring them: in sequence, incomplete, in wrong units."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import rows, write_csv
from test_diagnose_commands import BACKLASH, DATA, diagnose, drop, named, simulate

from ppmcal.dataset import Dataset
from ppmcal.files import read_campaign, read_mechanism

SIDECAR = "s/measurements.yaml"
LOADED: dict[str, Any] = {"payload": [0, 15], "temperature": {"mean": 24, "swing": 6}}
SINGLE: dict[str, Any] = {"approach": "one", "conditions": {"temperature": {"mean": 24,
                                                                            "swing": 6}}}


def edit(folder: Path, **changes: Any) -> None:
    """Change the sidecar as its owner would."""
    file = folder / SIDECAR
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | changes))


def left_out(folder: Path, out: str = "d") -> dict[int, str]:
    """Return row number -> reason of the rows that were not used."""
    return {int(r["row"]): r["reason"] for r in rows(folder / out / "residuals.csv")
            if r["reason"]}


def data_of(folder: Path) -> Dataset:
    (data,) = read_campaign([folder / DATA], read_mechanism(folder / "m.yaml"))
    return data


# --- rows visited in order ------------------------------------------------------------------------


def in_sequence(folder: Path, effects: list[dict[str, Any]], **changes: Any) -> Path:
    """Simulate rows visited in order, whose file has no dir_ columns, only that it is so."""
    simulate(folder, "6-UPS", effects, **({"count": 30, "approach": "sequence",
                                           "conditions": LOADED} | changes))
    drop(folder, "dir_")
    edit(folder, approach="sequence")
    return folder


@pytest.mark.parametrize("seed", [4])
def test_backlash_in_a_sequence_is_named(tmp_path: Path, seed: int) -> None:
    """The direction of approach follows from the order, also where rows are held out."""
    _, found = diagnose(in_sequence(tmp_path, [BACKLASH], seed=seed))
    assert named(found) == {"backlash": {"leg3"}}
    (only,) = found["effects"]
    width = only["parameters"]["width"]
    assert abs(width["value"] - 0.03) < 4.0 * width["sigma"] < 0.015
    # nobody knows from where the first rows were approached: two loads at the first pose
    assert left_out(tmp_path) == {1: "dir_leg1 is not known here", 2: "dir_leg1 is not known here"}


@pytest.mark.parametrize("seed", [5])
def test_no_backlash_in_a_sequence_without(tmp_path: Path, seed: int) -> None:
    _, found = diagnose(in_sequence(tmp_path, [], seed=seed))
    assert "backlash" not in named(found)
    assert found["verdict"] in ("none", "weak")


def test_the_same_with_the_directions_written_down(tmp_path: Path) -> None:
    """What the order tells is what the simulator had written into the columns."""
    simulate(tmp_path, "6-UPS", [BACKLASH], count=20, approach="sequence", conditions=LOADED)
    written = data_of(tmp_path).columns
    drop(tmp_path, "dir_")
    edit(tmp_path, approach="sequence")
    data = data_of(tmp_path)
    told = data.directions()
    assert told is not None
    known = np.isfinite(told)
    assert not known[:2].any() and known[2:].all()
    np.testing.assert_array_equal(told[2:], np.stack(
        [written[f"dir_leg{i}"] for i in range(1, 7)], axis=1)[2:])


@pytest.mark.parametrize("seed", range(5))
def test_rows_keep_their_direction_in_any_subset(tmp_path_factory: pytest.TempPathFactory,
                                                 seed: int) -> None:
    folder = in_sequence(tmp_path_factory.mktemp("s"), [], count=12)
    data, rng = data_of(folder), np.random.default_rng(seed)
    whole = data.directions()
    assert whole is not None
    mask = rng.random(len(data)) < 0.4
    np.testing.assert_array_equal(data.take(mask).directions(), whole[mask])
    order = rng.permutation(len(data))[:9]
    again = data.take(order).take(np.arange(3, 7))
    np.testing.assert_array_equal(again.directions(), whole[order[3:7]])


def test_a_joint_that_rests_for_long_at_the_start(tmp_path: Path) -> None:
    """Leg 2 stands still for 4 of 40 rows: these are not known, and nothing else goes."""
    in_sequence(tmp_path, [], count=40, approach="sequence",
                conditions={"temperature": {"mean": 24, "swing": 6}})
    data = data_of(tmp_path)
    q = data.q.copy()
    q[:4, 1] = q[0, 1]
    way = replace(data, q=q).directions()
    assert way is not None
    assert np.isnan(way[:4, 1]).all() and np.isfinite(way[4:, 1]).all()


# --- columns recorded in part ---------------------------------------------------------------------


def emptied(folder: Path, column: str, where: range) -> None:
    table = rows(folder / DATA)
    for n in where:
        table[n][column] = ""
    write_csv(folder / DATA, table)


def test_a_temperature_that_few_rows_lack(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=120, **SINGLE)
    emptied(tmp_path, "temperature", range(50, 53))
    run, found = diagnose(tmp_path)
    out = {n: r for n, r in left_out(tmp_path).items() if "temperature" in r}
    assert out == dict.fromkeys((51, 52, 53), "temperature is not known here")
    assert run.code == 1 and found["verdict"] in ("none", "weak")
    assert any("rows left out" in f for f in found["findings"])
    assert "leg_thermal" not in {e["kind"] for e in found["not_testable"]}


def test_a_temperature_that_most_rows_lack(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=120, **SINGLE)
    emptied(tmp_path, "temperature", range(20, 110))
    run, found = diagnose(tmp_path)
    assert not any("temperature" in r for r in left_out(tmp_path).values())
    assert run.code == 1
    assert any("temperature is known in 30 of 120 rows only: not used" in f
               for f in found["findings"])
    assert "leg_thermal" in {e["kind"] for e in found["not_testable"]}
    assert not found["effects"]
    assert len(left_out(tmp_path)) <= 3

