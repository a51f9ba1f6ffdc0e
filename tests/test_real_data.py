"""Real measurements, where they are at hand: in ../shared/data or where PPMCAL_DATA says."""

from __future__ import annotations

import csv
import json
import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import ppmcal
from helpers.paths import ROOT

from ppmcal import import_config
from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.flatness import flats
from ppmcal.calibration.fit.linearisation import normal_step
from ppmcal.calibration.fit.noise_estimate import with_estimated_noise
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.fit.secondary_analyses import LEFT_OUT
from ppmcal.calibration.knowledge.identifiability_report import predict_identifiability
from ppmcal.calibration.validation.residual_vectors import residuals
from ppmcal.calibration.validation.summary import report
from ppmcal.diagnosis.diagnose import DiagnosisOptions
from ppmcal.diagnosis.own_noise import diagnose_with_own_noise
from ppmcal.io import read_campaign, read_mechanism

DATA = Path(os.environ.get("PPMCAL_DATA", ROOT.parent / "shared" / "data"))

import real_deltas  # noqa: E402
import real_priors  # noqa: E402
import real_sessions  # noqa: E402
import real_stewart  # noqa: E402

EDITED = ("011", "019", "022")
"""Events whose saved parameters were edited by hand after solving."""

pytestmark = pytest.mark.skipif(not (DATA / "delta-events").is_dir(),
                                reason="real measurements are not at hand (PPMCAL_DATA)")


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted((DATA / "delta-events").glob("*.json")),
                         ids=lambda p: p.stem)
def test_a_printer_s_own_calibration(path: Path) -> None:
    """Heights and calipers, flat priors, the printer's weights: its saved parameters."""
    event = json.loads(path.read_text(encoding="utf-8"))
    fit = real_deltas.fitted(event, "single" if event["distances"] else "fixed")
    far = real_deltas.apart(real_deltas.geometry(fit), event["geometry_saved"])
    if event["id"].startswith(EDITED):
        assert far > 0.05
    else:
        assert far < real_deltas.CLOSE


@pytest.mark.parametrize(("rods", "limit"), [("fixed", 0.0215), ("single", 0.0200)])
def test_one_bed_touched_284_times(rods: str, limit: float) -> None:
    (path,) = (DATA / "delta-rostock").glob("*.csv")
    assert real_deltas.rms(real_deltas.bed(path, rods))[0] < limit + 5e-5
    assert np.loadtxt(path, delimiter=",", skiprows=1).shape == (284, 3)


def event_of(name: str) -> dict[str, Any]:
    (path,) = (DATA / "delta-events").glob(f"{name}_*.json")
    return dict(json.loads(path.read_text(encoding="utf-8")))


@pytest.mark.long_cases("015", "016")
@pytest.mark.slow
@pytest.mark.parametrize("name", ["000", "013", "015", "016", "024"])
def test_with_priors_rods_stay_and_touches_left_out_are_predicted(name: str) -> None:
    event = event_of(name)
    own, six = (real_priors.machine(event, rods) for rods in ("single", "fixed"))
    fit = real_priors.fitted(*own, "prior")
    rods = real_priors.rods_of(fit) - np.array(event["geometry_start"]["arms"])
    assert np.max(np.abs(rods)) < 3.0 * real_priors.TOLERANCES["length"]
    assert real_priors.left_out(*own, "prior") < real_priors.left_out(
        six[0], six[1][:1], "flat") + 0.02


@pytest.mark.slow
def test_distances_that_do_not_fit_are_told() -> None:
    """029: its solver made 288 mm rods 292 to 297 mm long."""
    event = {**event_of("029"), "geometry_start": event_of("028")["geometry_saved"]}
    fit = real_priors.fitted(*real_priors.machine(event, "single"), "prior")
    told = report(fit, FitOptions(), 0.0, 0)
    # as noisy as such rows are, they say nothing against rods within their tolerance
    assert np.max(np.abs(real_priors.rods_of(told.fit) - 288.13)) < real_priors.TOLERANCES["length"]
    assert told.noise.failed and told.noise.by_dataset["distances"] > 3.0
    assert any("times the stated noise" in finding for finding in told.findings)


def printer_of(event: dict[str, Any], folder: Path) -> Problem:
    """Return an event as it is imported: six parameters, noise that is only begun."""
    machine = yaml.safe_load(real_deltas.mechanism_text(event["geometry_start"], "fixed"))
    machine["tolerances"] = {"point": float("inf"), "angle": 0.5, "offset": 3.2}
    (folder / "machine.yaml").write_text(yaml.safe_dump(machine))
    mechanism = read_mechanism(folder / "machine.yaml")
    paths = real_deltas.write_data(folder, event)
    for path, sigma in zip(paths, ({"height": 0.02}, {"distance": 0.05}), strict=True):
        side = yaml.safe_load(path.with_suffix(".yaml").read_text())
        side["instrument"]["sigma"] = {**sigma, "estimated": True}
        path.with_suffix(".yaml").write_text(yaml.safe_dump(side))
    return Problem(mechanism, read_campaign(paths, mechanism), mechanism.free)


@pytest.mark.long_cases("016-0-1.0", "016-4-0.5")
@pytest.mark.parametrize(("name", "row", "off"), [
    ("015", 0, -1.0), ("015", 7, 1.0), ("016", 0, 1.0), ("016", 4, 0.5)])
@pytest.mark.slow
def test_a_caliper_read_wrongly_is_left_out_and_is_no_noise(name: str, row: int, off: float,
                                                            tmp_path: Path) -> None:
    """Fitted with its own file alone, the wrong value spreads over the others there."""
    event = event_of(name)
    problem = printer_of(event, tmp_path)
    _, clean = with_estimated_noise(problem, FitOptions())
    event["distances"][row][0] += off
    fit, factor = with_estimated_noise(printer_of(event, tmp_path), FitOptions())
    assert [np.flatnonzero(~k).tolist() for k in fit.keep] == [[], [row]]
    assert np.allclose(factor, clean, rtol=0.15)


@pytest.mark.long
def test_calipers_that_contradict_good_touches_are_told(tmp_path: Path) -> None:
    """The noise of both, estimated together, would hide it: the bed is missed by twice as much."""
    path = DATA / "hard" / "calipers-against-touches" / "printer.cfg"
    if not path.is_file():
        pytest.skip("the printer is not at hand (PPMCAL_DATA)")
    import_config("klipper", path).save(tmp_path)
    run = ppmcal("identify", "machine.yaml", "heights.csv", "distances.csv", "--holdout", "0",
                 cwd=tmp_path, expect=1)
    assert "heights and distances disagree" in " ".join((run.out + run.err).split())
    record = json.loads((tmp_path / "identified" / "identification.json").read_text())
    assert any("disagree" in f for f in record["findings"])


def mesh_of(name: str) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    (path,) = (DATA / "delta-meshes").glob(f"{name}_*.json")
    mesh = json.loads(path.read_text(encoding="utf-8"))
    event = real_priors.in_use(mesh, DATA / "delta-events")
    assert event is not None
    return path, mesh, event


@pytest.mark.slow
@pytest.mark.parametrize("name", ["mesh08", "mesh10", "mesh20", "mesh22", "mesh23", "mesh26"])
def test_a_printer_calibrated_from_its_event_predicts_its_bed(name: str) -> None:
    path, mesh, event = mesh_of(name)
    data = real_priors.bed_of(path, mesh, event)
    mechanism, own = real_priors.machine(event, "single")
    fit = real_priors.fitted(mechanism, own, "prior")
    printer = real_priors.on_bed(real_priors.with_numbers(mechanism, mesh["active_geometry"]), data)
    assert real_priors.on_bed(mechanism.with_values(fit.state.g), data) < printer + 5e-5
    bed = real_priors.fitted(real_priors.machine(event, "fixed")[0], (data,), "flat", False)
    (flat,) = flats(bed)
    assert 0.005e-3 < flat.smooth < 0.04e-3 and flat.scatter < 0.06e-3


@pytest.mark.long
@pytest.mark.parametrize("name", ["mesh20", "mesh26"])
def test_one_bed_probed_to_and_fro_has_no_plain_backlash(name: str) -> None:
    """Of mesh26 something changes sign with the way, and a slow course of the bed does as well."""
    path, mesh, event = mesh_of(name)
    data = real_priors.bed_of(path, mesh, event)
    with path.with_suffix(".csv").open(encoding="utf-8") as stream:
        ways = [float(r["approach_dir_x"]) for r in csv.DictReader(stream)]
    data = replace(data, columns={"dir_x": np.array(ways)}, estimated=True)
    mechanism = real_priors.machine(event, "fixed")[0]
    found, _ = diagnose_with_own_noise(Problem(mechanism, (data,), mechanism.free),
                                       DiagnosisOptions())
    assert not any(e.kind == "backlash" for e in found.effects)
    assert name != "mesh26" or found.verdict == "unnamed"


def test_rods_and_step_scales_of_one_bed_are_one_direction() -> None:
    """Before anything is fitted: heights alone do not tell them apart, nor the machine's size."""
    (path,) = (DATA / "delta-rostock").glob("*.csv")
    event = real_priors.rostock_event(path)
    mechanism, data = real_priors.machine(event, "single", start="start", loose=True, steps=True)
    found = predict_identifiability(Problem(mechanism, data, mechanism.free), "prior")
    assert ("length", "ratio") in [(t.one, t.other) for t in found.collinear]
    assert found.scale is not None and found.scale.prior_dominated and found.scale.open


@pytest.mark.slow
def test_leaning_towers_against_rods_on_touches_left_out() -> None:
    (path,) = (DATA / "delta-rostock").glob("*.csv")
    event = real_priors.rostock_event(path)
    rods, towers = (real_priors.left_out(*real_priors.machine(
        event, kind, lean, "start", True), "prior", 4)
        for kind, lean in (("single", False), ("fixed", True)))
    assert towers < rods - 0.0005


@pytest.mark.long
def test_successive_calibrations_are_compared(capsys: pytest.CaptureFixture[str]) -> None:
    """Endstops that were set anew are named, tied with the bed; no radius is blamed for either."""
    real_priors.repeated(DATA / "delta-events")
    lines = [line for line in capsys.readouterr().out.splitlines() if "->" in line]
    (moved,) = [line for line in lines if line.startswith("015_")]
    assert "height and tilt of the bed" in moved and "homing of every joint" in moved
    assert not any("radius" in line for line in lines)
    # repeats minutes apart: chi-squared near its degrees of freedom, not 0.001 of them
    still = [line.split() for line in lines if "of the bed" not in line and "homing" not in line]
    ratios = [float(s[s.index("chi2") + 1]) / float(s[s.index("of") + 1].rstrip(","))
              for s in still]
    assert len(ratios) >= 4 and 0.5 < sorted(ratios)[len(ratios) // 2] < 2.0


@pytest.mark.long
def test_what_a_day_of_the_rig_says_of_the_other() -> None:
    """Frame anew, each day predicts the other; what is learned on one day is no worse on the other.

    Each leg goes its own way with its travel, which has no name.
    """
    mechanism, days = real_sessions.rig(DATA / "stewart-jugglebot")
    first, second = real_sessions.both_ways(mechanism, days)
    assert first.figures[0] < real_stewart.LIMITS["60 -> 108", ""]
    assert second.figures[0] < real_stewart.LIMITS["108 -> 60", ""]
    assert second.verdict == "unnamed" and second.learned
    # a gain in the rows that both models are judged by, none over all rows
    assert second.same[2] < second.same[0]
    assert second.figures[2] < 1.01 * second.figures[0]


@pytest.mark.slow
def test_two_days_of_the_rig_are_fitted_to_the_minimum() -> None:
    """Their noise is that of the spools, carried over to the pose by a geometry that moves."""
    mechanism, days = real_sessions.rig(DATA / "stewart-jugglebot")
    fit = identify(Problem(mechanism, days, mechanism.free))
    assert fit.converged
    assert normal_step(fit.problem, fit.state, fit.information, fit.prior).step()[1] < 1e-5


@pytest.mark.long
def test_a_cable_robot_that_hardly_turns_is_fitted_with_frame_and_target_unknown() -> None:
    """The closed form of both is 0.14 m off, of the frame alone less."""
    folder = DATA / "hard" / "cable-planar"
    if not folder.is_dir():
        pytest.skip("the cable robot is not at hand (PPMCAL_DATA)")
    mechanism = read_mechanism(folder / "mechanism.yaml")
    fit = identify(Problem(mechanism, read_campaign([folder / "a.csv"], mechanism),
                           mechanism.free))
    assert fit.converged
    away = residuals(fit.problem, fit.state).position[0]
    assert np.sqrt(np.nanmean(away**2)) < 2.3e-3


@pytest.mark.slow
def test_exact_data_with_a_sigma_of_a_nanometre_are_identified() -> None:
    """How far sessions differ drowns in round-off; it is told beside the fit, and does not end it.
    """
    folder = DATA / "hard" / "exact-delta"
    if not folder.is_dir():
        pytest.skip("the exact delta is not at hand (PPMCAL_DATA)")
    mechanism = read_mechanism(folder / "mechanism.yaml")
    data = read_campaign([folder / "t-delta-linear.csv"], mechanism)
    options = FitOptions()
    found = report(identify(Problem(mechanism, data, mechanism.free), options), options, 0.2, 0)
    assert found.fit.converged
    assert [f for f in found.findings if f.startswith(f"{LEFT_OUT}: how far sessions")]


@pytest.mark.long
def test_half_of_the_touches_is_not_explained_away_and_predicts_the_other() -> None:
    """284 touches of one height: nothing is learned of that height."""
    (path,) = (DATA / "delta-rostock").glob("*.csv")
    for one in real_sessions.both_ways(*real_sessions.halves(path)):
        assert one.figures[2] < 1.05 * one.figures[0]
        assert one.figures[2] > 0.5 * one.figures[0]
