"""Rows copied are no repeats; honest repeats that read alike are none the fewer."""

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows, write_csv
from hypothesis import given, settings
from hypothesis import strategies as st

import ppmcal as face
from ppmcal.calibration.interpretation.copies import (
    REASON,
    chance_of_equal,
    count_among,
    known_rows,
    without_known,
)
from ppmcal.errors import BadInput
from ppmcal.kinematics.inverse import home_state
from ppmcal.model.dataset import Dataset
from ppmcal.model.same_rows import KEPT, last_digit, step_of

RNG = np.random.default_rng(3)
TIMES = 20


# --- how likely two readings agree --------------------------------------------------------------


@pytest.mark.parametrize("step", [0.01, 0.2, 1.0, 3.0, 30.0])
def test_the_chance_of_equal_readings_is_that_of_a_simulation(step):
    rng = np.random.default_rng(7)
    where = rng.uniform(0.0, 1e3 * step, 200_000)
    one, two = (np.round((where + rng.normal(size=where.size)) / step) for _ in range(2))
    share = np.mean(one == two)
    assert chance_of_equal(step, 1.0) == pytest.approx(share, abs=5.0 * math.sqrt(
        share * (1.0 - share) / where.size) + 1e-6)


def test_the_chance_is_smooth_where_its_formula_changes():
    assert chance_of_equal(1.99e-4, 1.0) == pytest.approx(chance_of_equal(2.01e-4, 1.0), rel=0.02)
    assert chance_of_equal(math.inf, 1.0) == chance_of_equal(1.0, 0.0) == 1.0
    assert chance_of_equal(0.0, 1.0) == 0.0


@settings(max_examples=80, deadline=None)
@given(st.sampled_from([1.0, 0.5, 0.01, 0.0125, 1e-4, 1e-5]), st.floats(-5e3, 5e3),
       st.sampled_from([1.0, 1e-3, 25.4e-3, 57.3]), st.integers(0, 10**6))
def test_the_step_of_readings_is_found_in_any_unit(step, begin, unit, seed):
    numbers = np.random.default_rng(seed).integers(-3000, 3000, 60)
    values = (np.round(begin / step) + numbers) * step * unit
    found = step_of(values)
    expected = np.gcd.reduce(np.diff(np.unique(numbers))) * step * unit
    assert found == pytest.approx(expected, rel=1e-3)


def test_numbers_of_all_digits_have_no_step():
    assert step_of(RNG.uniform(300.0, 900.0, 200)) < 1e-8
    assert step_of(np.array([37.25, 37.25])) == last_digit(37.25) == 0.01
    assert last_digit(0.0) == math.inf
    assert step_of(np.array([])) == math.inf


# --- files --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Return a folder with a machine and 40 poses, measured once; the true machine beside."""
    folder = tmp_path_factory.mktemp("bench")
    ppmcal("init", "3-RPR", "--out", folder / "mine.yaml", expect=0)
    ppmcal("simulate", folder / "mine.yaml", folder / "mine.scenario.yaml", "--seed", 4,
           "--out", folder / "simulated", expect=0)
    return folder


def written(folder, table, name="run", **changes):
    """Write a table beside a sidecar as the simulation's, with changes to it."""
    side = yaml.safe_load((folder / "simulated" / "measurements.yaml").read_text())
    side = {**side, "name": name, **changes}
    write_csv(folder / f"{name}.csv", table)
    (folder / f"{name}.yaml").write_text(yaml.safe_dump(side))
    return folder / f"{name}.csv"


def measured(folder):
    """Return the simulated rows."""
    return rows(folder / "simulated" / "measurements.csv")


def read(folder, path):
    """Return the data set of a file."""
    return face.read_data(folder / "mine.yaml", path)[0]


def copies(data):
    """Return the row numbers that were left out as copies."""
    return [row for row, reason in data.dropped if reason == REASON]


@pytest.mark.slow
def test_twenty_copies_are_one_row(bench, tmp_path):
    plain = measured(bench)
    path = written(bench, [r for r in plain for _ in range(TIMES)])
    once = written(bench, plain, "once")
    data = read(bench, path)
    assert len(data) == len(plain)
    assert len(copies(data)) == len(plain) * (TIMES - 1)
    assert any("a copy, not a repeat" in f for f in data.findings)
    one = ppmcal("identify", bench / "mine.yaml", once, "--out", tmp_path / "one", "--json").json
    many = ppmcal("identify", bench / "mine.yaml", path, "--out", tmp_path / "many", "--json",
                  expect=1).json
    assert any("copy" in f for f in many["findings"])
    for a, b in zip(one["parameters"], many["parameters"], strict=True):
        assert b["value"] == pytest.approx(a["value"], rel=1e-9, abs=1e-9)
        assert (b["sigma"] or 0.0) == pytest.approx(a["sigma"] or 0.0, rel=1e-9)
        assert b["status"] == a["status"]
    assert many["noise"]["sigma_ratio"] == pytest.approx(one["noise"]["sigma_ratio"])
    assert many["residual"]["holdout"]["position"]["rms"] == pytest.approx(
        one["residual"]["holdout"]["position"]["rms"])
    left = [r for r in rows(tmp_path / "many" / "residuals.csv") if r["reason"] == REASON]
    assert len(left) == len(plain) * (TIMES - 1)


def test_copies_at_other_times_in_any_place_are_copies_still(bench):
    plain = measured(bench)
    again = [{**r, "pose": str(900 + i), "time": str(9e4 + i)} for i, r in enumerate(plain[::3])]
    order = RNG.permutation(len(plain) + len(again))
    table = [(plain + again)[i] for i in order]
    found = copies(read(bench, written(bench, table)))
    assert len(found) == len(again)


def test_one_copied_row_is_found(bench):
    plain = measured(bench)
    assert copies(read(bench, written(bench, [*plain, plain[4]]))) == [len(plain) + 1]


def test_genuine_repeats_stay(bench, tmp_path):
    scenario = yaml.safe_load((bench / "mine.scenario.yaml").read_text())
    scenario["repeats"] = 4
    (bench / "four.scenario.yaml").write_text(yaml.safe_dump(scenario))
    ppmcal("simulate", bench / "mine.yaml", bench / "four.scenario.yaml", "--out", tmp_path / "s",
           expect=0)
    data = read(bench, tmp_path / "s" / "measurements.csv")
    assert not copies(data)
    assert data.chance < 1e-20


def test_a_stale_reading_under_another_load_is_not_called_a_copy(bench):
    plain = [{**r, "payload": "0"} for r in measured(bench)]
    table = [*plain, *({**r, "payload": "20"} for r in plain[:5])]
    assert not copies(read(bench, written(bench, table)))


def rounded(table, digits, rng, sigma, repeats):
    """Return repeats of poses with noise of their own, as an instrument with few digits shows."""
    return [{**r, **{c: f"{round(float(r[c]) + rng.normal() * sigma[c], digits[c]):.{digits[c]}f}"
                     for c in ("x", "y", "rz")}} for r in table for _ in range(repeats)]


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize(("step", "noise"), [(2, 0.01), (3, 0.01), (2, 0.003), (2, 0.02)])
def test_coarse_digits_of_honest_repeats_are_no_copies(bench, seed, step, noise):
    """A caliper's 0.01 mm, and noise between a third and twice its step."""
    rng = np.random.default_rng(seed)
    table = rounded(measured(bench), {"x": step, "y": step, "rz": step},
                    rng, {"x": noise, "y": noise, "rz": noise}, 5)
    instrument = {"kind": "pose", "sigma": {"position": noise, "rotation": noise}}
    found = copies(read(bench, written(bench, table, instrument=instrument)))
    assert not found


@pytest.mark.parametrize("seed", range(6))
def test_an_overstated_noise_makes_no_copies_of_honest_repeats(bench, seed):
    """Repeats scatter by a fifth of a step, the data sheet says five steps."""
    rng = np.random.default_rng(seed)
    table = rounded(measured(bench), {"x": 2, "y": 2, "rz": 2}, rng,
                    {"x": 0.002, "y": 0.002, "rz": 0.002}, 5)
    instrument = {"kind": "pose", "sigma": {"position": 0.05, "rotation": 0.05}}
    assert not copies(read(bench, written(bench, table, instrument=instrument)))


def test_repeats_that_always_agree_are_counted_once_however_coarse(bench):
    """Noise far below the step: what is left is the rounding, the same in all of them."""
    rng = np.random.default_rng(1)
    none = {"x": 0.0, "y": 0.0, "rz": 0.0}
    table = rounded(measured(bench), {"x": 2, "y": 2, "rz": 2}, rng, none, 3)
    data = read(bench, written(bench, table))
    assert len(data) == len(measured(bench))


# --- probes and calipers ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def printer(tmp_path_factory):
    """Return a folder with a delta printer, whose carriages stand at steps of 0.0125 mm."""
    folder = tmp_path_factory.mktemp("printer")
    ppmcal("init", "delta-linear", "--out", folder / "mine.yaml", expect=0)
    return folder


def touches(folder, count, repeats, rng, digits=2, sigma=0.01, height=None):
    """Return touches of a flat at random places, their heights in coarse digits."""
    mechanism = face.load(folder / "mine.yaml")
    home = 1e3 * home_state(mechanism).q
    table = []
    for _ in range(count):
        q = {f"q_{a}": round(float(h) + rng.uniform(-10, 10), 4)
             for a, h in zip(mechanism.actuators, home, strict=True)}
        for _ in range(repeats):
            value = rng.normal() * sigma if height is None else height
            table.append({**{k: f"{v:.4f}" for k, v in q.items()},
                          "height": f"{round(value, digits):.{digits}f}"})
    return table


SIDE = {"format": "ppmcal/dataset/1", "units": {"length": "mm", "angle": "deg"},
        "instrument": {"kind": "plane", "sigma": {"height": 0.01}}, "frame": "unknown",
        "target": "known"}


def of_probe(folder, table):
    """Return the data set of touches."""
    write_csv(folder / "touches.csv", table)
    (folder / "touches.yaml").write_text(yaml.safe_dump(SIDE))
    return read(folder, folder / "touches.csv")


@pytest.mark.parametrize("seed", range(6))
def test_a_coarse_probe_that_reads_the_same_twice_is_no_copy(printer, seed):
    rng = np.random.default_rng(seed)
    assert not copies(of_probe(printer, touches(printer, 20, 5, rng)))


@pytest.mark.parametrize("seed", range(3))
def test_touches_whose_joints_are_whole_steps_are_no_copies(printer, seed):
    """The joints are what was measured: a second touch may end at the same step."""
    rng = np.random.default_rng(seed)
    table = touches(printer, 20, 3, rng, height=0.0)
    for row in table:
        for name in [n for n in row if n.startswith("q_")]:
            row[name] = f"{round((float(row[name]) + rng.normal() * 0.004) / 0.0125) * 0.0125:.4f}"
    assert not copies(of_probe(printer, table))


# --- several files ------------------------------------------------------------------------------


def test_rows_that_stand_in_two_files_count_once(bench):
    plain = measured(bench)
    first, second = written(bench, plain[:12], "first"), written(bench, plain[5:], "second")
    one, two = face.read_data(bench / "mine.yaml", first, second)
    assert len(one) == 12
    assert len(two) == len(plain) - 12
    assert any("also in" in f and "count" in f for f in two.findings)


def test_a_file_given_twice_under_two_names_is_refused(bench):
    first = written(bench, measured(bench), "first")
    again = written(bench, measured(bench), "again")
    run = ppmcal("identify", bench / "mine.yaml", first, again, "--out", bench / "no", expect=2)
    assert "again.csv" in run.err and "only once" in " ".join(run.err.split())


@pytest.mark.slow
def test_diagnose_says_it_too_and_its_noise_is_that_of_rows_counted_once(bench, tmp_path):
    path = written(bench, [r for r in measured(bench) for _ in range(3)])
    found = ppmcal("diagnose", bench / "mine.yaml", path, "--out", tmp_path / "d", "--json").json
    assert any("a copy, not a repeat" in f for f in found["findings"])


# --- what the intervals are worth ---------------------------------------------------------------


@pytest.mark.long
def test_intervals_of_copied_rows_hold_what_they_say(bench, tmp_path):
    """Errors over sigma of many campaigns, each row copied six times: as wide as without copies."""
    pulls = []
    for seed in range(8):
        out = tmp_path / str(seed)
        ppmcal("simulate", bench / "mine.yaml", bench / "mine.scenario.yaml", "--seed", seed,
               "--out", out, expect=0)
        with (out / "measurements.csv").open() as file:
            head, *lines = csv.reader(file)
        with (out / "measurements.csv").open("w", newline="") as file:
            csv.writer(file).writerows([head, *(line for line in lines for _ in range(6))])
        found = ppmcal("identify", bench / "mine.yaml", out / "measurements.csv", "--holdout", 0,
                       "--out", out / "i", "--json").json
        truth = yaml.safe_load((out / "truth.json").read_text())["parameters"]
        pulls += [(p["value"] - truth[p["name"]]) / p["sigma"] for p in found["parameters"]
                  if p["status"] == "identified"]
    assert 0.85 < float(np.sqrt(np.mean(np.square(pulls)))) < 1.15


# --- copies that were written anew ----------------------------------------------------------------


def as_inches(row):
    lengths = {k: f"{float(row[k]) / 25.4:.6f}" for k in row if k in "xyz" or k.startswith("q_leg")}
    return {**row, **lengths}


@pytest.mark.parametrize(("change", "units"), [
    (lambda r: {k: f"{float(v):.3f}" if k in ("x", "y", "rz") else v for k, v in r.items()}, "mm"),
    (as_inches, "in")])
def test_a_copy_in_fewer_digits_or_other_units_counts_once(bench, change, units):
    plain = measured(bench)
    first = written(bench, plain, "first")
    side = yaml.safe_load((bench / "simulated" / "measurements.yaml").read_text())
    sigma = {**side["instrument"]["sigma"]}
    if units == "in":
        sigma["position"] /= 25.4
    table = [change(r) for r in plain[:30]] + [change({**r, "x": str(float(r["x"]) + 0.2)})
                                               for r in plain[:4]]
    path = written(bench, table, f"copy-{units}", units={"length": units, "angle": "deg"},
                   instrument={**side["instrument"], "sigma": sigma}, frame="unknown")
    _, second = face.read_data(bench / "mine.yaml", first, path)
    assert len(second) == 4
    assert any("within their digits" in f for f in second.findings)


# --- copies of what an earlier calibration was fitted to -----------------------------------------


@pytest.fixture(scope="module")
def calibrated(bench, tmp_path_factory):
    """Return a calibration of the bench's machine whose table is gone since."""
    folder = tmp_path_factory.mktemp("calibrated")
    path = written(bench, measured(bench), "gone")
    ppmcal("identify", bench / "mine.yaml", path, "--holdout", 0, "--out", folder / "i")
    path.unlink()
    return folder / "i"


def in_fewer_digits(row):
    return {k: f"{float(v):.3f}" if k in ("x", "y", "rz") else v for k, v in row.items()}


COPIES = [(dict, "mm"), (in_fewer_digits, "mm"), (as_inches, "in")]


def copy_of(bench, table, name, change, units):
    """Write rows as another program would: other line ends, digits, or units."""
    side = yaml.safe_load((bench / "simulated" / "measurements.yaml").read_text())
    sigma = {**side["instrument"]["sigma"]}
    if units == "in":
        sigma["position"] /= 25.4
    path = written(bench, [change(r) for r in table], name,
                   units={"length": units, "angle": "deg"},
                   instrument={**side["instrument"], "sigma": sigma}, frame="unknown")
    path.write_bytes(path.read_bytes().replace(b"\r\n", b"\n").replace(b"\n", b"\r\n") + b"\r\n")
    return path


def other_rows(bench, folder, seed, count):
    """Return rows of another day of the same machine."""
    ppmcal("simulate", bench / "mine.yaml", bench / "mine.scenario.yaml", "--seed", seed,
           "--out", folder / "other", expect=0)
    return rows(folder / "other" / "measurements.csv")[:count]


@pytest.mark.slow_cases("dict-mm")
@pytest.mark.parametrize(("change", "units"), COPIES)
def test_a_copy_is_not_carried_on(bench, calibrated, tmp_path, change, units):
    path = copy_of(bench, measured(bench), "kept", change, units)
    run = ppmcal("identify", bench / "mine.yaml", path, "--start", calibrated, "--keep",
                 "--out", tmp_path / "no", expect=2)
    assert "is in that calibration already" in " ".join(run.err.split())


@pytest.mark.long
@pytest.mark.parametrize(("change", "units"), COPIES)
def test_a_copy_is_no_test_of_a_calibration(bench, calibrated, tmp_path, change, units):
    plain, new = measured(bench), other_rows(bench, tmp_path, 11, 12)
    path = copy_of(bench, plain, "unseen", change, units)
    run = ppmcal("validate", calibrated, path, "--out", tmp_path / "v", "--json", expect=1)
    assert any("the model was fitted to these measurements" in f for f in run.json["findings"])
    path = copy_of(bench, new, "new", change, units)
    run = ppmcal("validate", calibrated, path, "--out", tmp_path / "w", "--json")
    assert not any("was fitted to" in f for f in run.json["findings"])
    path = copy_of(bench, [*new, *plain[:7]], "some", change, units)
    run = ppmcal("validate", calibrated, path, "--out", tmp_path / "u", "--json", expect=1)
    assert any("the model was fitted to 7 of these 19 rows" in f for f in run.json["findings"])


@pytest.mark.long
def test_only_new_rows_of_a_file_that_grew_are_carried_on(bench, calibrated, tmp_path):
    plain, new = measured(bench), other_rows(bench, tmp_path, 11, 20)
    grown = copy_of(bench, [*plain, *new], "grown", in_fewer_digits, "mm")
    alone = copy_of(bench, new, "alone", in_fewer_digits, "mm")
    first, second = (ppmcal("identify", bench / "mine.yaml", path, "--start", calibrated, "--keep",
                            "--holdout", 0, "--out", tmp_path / path.stem, "--json").json
                     for path in (grown, alone))
    assert any(f"{len(plain)} rows also in" in f for f in first["findings"])
    for a, b in zip(first["parameters"], second["parameters"], strict=True):
        assert a["value"] == pytest.approx(b["value"], rel=1e-9, abs=1e-9)
        assert a["sigma"] == b["sigma"] or a["sigma"] == pytest.approx(b["sigma"], rel=1e-6)
    # what was carried on is remembered too
    run = ppmcal("identify", bench / "mine.yaml", grown, "--start", tmp_path / "alone", "--keep",
                 "--out", tmp_path / "no", expect=2)
    assert "is in that calibration already" in " ".join(run.err.split())


@pytest.mark.slow
def test_the_record_of_rows_is_bounded_and_still_tells_a_copy():
    rng = np.random.default_rng(5)
    q, pose = rng.uniform(0.3, 0.9, (30_000, 3)), np.zeros((30_000, 6))
    pose[:, :2] = rng.uniform(-0.2, 0.2, (30_000, 2))
    data = replace(Dataset.of_poses("day", q, pose, (1e-5, 1e-4), True), chance=1e-9)
    known = known_rows(data, ("a", "b", "c"))
    assert len(known.table) == KEPT and not known.whole
    assert count_among(data, ("a", "b", "c"), [known]) == (KEPT, True)
    other = replace(data, position=data.position + 1e-5)
    assert count_among(other, ("a", "b", "c"), [known]) == (0, False)
    with pytest.raises(BadInput, match="in that calibration already"):
        without_known([data], ("a", "b", "c"), [known], "i")


@pytest.mark.parametrize(("kind", "height"), [("fewer", None), ("inches", None), ("inches", 0.0)])
def test_copied_heights_are_told_within_their_digits(printer, kind, height):
    table = touches(printer, 40, 1, np.random.default_rng(2), digits=4, height=height)
    data = of_probe(printer, table)
    known = known_rows(data, face.load(printer / "mine.yaml").actuators)
    digits, factor, units = (2, 1.0, "mm") if kind == "fewer" else (6, 25.4, "in")
    again = [{k: f"{float(v) / factor:.{digits if k == 'height' or factor > 1 else 4}f}"
              for k, v in r.items()} for r in table]
    write_csv(printer / "again.csv", again)
    (printer / "again.yaml").write_text(yaml.safe_dump({
        **SIDE, "units": {"length": units, "angle": "deg"},
        "instrument": {"kind": "plane", "sigma": {"height": 0.01 / factor}}}))
    copy = read(printer, printer / "again.csv")
    assert count_among(copy, face.load(printer / "mine.yaml").actuators, [known]) == (40, False)
    with pytest.raises(BadInput, match="within its digits"):
        face.read_data(printer / "mine.yaml", printer / "touches.csv", printer / "again.csv")


@pytest.mark.parametrize("seed", range(6))
def test_honest_heights_of_another_day_are_no_copies(printer, seed):
    """The same places, probed again, in coarse digits."""
    rng = np.random.default_rng(seed)
    table = touches(printer, 40, 1, rng)
    again = [{**r, "height": f"{rng.normal() * 0.01:.2f}"} for r in table]
    actuators = face.load(printer / "mine.yaml").actuators
    known = known_rows(of_probe(printer, table), actuators)
    assert count_among(of_probe(printer, again), actuators, [known]) == (0, False)


@pytest.mark.parametrize("lines", [["a,b"], ["1,2", "1"], ["1e999,1"], [""], ["nan,nan"], []])
@pytest.mark.slow
def test_rows_in_a_record_that_are_none_do_no_harm(bench, calibrated, tmp_path, lines):
    record = json.loads((calibrated / "identification.json").read_text())
    record["known_rows"][0] |= {"rows": lines, "columns": ["x", "y"]}
    for name in ("identified.yaml", "identification.json"):
        (tmp_path / name).write_text((calibrated / name).read_text())
    (tmp_path / "identification.json").write_text(json.dumps(record))
    path = written(bench, measured(bench), "harmless")
    run = ppmcal("validate", tmp_path, path, "--out", tmp_path / "v")
    assert run.code in (0, 1) and "Traceback" not in run.err
    run = ppmcal("identify", bench / "mine.yaml", path, "--start", tmp_path, "--keep",
                 "--out", tmp_path / "i")
    assert run.code in (0, 1, 2) and "Traceback" not in run.err
