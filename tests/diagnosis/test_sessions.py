"""Several sessions: each predicted by the others, and an effect that belongs to one of them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from helpers.commands import ppmcal, rows, write_csv
from helpers.diagnoses import DATA, diagnose, effect, named, simulate

from ppmcal.calibration.fit.fit_result import FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.validation.residual_vectors import on_other_rows
from ppmcal.diagnosis import session_effects
from ppmcal.diagnosis.diagnose import DiagnosisOptions
from ppmcal.diagnosis.diagnose import diagnose as diagnose_
from ppmcal.diagnosis.result import NamedEffect, SessionEffect
from ppmcal.io import read_campaign, read_mechanism

OTHER = "t/measurements.csv"
ERRORS = {"leg1.base.point.x": 0.4, "leg2.offset": 0.3, "leg3.base.point.y": -0.3}
BACKLASH = [effect("backlash", ["leg1"], width=0.03)]
SOME = ("--kind", "backlash", "--kind", "friction")
"""Of the library, what is asked where the fact is another one than what is named of all of it."""


def two_days(folder: Path, first: list[dict[str, Any]], second: list[dict[str, Any]]) -> None:
    """The same 3-RPR on two days, with what was wrong on each."""
    simulate(folder, "3-RPR", first, count=20, errors=ERRORS, seed=5)
    simulate(folder, "3-RPR", second, count=20, errors=ERRORS, seed=6, out="t",
             frame={"x": -2, "y": 5, "rz": -2})


@pytest.mark.long
def test_what_is_there_on_both_days_is_the_machines(tmp_path: Path) -> None:
    two_days(tmp_path, BACKLASH, BACKLASH)
    _, found = diagnose(tmp_path, DATA, OTHER, "--leave-out", "session")
    assert found["verdict"] in ("named", "named-set")
    assert named(found) == {"backlash": {"leg1"}}
    (one,) = found["effects"]
    assert [s["session"] for s in one["sessions"]] == ["s", "t"]
    for s in one["sessions"]:
        width = s["parameters"]["width"]
        assert abs(width["value"] - 0.03) < 4.0 * width["sigma"]
    assert one["same_in_sessions_p"] > 1e-3
    by_session = next(b for b in found["predictive"] if b["by"] == "session")
    assert found["gap"]["closed"] > 0.8
    # it is what was asked for in place of held-out poses
    assert found["gap"]["after"] == by_session["averaged"]["error"]


@pytest.mark.long
def test_probabilities_name_what_was_there_on_one_day(tmp_path: Path) -> None:
    """As that effect, not the same in all sessions: no unknown cause has to do it."""
    two_days(tmp_path, [], BACKLASH)
    run, found = diagnose(tmp_path, DATA, OTHER, *SOME)
    assert run.code == 1
    (one,) = found["effects"]
    assert (one["kind"], one["on"]) == ("backlash", ["leg1"]) and not found["unknown"]
    sizes = {s["session"]: s["parameters"]["width"]["value"] for s in one["sessions"]}
    assert abs(sizes["s"]) < 0.01 and abs(sizes["t"] - 0.03) < 0.01
    (told,) = (f for f in found["findings"] if "differs between sessions" in f)
    assert told.startswith("backlash on leg1 is not") and "mm in s" in told and "mm in t" in told


@pytest.mark.long
def test_sizes_are_those_of_each_day(tmp_path: Path) -> None:
    """The day on which it was larger is told with the larger size."""
    widths = {"s": 0.027, "t": 0.033}
    two_days(tmp_path, *([effect("backlash", ["leg1"], width=w)] for w in widths.values()))
    _, found = diagnose(tmp_path, DATA, OTHER, *SOME)
    (one,) = found["effects"]
    assert {s["session"] for s in one["sessions"]} == set(widths)
    for s in one["sessions"]:
        width = s["parameters"]["width"]
        assert abs(width["value"] - widths[s["session"]]) < 4.0 * width["sigma"]


@pytest.mark.long
def test_each_session_is_predicted_by_a_fit_of_the_other(tmp_path: Path) -> None:
    """Against two commands: a fit of one day, tested on the other day."""
    two_days(tmp_path, [], [])
    ppmcal("identify", "m.yaml", DATA, OTHER, "--leave-out", "session", "--keep-outliers", "--out",
           "i", cwd=tmp_path)
    found = json.loads((tmp_path / "i/identification.json").read_text())
    assert "2 sessions (s, t)" in found["holdout_note"]
    squares = []
    for one, other in ((DATA, OTHER), (OTHER, DATA)):
        ppmcal("identify", "m.yaml", one, "--holdout", other, "--keep-outliers", "--out", "j",
               cwd=tmp_path)
        held = json.loads((tmp_path / "j/identification.json").read_text())["residual"]["holdout"]
        squares.append(held["position"]["rms"] ** 2)
    rms = found["residual"]["holdout"]["position"]["rms"]
    assert rms == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("anew", ["both", "second"])
def test_zeros_of_a_session_that_was_homed_anew_are_no_error(tmp_path: Path, anew: str) -> None:
    """Neither of it, as the other predicts it, nor of the other, as it does."""
    two_days(tmp_path, [], [])
    table = rows(tmp_path / OTHER)
    for row in table:
        row["q_leg1"] = repr(float(row["q_leg1"]) + 0.4)
    write_csv(tmp_path / OTHER, table)
    for data in (DATA, OTHER) if anew == "both" else (OTHER,):
        side = (tmp_path / data).with_suffix(".yaml")
        side.write_text(side.read_text() + "homing: per-file\n")
    ppmcal("identify", "m.yaml", DATA, OTHER, "--leave-out", "session", "--out", "i", cwd=tmp_path)
    found = json.loads((tmp_path / "i/identification.json").read_text())["residual"]["holdout"]
    # 5 um of noise, and what 20 poses know of the geometry
    assert found["position"]["rms"] < 0.03


@pytest.mark.slow
def test_a_session_column_splits_a_file(tmp_path: Path) -> None:
    simulate(tmp_path, "3-RPR", [], count=20, errors=ERRORS)
    table = rows(tmp_path / DATA)
    for n, row in enumerate(table):
        row["session"] = "morning" if n < len(table) // 2 else "evening"
    write_csv(tmp_path / DATA, table)
    ppmcal("identify", "m.yaml", DATA, "--leave-out", "session", "--out", "i", cwd=tmp_path)
    found = json.loads((tmp_path / "i/identification.json").read_text())
    assert "2 sessions (morning, evening)" in found["holdout_note"]
    # 5 um of noise, and what the geometry of a half does not know
    assert 0.004 < found["residual"]["holdout"]["position"]["rms"] < 0.03


@pytest.mark.long
def test_a_left_out_session_is_predicted_to_first_order_as_by_a_fit_without_it(
        tmp_path: Path) -> None:
    """Registration on its own rows, all else from the other session."""
    two_days(tmp_path, [], [])
    mechanism = read_mechanism(tmp_path / "m.yaml")
    data = read_campaign([tmp_path / DATA, tmp_path / OTHER], mechanism)
    told = diagnose_(Problem(mechanism, data, mechanism.free), DiagnosisOptions(by_session=True))
    (found,) = (b for b in told.predictive if b.by == "session")
    assert told.gap is not None and told.gap.before == found.geometry.error
    square = count = 0.0
    for out, other in ((0, 1), (1, 0)):
        fit = identify(Problem(mechanism, (data[other],), mechanism.free), FitOptions(robust=False))
        errors, _ = on_other_rows(fit, [data[out]])
        white = errors.vector[0] / errors.sigma[0]
        # its own frame is fitted to the session itself
        square, count = square + np.nansum(white**2), count + np.isfinite(white).sum() - 3
    assert found.geometry.error == pytest.approx(np.sqrt(square / count), rel=0.02)


def test_what_differs_between_sessions_names_its_own_actuator(
        monkeypatch: pytest.MonkeyPatch) -> None:
    """One hypothesis with a value for each leg: each leg is told by its name."""
    legs = ("leg1", "leg2", "leg3")
    mechanism = SimpleNamespace(
        actuators=legs, names=[f"gain.{leg}.gain" for leg in legs],
        parameters=[SimpleNamespace(quantity="number")] * 3,
        units=SimpleNamespace(factor=lambda q: 1.0, name=lambda q: ""))
    whole = SimpleNamespace(label="gain on leg1, leg2, leg3", begins="")
    effects = [NamedEffect("gain", (leg,), (f"gain.{leg}.gain",), 0.9, 1.0, (), (), whole)
               for leg in legs[:2]]
    differs = [SessionEffect(("s", "t"), e.parameters, np.array([[0.1], [0.5]]),
                             np.full((2, 1), 0.01), 1e-6) for e in effects]
    monkeypatch.setattr(session_effects, "session_effects", lambda fit, named: differs)
    fit = SimpleNamespace(problem=SimpleNamespace(mechanism=mechanism))
    _, told = session_effects.with_sessions(fit, effects)
    assert [t.partition(" differs")[0] for t in told] == ["gain on leg1", "gain on leg2"]


@pytest.mark.slow
def test_one_session_cannot_be_left_out(tmp_path: Path) -> None:
    simulate(tmp_path, "3-RPR", [], count=12)
    for command in ("identify", "diagnose"):
        run = ppmcal(command, "m.yaml", DATA, "--leave-out", "session", "--out", "o", cwd=tmp_path,
                     expect=2)
        assert "only one session" in run.err and "column `session`" in " ".join(run.err.split())
        assert not (tmp_path / "o").exists()
        run = ppmcal(command, "m.yaml", DATA, "--leave-out", "session", "--holdout", "0.3",
                     cwd=tmp_path, expect=2)
        assert "takes the place of" in " ".join(run.err.split())
