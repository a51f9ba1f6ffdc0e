"""``ppmcal diagnose`` on campaigns as people bring them: in order, incomplete, in wrong units."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import Run, number, ppmcal, rows, write_csv
from scipy.stats import binom
from test_diagnose_commands import (
    BACKLASH,
    CONFIGS,
    DATA,
    diagnose,
    drop,
    effect,
    found_in,
    named,
    simulate,
    value,
)

from ppmcal.dataset import Dataset
from ppmcal.files import read_campaign, read_mechanism
from ppmcal.fit import OUTLIER, Fit
from ppmcal.identify import identify
from ppmcal.problem import Problem

SIDECAR = "s/measurements.yaml"
LOADED: dict[str, Any] = {"payload": [0, 15], "temperature": {"mean": 24, "swing": 6}}
SINGLE: dict[str, Any] = {"approach": "one", "conditions": {"temperature": {"mean": 24,
                                                                            "swing": 6}}}


def edit(folder: Path, **changes: Any) -> None:
    """Change the sidecar as its owner would."""
    file = folder / SIDECAR
    file.write_text(yaml.safe_dump(yaml.safe_load(file.read_text()) | changes))


def not_used(folder: Path, out: str = "d") -> dict[int, str]:
    """Return row number -> reason of the rows that were not used."""
    return {int(r["row"]): r["reason"] for r in rows(folder / out / "residuals.csv")
            if r["reason"]}


def data_of(folder: Path) -> Dataset:
    (data,) = read_campaign([folder / DATA], read_mechanism(folder / "m.yaml"))
    return data


def problem_of(folder: Path) -> Problem:
    data = data_of(folder)
    mechanism = read_mechanism(folder / "m.yaml")
    return Problem(mechanism, (data,), mechanism.free)


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
    assert not_used(tmp_path) == {1: "dir_leg1 is not known here", 2: "dir_leg1 is not known here"}


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
    out = {n: r for n, r in not_used(tmp_path).items() if "temperature" in r}
    assert out == dict.fromkeys((51, 52, 53), "temperature is not known here")
    assert run.code == 1 and found["verdict"] in ("none", "weak")
    assert any("rows left out" in f for f in found["findings"])
    assert "leg_thermal" not in {e["kind"] for e in found["not_testable"]}


def test_a_temperature_that_most_rows_lack(tmp_path: Path) -> None:
    simulate(tmp_path, "6-UPS", [], count=120, **SINGLE)
    emptied(tmp_path, "temperature", range(20, 110))
    run, found = diagnose(tmp_path)
    assert not any("temperature" in r for r in not_used(tmp_path).values())
    assert run.code == 1
    assert any("temperature is known in 30 of 120 rows only: not used" in f
               for f in found["findings"])
    assert "leg_thermal" in {e["kind"] for e in found["not_testable"]}
    assert not found["effects"]
    assert len(not_used(tmp_path)) <= 3



# --- rows left out --------------------------------------------------------------------------------


def repeated(folder: Path, seed: int, **changes: Any) -> list[int]:
    """Simulate 60 poses measured twice each; return the places of the first rows at their pose."""
    simulate(folder, "3-RPR", [], **({"count": 60, "repeats": 2, "seed": seed} | SINGLE | changes))
    poses = [r["pose"] for r in rows(folder / DATA)]
    return [n for n in range(len(poses)) if n == 0 or poses[n] != poses[n - 1]]


@pytest.mark.parametrize("how", ["by some sigma", "by a part of the move"])
def test_first_rows_that_fall_short_have_a_pattern(tmp_path: Path, how: str) -> None:
    rng = np.random.default_rng(6)
    picked = rng.permutation(repeated(tmp_path, 6)[1:])[:11]
    table = rows(tmp_path / DATA)
    for n in picked:
        for c in "xy":
            move = number(table[n], c) - number(table[n - 1], c)
            short = 0.02 * move if "part" in how else 0.005 * rng.uniform(15.0, 30.0)
            table[n][c] = str(number(table[n], c) - short)
    write_csv(tmp_path / DATA, table)
    run, found = diagnose(tmp_path)
    assert set(picked + 1) <= set(not_used(tmp_path))
    assert run.code == 1 and found["verdict"] == "unnamed"
    assert any("left out as outliers" in f and "are the first row at their pose" in f
               for f in found["findings"])
    assert "first row at their pose" in found["remainder"]["follows"]
    assert found["remainder"]["p_value"] < 0.01


@pytest.mark.parametrize("seed", [4, 5, 6])
def test_gross_errors_have_no_pattern(tmp_path: Path, seed: int) -> None:
    repeated(tmp_path, seed, noise={"outliers": 0.1})
    _, found = diagnose(tmp_path)
    assert len(not_used(tmp_path)) >= 6
    assert found["verdict"] == "none" and found["remainder"]["follows"] is None
    assert not any("pattern" in f for f in found["findings"])


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Fit:
    """A fit of 120 rows, two at each pose, with directions, temperature and loads."""
    folder = tmp_path_factory.mktemp("plain")
    repeated(folder, 3, approach="both", repeats=1, conditions=LOADED, count=30)
    return identify(problem_of(folder))


def without(fit: Fit, gone: np.ndarray) -> Fit:
    """Return the fit as if the rows ``gone`` had been left out as outliers."""
    return replace(fit, keep=(~gone,), reasons=({int(n): f"{OUTLIER}: test" for n in
                                                 np.flatnonzero(gone)},))


@pytest.mark.parametrize("count", [4, 12, 30])
def test_chance_gives_a_pattern_as_rarely_as_told(plain: Fit, count: int) -> None:
    module = pytest.importorskip("ppmcal.diagnose.left_out")
    rng, rows_ = np.random.default_rng(count), len(plain.keep[0])
    found, p_values = 0, []
    for _ in range(300):
        gone = np.zeros(rows_, dtype=bool)
        gone[rng.permutation(rows_)[:count]] = True
        out = module.left_out(without(plain, gone))
        assert out.count == count and out.rows == rows_
        found += bool(out.follows)
        p_values.append(out.p_value)
    assert found <= binom.ppf(0.999, 300, module.LEVEL)
    assert np.mean(np.array(p_values) < 0.05) <= binom.ppf(0.999, 300, 0.05) / 300


@pytest.mark.parametrize("what", ["first", "leg2 moving +", "last third", "highest part by load"])
def test_a_pattern_is_told_as_what_it_is(plain: Fit, what: str) -> None:
    """Fifteen rows that have one thing in common, picked at random among those that have it."""
    module = pytest.importorskip("ppmcal.diagnose.left_out")
    data, n = plain.problem.datasets[0], len(plain.keep[0])
    has = {"first": np.r_[True, np.diff(data.groups) != 0],
           "leg2 moving +": data.columns["dir_leg2"] == 1.0,
           "last third": np.arange(n) >= 2 * n // 3,
           "highest part by load": data.columns["payload"] > 0.0}[what]
    gone = np.zeros(n, dtype=bool)
    gone[np.random.default_rng(1).permutation(np.flatnonzero(has))[:15]] = True
    out = module.left_out(without(plain, gone))
    assert out.suspicious and out.share == 1.0 and out.p_value < module.LEVEL
    assert what in out.follows
    assert out.sentence.startswith(f"15 rows of {n} left out")


def test_more_rows_than_gross_errors_explain(plain: Fit) -> None:
    module = pytest.importorskip("ppmcal.diagnose.left_out")
    n = len(plain.keep[0])
    gone = np.zeros(n, dtype=bool)
    gone[np.random.default_rng(2).permutation(n)[:n // 4]] = True
    out = module.left_out(without(plain, gone))
    assert out.too_many and "more than gross errors explain" in out.sentence
    nobody = module.left_out(without(plain, np.zeros(n, dtype=bool)))
    assert not nobody.suspicious and nobody.sentence == ""
