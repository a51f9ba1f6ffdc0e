"""Calibrations carried on with new data, and what changed between two of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal, rows
from helpers.sessions import BOX, CONFIGS, POSITION, Array, drawn, machine, session

from ppmcal import algebra as cga
from ppmcal.calibration.fit.fit_result import Fit, FitOptions, posterior, prediction_covariance
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.noise_estimate import noise_check, with_noise
from ppmcal.calibration.fit.prior_information import Posterior
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.sessions.change_detection import Comparison, between, posterior_of
from ppmcal.calibration.sessions.common_misfit import noise_between
from ppmcal.calibration.sessions.joint_fit import fitted_together
from ppmcal.calibration.validation.summary import rank_of
from ppmcal.errors import BadInput
from ppmcal.io.results.comparison import ComparisonRecord, noise_sentence
from ppmcal.kinematics.closure import Model
from ppmcal.kinematics.forward import forward
from ppmcal.kinematics.inverse import inverse
from ppmcal.kinematics.partial_pose import pose_motor
from ppmcal.model.dataset import Dataset
from ppmcal.model.mechanism import Mechanism

OPTIONS = FitOptions(robust=False)


def fitted(mechanism: Mechanism, *data: Dataset, before: Posterior | None = None,
           options: FitOptions = OPTIONS) -> Fit:
    problem = Problem(mechanism, data, mechanism.free,
                      earlier=before.data() if before else None)
    fit = identify(problem, options)
    assert fit.converged
    return fit


def known(fit: Fit) -> Posterior:
    """Return what a file would hold of a fit."""
    return posterior_of(fit, {fit.problem.datasets[0].name: "x.csv"})


def sigmas(fit: Fit) -> Array:
    return np.sqrt(np.diagonal(posterior(fit))[:len(fit.problem.free)])


@pytest.mark.slow
@pytest.mark.parametrize("name", list(BOX))
def test_carrying_on_is_fitting_everything_at_once(name: str) -> None:
    """A then B, or A then B then C, give values and uncertainties of A, B and C in one fit."""
    mechanism, rng = machine(name), np.random.default_rng(5)
    g = drawn(mechanism, rng)
    data = [session(mechanism, name, g, rng, label=label) for label in "abc"]
    whole = fitted(mechanism, *data)
    step = fitted(mechanism, data[0])
    for d in data[1:]:
        step = fitted(mechanism, d, before=known(step))
    free = list(mechanism.free)
    apart = np.abs(step.state.g[free] - whole.state.g[free]) / sigmas(whole)
    assert apart.max() < 0.1
    assert sigmas(step) == pytest.approx(sigmas(whole), rel=0.02)
    alone = fitted(mechanism, data[2])
    assert np.mean(sigmas(step) / sigmas(alone)) < 0.9


@pytest.mark.slow
def test_carrying_on_without_tolerances() -> None:
    """With a flat prior only what the old data saw is kept."""
    mechanism, rng = machine("3-RPR"), np.random.default_rng(6)
    g, flat = drawn(mechanism, rng), FitOptions("flat", robust=False)
    data = [session(mechanism, "3-RPR", g, rng, label=label) for label in "ab"]
    whole = fitted(mechanism, *data, options=flat)
    first = known(fitted(mechanism, data[0], options=flat))
    step = fitted(replace_values(mechanism, first), data[1], before=first, options=flat)
    probe = session(mechanism, "3-RPR", g, rng, 20).q
    apart = []
    for fit in (whole, step):
        at = cga.translation(forward(Model(mechanism, fit.state.g), probe).pose)
        apart.append(np.linalg.norm(at[:, None] - at[None], axis=-1))
    # as many directions as the data know, no more, and as well known
    assert first.data().right.size == 9
    assert (rank_of(step)[1], rank_of(whole)[1]) == (9 + 3, 9 + 6)
    both = [np.sqrt(np.diagonal(prediction_covariance(f))) for f in (whole, step)]
    count = len(mechanism.free)
    seen = np.isfinite(np.diagonal(posterior(whole))[:count])
    assert both[1][:count][seen] == pytest.approx(both[0][:count][seen], rel=0.05)
    # frames are free, so only distances compare
    assert np.max(np.abs(apart[0] - apart[1])) < 0.3 * POSITION
    alone = fitted(mechanism, data[1], options=flat)
    at = cga.translation(forward(Model(mechanism, alone.state.g), probe).pose)
    assert np.max(np.abs(np.linalg.norm(at[:, None] - at[None], axis=-1) - apart[0])) > POSITION


def campaigns(count: int, change: float, where: str = "leg2.offset"
              ) -> list[tuple[Comparison, float]]:
    """Return comparisons of two sessions of fresh machines, and the change between them, SI."""
    mechanism = machine("3-RPR")
    out = []
    for seed in range(count):
        rng = np.random.default_rng([17, seed])
        g = drawn(mechanism, rng)
        h = g.copy()
        h[mechanism.names.index(where)] += change
        old, new = (known(fitted(mechanism, session(mechanism, "3-RPR", v, rng, 25, label)))
                    for v, label in ((g, "a"), (h, "b")))
        volume = {c: (at - half, at + half) for c, at, half in zip(
            ("x", "y", "rz"), (mechanism.home_pose[[0, 1, 5]]), (0.05, 0.05, 0.1), strict=True)}
        found, notes = between(replace_values(mechanism, new), old, new, volume, rng)
        assert not notes
        out.append((found, change))
    return out


def replace_values(mechanism: Mechanism, found: Posterior) -> Mechanism:
    g = mechanism.values.copy()
    g[list(found.places)] = found.value
    return mechanism.with_values(g)


@pytest.mark.long
def test_nothing_changed_is_uniform() -> None:
    """p-values of unchanged machines are uniform, single ones too, and differences have sigma."""
    found = [c for c, _ in campaigns(25, 0.0)]
    p = np.array([c.p_value for c in found])
    assert abs(p.mean() - 0.5) < 3.5 / np.sqrt(12 * p.size)
    assert np.mean(p < 0.1) < 0.1 + 3.0 * np.sqrt(0.09 / p.size)
    alone = np.stack([c.alone for c in found])
    assert abs(alone.mean() - 0.5) < 0.08
    assert sum(c.changed for c in found) <= 2
    seen = found[0].sigma > 1e-9
    z = np.stack([(c.new - c.old)[seen] / c.sigma[seen] for c in found])
    assert np.sqrt(np.mean(z**2)) == pytest.approx(1.0, abs=0.08)
    apart = np.array([[m.position_rms / m.position_chance, m.rotation_rms / m.rotation_chance]
                      for m in (c.pose_difference for c in found) if m])
    assert len(apart) == len(found)
    assert np.mean(apart**2, axis=0) == pytest.approx([1.0, 1.0], abs=0.3)


@pytest.mark.slow
def test_a_change_shows_at_the_platform_beside_what_noise_makes() -> None:
    for found, _ in campaigns(2, 1e-3):
        moved = found.pose_difference
        assert moved and moved.position_rms > 4.0 * moved.position_chance > 0.0


@pytest.mark.long
def test_a_change_is_named_with_its_interval() -> None:
    """One offset moved between the sessions: it is named, alone or among those as good."""
    found = campaigns(12, 1.5e-4)
    named = hit = total = 0
    for c, change in found:
        for one in c.changes:
            named += one.name == "leg2.offset" or "leg2.offset" in one.instead
            if one.name == "leg2.offset" and len(c.changes) == 1:
                (part,) = one.parts
                total += 1
                hit += abs(part.value - change) < 1.96 * part.sigma
    assert named >= 11
    assert total >= 6 and hit >= 0.8 * total


def noisy(fit: Fit, options: FitOptions) -> Posterior:
    """Return what a file would hold of a fit with the noise that its rows show."""
    return known(with_noise(fit, noise_check(fit).inflation, options))


def in_both(whole: Mechanism, data: list[Dataset], poorer: int, without: str) -> Comparison:
    """Return the comparison of two sessions, one fitted ``without`` some of the parameters."""
    options = FitOptions()
    poor = whole.with_free([whole.names[p] for p in whole.free if without not in whole.names[p]])
    own = [noisy(identify(Problem(m, (d,), m.free), options), options) for m, d in zip(
        (poor, whole) if poorer == 0 else (whole, poor), data, strict=True)]
    with pytest.raises(BadInput, match="had different parameters free"):
        between(whole, own[0], own[1], {}, np.random.default_rng(0))
    old, new = (identify(Problem(whole, (d,), whole.free), options) for d in data)
    first, second = fitted_together(old, new, (own[0], own[1]), options)
    at = whole.values.copy()
    at[list(second.places)] = second.estimate(whole)
    return between(whole.with_values(at), first, second, {}, np.random.default_rng(0))[0]


@pytest.mark.long
def test_what_only_one_calibration_could_fit_is_no_change() -> None:
    """Nothing changed; one fit had the platform's joints free, the other one held them."""
    whole = machine("3-RPR")
    chances = []
    for seed in range(4):
        rng = np.random.default_rng([31, seed])
        g = drawn(whole, rng)
        data = [session(whole, "3-RPR", g, rng, 25, label) for label in "ab"]
        one, two = (in_both(whole, data, poorer, ".platform.") for poorer in (0, 1))
        # which of the two held them does not matter, as all rows are there
        assert one.p_value == pytest.approx(two.p_value, rel=1e-3)
        assert "leg1.platform.point.radius" in one.names
        chances.append(one.p_value)
    assert min(chances) > 1e-3 and np.mean(chances) > 0.2


def worn(whole: Mechanism, name: str, g: Array, h: Array, rng: np.random.Generator, size: float
         ) -> list[Dataset]:
    """Measure two sessions of machines ``g`` and ``h``, with the same worn stretch of each drive.

    The drives are ``size`` off within it, unit of q, which no model here knows.
    """
    out = []
    low = None
    for label, v in (("a", g), ("b", h)):
        data = session(whole, name, v, rng, 30, label)
        if low is None:
            low, travel = data.q.min(axis=0), np.ptp(data.q, axis=0)
            low = low + travel * rng.uniform(0.1, 0.7, low.size)
        inside = (data.q > low) & (data.q < low + 0.25 * travel)
        out.append(replace(data, q=data.q - size * inside))
    return out


def worn_pairs(name: str, count: int, without: str, change: float) -> list[Comparison]:
    """Compare sessions with a worn place of ten times the noise, other poses and freedoms."""
    whole = machine(name)
    offset = next(p for p in whole.free if whole.names[p].endswith("offset"))
    found = []
    for seed in range(count):
        rng = np.random.default_rng([77, seed])
        g = drawn(whole, rng)
        h = g.copy()
        h[offset] += change
        found.append(in_both(whole, worn(whole, name, g, h, rng, 10.0 * POSITION), seed % 2,
                             without))
    return found


@pytest.mark.long
def test_what_a_model_misses_is_no_change_whatever_was_free() -> None:
    """Misfit of five times the noise scales the covariance: 5 % are told changed at 5 %."""
    p = np.array([c.p_value for c in worn_pairs("3-RPR", 20, ".platform.", 0.0)])
    # more than four of twenty come with a chance of 0.3 %
    assert np.sum(p < 0.05) <= 4 and p.min() > 1e-3


def worn_unlike(seed: int) -> Comparison:
    """Compare two sessions of a delta of which some drives are worn, by unlike much."""
    whole, options = machine("delta-linear"), FitOptions()
    rng = np.random.default_rng([77, seed])
    g = drawn(whole, rng)
    pose = whole.home_pose + rng.uniform(-1.0, 1.0, (200, 6)) * BOX["delta-linear"]
    q = inverse(Model(whole), pose_motor(pose)).q
    q = q[np.isfinite(q).all(axis=1)]
    travel = np.ptp(q, axis=0)
    low = q.min(axis=0) + travel * rng.uniform(0.1, 0.7, travel.size)
    size = 10.0 * POSITION * rng.uniform(0.5, 1.5, low.size) * (rng.uniform(size=low.size) < 0.7)
    if not size.any():
        size[0] = 10.0 * POSITION
    own = []
    for label in "ab":
        data = session(whole, "delta-linear", g, rng, 30, label)
        inside = (data.q > low) & (data.q < low + 0.25 * travel)
        data = replace(data, q=data.q - size * inside)
        own.append(noisy(identify(Problem(whole, (data,), whole.free), options), options))
    return between(replace_values(whole, own[1]), own[0], own[1], {}, rng)[0]


@pytest.mark.long
def test_rows_of_a_worn_place_that_one_fit_left_out_are_no_change() -> None:
    """Fits leave out rows of the worn places, or of the rest, or none: that is chance."""
    p = np.array([worn_unlike(seed).p_value for seed in range(20)])
    assert np.sum(p < 0.05) <= 4 and p.min() > 1e-3


@pytest.mark.slow
def test_rows_left_out_are_misfit_and_a_gross_one_is_no_more_than_that() -> None:
    """A row off by 300 or 30 000 sigma is one row; eight that are off alike are misfit."""
    mechanism, rng = machine("3-RPR"), np.random.default_rng(8)
    g = drawn(mechanism, rng)
    data = session(mechanism, "3-RPR", g, rng, 40)

    def noise(rows: int, size: float) -> float:
        position = data.position.copy()
        position[:rows, 0] += size * POSITION
        fit = identify(Problem(mechanism, (replace(data, position=position),), mechanism.free))
        assert fit.outliers[0][:rows].all()
        found = posterior_of(fit).session
        assert found
        return found.noise

    clean, gross, grosser = noise(0, 0.0), noise(1, 300.0), noise(1, 30000.0)
    assert grosser == pytest.approx(gross, rel=0.02) and clean < gross < 1.2 * clean
    assert noise(8, 12.0) > 1.5 * clean


@pytest.mark.long
def test_a_change_beyond_what_the_model_misses_is_found() -> None:
    found = worn_pairs("3-RPR", 8, ".platform.", 60.0 * POSITION)
    assert sum(c.changed for c in found) >= 7


@pytest.mark.slow
def test_the_same_calibration_twice_has_not_changed() -> None:
    mechanism, rng = machine("3-RPR"), np.random.default_rng(2)
    one = known(fitted(mechanism, session(mechanism, "3-RPR", drawn(mechanism, rng), rng)))
    found, notes = between(replace_values(mechanism, one), one, one,
                           {"x": (-0.02, 0.02), "y": (-0.02, 0.02), "rz": (-0.1, 0.1)}, rng)
    assert not found.changed and "x.csv is in both" in notes[0]
    assert np.max(np.abs(found.new - found.old)) == 0.0


# ---------------------------------------------------------------- the commands


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """3-RPR.yaml, three sessions A, B, C (leg 2 homed anew), and their calibrations idA, ..."""
    folder = tmp_path_factory.mktemp("sessions")
    ppmcal("init", "3-RPR", cwd=folder, expect=0)
    scenario = yaml.safe_load((folder / "3-RPR.scenario.yaml").read_text())
    scenario["errors"] = {"leg1.offset": 0.3, "leg3.base.point.x": -0.2, "leg2.offset": -0.1}
    for seed, label in enumerate("ABC"):
        if label == "C":
            scenario["errors"]["leg2.offset"] = 0.4
        scenario["seed"] = seed
        (folder / f"{label}.yaml").write_text(yaml.safe_dump(scenario))
        ppmcal("simulate", "3-RPR.yaml", f"{label}.yaml", "--out", label, "--quiet", cwd=folder,
               expect=0)
        ppmcal("identify", "3-RPR.yaml", f"{label}/measurements.csv", "--out", f"id{label}",
               "--quiet", cwd=folder, expect=0)
    return folder


@pytest.mark.slow
def test_compare_says_nothing_changed(sessions: Path, tmp_path: Path) -> None:
    run = ppmcal("compare", "idA", "idB", "--out", tmp_path / "o", cwd=sessions, expect=0)
    assert "nothing has changed" in run.out
    assert max(len(line) for line in run.out.splitlines()) <= 80
    entries = rows(tmp_path / "o" / "compare.csv")
    assert {e["status"] for e in entries} == {"unchanged"}
    found = json.loads((tmp_path / "o" / "comparison.json").read_text())
    assert found["verdict"] == "unchanged" and found["platform"]["poses"] > 100


@pytest.mark.slow
def test_compare_names_what_changed(sessions: Path, tmp_path: Path) -> None:
    run = ppmcal("compare", "idA/identified.yaml", "idC", "--out", tmp_path / "o", "--json",
                 cwd=sessions, expect=1)
    (change,) = run.json["changes"]
    assert "leg2.offset" in [change["name"], *change["instead"]]
    assert run.json["verdict"] == "changed" and run.json["p_value"] < 1e-6
    assert change["half"] == pytest.approx(1.96 * change["sigma"], rel=1e-3)    # stated noise holds


def test_an_interval_of_a_difference_is_of_the_noise_as_it_is_known() -> None:
    mechanism, rng = machine("3-RPR"), np.random.default_rng(2)
    g = drawn(mechanism, rng)
    one, two = (known(fitted(mechanism, session(mechanism, "3-RPR", g, rng, label=label)))
                for label in "ab")
    found, _ = between(mechanism, one, two, {}, rng)
    rough = replace(found, noise=replace(found.noise, degrees=8.0))
    entries = ComparisonRecord.of(rough, mechanism, {}).parameters
    assert {round(e.half / e.sigma, 2) for e in entries if e.half and e.sigma} == {2.31}


def test_it_is_said_what_is_how_many_times_what() -> None:
    record = ComparisonRecord.checked(
        {"noise": {"old": 5.64, "new": 1.0, "alike": 0.0, "same_poses": False}})
    assert noise_sentence(record) == (
        "After the fit the residuals scatter 5.64 times what the files state in the old "
        "calibration: noise, or model error. The test and every +- here allow for "
        "it; at the same poses in both, smaller changes would show.")


@pytest.mark.slow
def test_compare_fits_again_what_had_other_parameters_free(sessions: Path, tmp_path: Path) -> None:
    """--free differs: nothing has changed, and no change of what one of the two held is told."""
    ppmcal("identify", "3-RPR.yaml", "B/measurements.csv", "--free", "*.offset", "--quiet",
           "--out", "idOffsets", cwd=sessions)
    for old, new in (("idA", "idOffsets"), ("idOffsets", "idA")):
        run = ppmcal("compare", old, new, "--out", tmp_path / f"{old}-{new}", cwd=sessions,
                     expect=0)
        words = " ".join(run.out.split())
        assert "nothing has changed" in words and "Only one of the two had these free" in words
        entries = rows(tmp_path / f"{old}-{new}" / "compare.csv")
        assert {"leg1.base.point.x", "leg1.offset"} <= {e["name"] for e in entries}


@pytest.mark.slow
def test_compare_says_why_it_cannot(sessions: Path, tmp_path: Path) -> None:
    """The measurements have gone: a reason, no p-value, nothing said to have changed."""
    (tmp_path / "b.csv").write_bytes((sessions / "B" / "measurements.csv").read_bytes())
    (tmp_path / "b.yaml").write_bytes((sessions / "B" / "measurements.yaml").read_bytes())
    ppmcal("identify", sessions / "3-RPR.yaml", "b.csv", "--free", "*.offset", "--quiet",
           "--out", "id", cwd=tmp_path)
    (tmp_path / "b.csv").unlink()
    run = ppmcal("compare", sessions / "idA", "id", "--json", "--out", "o", cwd=tmp_path, expect=1)
    assert run.json["verdict"] == "not compared" and "p_value" not in run.json
    assert "is not there any more" in run.json["why_not"]
    assert "identify both with the same --free" in run.json["why_not"]
    run = ppmcal("compare", sessions / "idA", "id", "--out", "again", cwd=tmp_path, expect=1)
    assert "cannot be told" in " ".join(run.out.split()) and "p =" not in run.out
    assert rows(tmp_path / "again" / "compare.csv") == []


@pytest.mark.slow
def test_tables_are_read_where_they_are_unchanged(sessions: Path, tmp_path: Path) -> None:
    """A table of that name in the old folder is another one now; the right one is right here."""
    there, here = tmp_path / "there", tmp_path / "here"
    for folder in (there, here):
        folder.mkdir()
        for name in ("measurements.csv", "measurements.yaml"):
            (folder / name).write_bytes((sessions / "B" / name).read_bytes())
        (folder / "m.yaml").write_bytes((sessions / "3-RPR.yaml").read_bytes())
    ppmcal("identify", "m.yaml", "measurements.csv", "--free", "*.offset", "--quiet", "--out",
           "id", cwd=there)
    for name in ("measurements.csv", "measurements.yaml"):
        (there / name).write_bytes((sessions / "C" / name).read_bytes())
    run = ppmcal("compare", sessions / "idA", there / "id", "--json", "--out", "o", cwd=here,
                 expect=0)
    assert run.json["verdict"] == "unchanged"
    inputs = run.json["provenance"]["inputs"]
    assert "measurements.csv" in inputs and not any(
        i.endswith("there/measurements.csv") for i in inputs)


@pytest.mark.slow
def test_keep_carries_on(sessions: Path, tmp_path: Path) -> None:
    """--start OLD --keep, or the old model itself with --keep; the same rows twice are refused."""
    args = ("--keep", "--quiet", "--holdout", "0")
    ppmcal("identify", "3-RPR.yaml", "B/measurements.csv", "--start", "idA/identified.yaml", *args,
           "--out", tmp_path / "one", cwd=sessions, expect=0)
    ppmcal("identify", "idA/identified.yaml", "B/measurements.csv", *args,
           "--out", tmp_path / "two", cwd=sessions, expect=0)
    one, two, alone = (rows(f / "parameters.csv") for f in
                       (tmp_path / "one", tmp_path / "two", sessions / "idB"))
    assert [r["value"][:10] for r in one] == [r["value"][:10] for r in two]
    smaller = [float(a["sigma"]) < float(b["sigma"]) for a, b in zip(one, alone, strict=True)
               if a["status"] == "identified"]
    assert np.mean(smaller) > 0.9
    run = ppmcal("identify", "3-RPR.yaml", "A/measurements.csv", "--start",
                 tmp_path / "one" / "identified.yaml", *args, "--out", tmp_path / "no",
                 cwd=sessions, expect=2)
    assert "in that calibration already" in run.err and not (tmp_path / "no").exists()


@pytest.mark.slow
def test_keep_keeps_what_was_measured_before(sessions: Path, tmp_path: Path) -> None:
    """Targets that only the earlier measurements had around them stay sound."""
    tree = yaml.safe_load((sessions / "idA" / "identified.yaml").read_text())
    tree["measurement"]["ranges"] |= {"x": [-2000.0, 510.0], "temperature": [15.0, 25.0]}
    (tmp_path / "identified.yaml").write_text(yaml.safe_dump(tree))
    (tmp_path / "identification.json").write_bytes(
        (sessions / "idA" / "identification.json").read_bytes())
    ppmcal("identify", "3-RPR.yaml", "B/measurements.csv", "--start", tmp_path / "identified.yaml",
           "--keep", "--quiet", "--holdout", "0", "--out", tmp_path / "o", cwd=sessions, expect=0)
    new, seen = (yaml.safe_load((f / "identified.yaml").read_text())["measurement"]["ranges"]
                 for f in (sessions / "idB", tmp_path / "o"))
    assert seen["x"] == pytest.approx([-2000.0, new["x"][1]], rel=1e-3)
    assert seen["temperature"] == [15.0, 25.0]
    # the volume that targets are compared in is the same in both files
    told = json.loads((tmp_path / "o" / "identification.json").read_text())["measured_volume"]
    assert told["x"] == pytest.approx(seen["x"])


@pytest.mark.slow
def test_keep_says_when_the_machine_has_changed(sessions: Path, tmp_path: Path) -> None:
    run = ppmcal("identify", "3-RPR.yaml", "C/measurements.csv", "--start", "idA/identified.yaml",
                 "--keep", "--out", tmp_path / "o", cwd=sessions, expect=1)
    words = " ".join(run.out.split())
    assert "the machine has changed since the calibration" in words


@pytest.mark.slow
def test_bad_starts_are_refused(sessions: Path, tmp_path: Path) -> None:
    data = "B/measurements.csv"
    (tmp_path / "identified.yaml").write_text((sessions / "idA" / "identified.yaml").read_text())
    for args, words in (
            (("--start", tmp_path / "identified.yaml", "--keep"), "identification.json"),
            (("--start", CONFIGS / "6-UPS.yaml"), "is of another machine"),
            (("--keep", "--method", "damped"), "--keep goes with"),
            (("--start", "nowhere.yaml"), "nowhere.yaml")):
        run = ppmcal("identify", "3-RPR.yaml", data, *args, "--out", tmp_path / "o",
                     cwd=sessions, expect=2)
        assert words in run.err, args
    (tmp_path / "identification.json").write_text('{"format": "ppmcal/identification/1"}')
    for args in (("identify", "3-RPR.yaml", data, "--keep", "--start",
                  tmp_path / "identified.yaml"), ("compare", tmp_path, "idB"),
                 ("compare", "idA", tmp_path / "none")):
        run = ppmcal(*args, "--out", tmp_path / "o", cwd=sessions, expect=2)
        assert run.err.startswith("Error:") or "Error:" in run.err


@pytest.mark.slow
def test_a_table_that_was_only_held_out_is_not_known(sessions: Path, tmp_path: Path) -> None:
    ppmcal("identify", "3-RPR.yaml", "A/measurements.csv", "--holdout", "B/measurements.csv",
           "--quiet", "--out", tmp_path / "one", cwd=sessions, expect=0)
    ppmcal("identify", "3-RPR.yaml", "B/measurements.csv", "--start", tmp_path / "one", "--keep",
           "--quiet", "--out", tmp_path / "two", cwd=sessions, expect=0)
    run = ppmcal("identify", "3-RPR.yaml", "B/measurements.csv", "--start", tmp_path / "two",
                 "--keep", "--out", tmp_path / "two", cwd=sessions, expect=2)
    assert "two/identified.yaml: is an input of this run" in run.err


@pytest.mark.slow
def test_a_flat_calibration_claims_no_more_than_its_data(sessions: Path, tmp_path: Path) -> None:
    """Frame unknown, no tolerances: twelve parameters, nine directions known.

    Target (two), body and scale were taken for known, which a change of them would show in.
    """
    for label in "AB":
        ppmcal("identify", "3-RPR.yaml", f"{label}/measurements.csv", "--prior", "flat", "--quiet",
               "--out", tmp_path / label, cwd=sessions, expect=0)
    run = ppmcal("compare", tmp_path / "A", tmp_path / "B", "--json", "--out", tmp_path / "o",
                 cwd=sessions, expect=0)
    assert 9 <= run.json["degrees"] <= 13 and run.json["p_value"] > 1e-3
    for label in "AB":
        path = tmp_path / label / "identification.json"
        tree = json.loads(path.read_text())
        del tree["covariance"]["session"]
        path.write_text(json.dumps(tree))
    run = ppmcal("compare", tmp_path / "A", tmp_path / "B", "--json", "--out", tmp_path / "old",
                 cwd=sessions, expect=0)
    assert run.json["degrees"] == 9 and run.json["p_value"] > 1e-3


@pytest.mark.long
def test_noise_that_was_stated_too_small_is_one_matter(sessions: Path, tmp_path: Path) -> None:
    """Both commands take the noise as the residuals show it; a change is not made up from it."""
    for label in "AB":
        folder = tmp_path / f"u{label}"
        folder.mkdir()
        table = (sessions / label / "measurements.csv").read_text()
        (folder / "measurements.csv").write_text(table)
        side = yaml.safe_load((sessions / label / "measurements.yaml").read_text())
        side["instrument"]["sigma"] = {k: v / 3.0 for k, v in side["instrument"]["sigma"].items()}
        (folder / "measurements.yaml").write_text(yaml.safe_dump(side))
        ppmcal("identify", "3-RPR.yaml", folder / "measurements.csv", "--quiet", "--out",
               tmp_path / f"i{label}", cwd=sessions, expect=1)
    found = ppmcal("compare", tmp_path / "iA", tmp_path / "iB", "--json", "--out", tmp_path / "o",
                   cwd=sessions).json
    assert found["p_value"] > 1e-3
    run = ppmcal("identify", "3-RPR.yaml", tmp_path / "uB" / "measurements.csv", "--start",
                 tmp_path / "iA", "--keep", "--out", tmp_path / "k", cwd=sessions, expect=1)
    words = " ".join(run.out.split())
    assert "times the stated noise" in words
    assert ("machine has changed" in words) == (found["verdict"] == "changed")


@pytest.mark.long
def test_a_changed_stiffness_is_named(tmp_path: Path) -> None:
    """A parameter whose steps are taken in its reciprocal, in units far from the others'."""
    ppmcal("init", "3-RPR", cwd=tmp_path, expect=0)
    machine_ = yaml.safe_load((tmp_path / "3-RPR.yaml").read_text())
    machine_["effects"] = [{"kind": "compliance", "parameters": {
        "stiffness": {"value": 4000, "tolerance": 2000, "free": True}}}]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(machine_))
    scenario = yaml.safe_load((tmp_path / "3-RPR.scenario.yaml").read_text())
    scenario |= {"errors": {"leg1.offset": 0.2}, "conditions": {"payload": [0, 20, 40]}}
    for label, stiffness in (("A", 4000), ("B", 2000)):
        scenario |= {"seed": ord(label), "effects": [
            {"kind": "compliance", "parameters": {"stiffness": stiffness}}]}
        (tmp_path / "s.yaml").write_text(yaml.safe_dump(scenario))
        ppmcal("simulate", "3-RPR.yaml", "s.yaml", "--out", label, "--quiet", cwd=tmp_path,
               expect=0)
        ppmcal("identify", "m.yaml", f"{label}/measurements.csv", "--out", f"i{label}", "--quiet",
               cwd=tmp_path, expect=0)
    found = ppmcal("compare", "iA", "iB", "--json", cwd=tmp_path, expect=1).json
    (change,) = found["changes"]
    assert change["name"] == "compliance.stiffness"
    assert change["value"] == pytest.approx(-2000, abs=3 * change["sigma"] + 200)


def test_what_one_session_misses_the_other_is_allowed_too() -> None:
    """Rows that a fit left out, or poses that met no worn place, make no session exact."""
    whole = machine("3-RPR")
    rng = np.random.default_rng(3)
    g = drawn(whole, rng)
    one, _ = worn(whole, "3-RPR", g, g, rng, 10.0 * POSITION)
    two = session(whole, "3-RPR", g, rng, 30, "b")
    own = [noisy(identify(Problem(whole, (d,), whole.free), OPTIONS), OPTIONS) for d in (one, two)]
    noise = noise_between(own[0], own[1])
    assert own[1].inflation == 1.0 and noise.old > noise.new > 2.0
