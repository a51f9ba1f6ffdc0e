"""The tables of a diagnosis: a row per effect, the same groups throughout."""

from __future__ import annotations

import csv
import io
import json
import re
from dataclasses import dataclass, replace
from functools import cache, cached_property
from html import unescape
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import hidden
import numpy as np
import pytest
from helpers.paths import ROOT
from helpers.report_files import html_of

from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.validation.left_out_rows import LeftOut
from ppmcal.commands.diagnose.run import effects, told
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.findings import advice, findings
from ppmcal.diagnosis.held_out_gap import Gap
from ppmcal.diagnosis.hypotheses import Hypothesis
from ppmcal.diagnosis.result import Candidate, Diagnosis, NamedEffect
from ppmcal.errors import BadInput
from ppmcal.io.results import diagnosis_wording as wording
from ppmcal.io.results.diagnosis import DiagnosisRecord, effects_csv
from ppmcal.io.results.diagnosis_parts import DiagnosedEffect, SuspectedEffect
from ppmcal.io.results.diagnosis_wording import gap_closed, predicted
from ppmcal.io.results.learned import LearnedEntry
from ppmcal.model.effects import find_effect
from ppmcal.model.motions import SPATIAL
from ppmcal.report.diagnosis import diagnosis_section
from ppmcal.report.records import Diagnosed
from ppmcal.units import Units
from ppmcal.wording import number

Record = dict[str, Any]
KINDS = ("backlash", "play", "compliance", "leg_thermal", "gain")
SUBSETS = {"shared": [("leg2", "leg5")], "each": [("leg2",), ("leg5",)]}
NEAR = 1000.0


@dataclass(frozen=True)
class Case:
    """A diagnosis, what diagnosis.json holds of it, and the rows of effects.csv."""

    result: Diagnosis
    whole: DiagnosisRecord
    table: list[dict[str, str]]

    @cached_property
    def record(self) -> Record:
        return dict(json.loads(self.whole.text()))


@cache
def case(name: str, later: float = 0.0) -> Case:
    """Backlash on two of six legs; ``later``: seconds by which the clock is ahead."""
    options = hidden.Options(poses=24)
    causes = [hidden.scaled("6-UPS", 3, hidden.draw("6-UPS", 3, "backlash", options, on=on),
                            1.0 + 0.5 * n, options) for n, on in enumerate(SUBSETS[name])]
    made = hidden.campaign("6-UPS", 3, causes, options)
    columns = made.dataset.columns
    data = replace(made.dataset, columns={**columns, "time": columns["time"] + later})
    problem = Problem(made.mechanism, (data,), made.mechanism.free)
    # tables and words are the fact, not what is named of the whole library
    result = diagnose(problem, DiagnosisOptions(kinds=KINDS))
    assert result.verdict in ("named", "named-set")
    record = DiagnosisRecord.of(result, {})
    return Case(result, record, list(csv.DictReader(io.StringIO(effects_csv(result)))))


@pytest.mark.long
@pytest.mark.parametrize("name", list(SUBSETS))
def test_every_named_effect_has_its_row(name: str) -> None:
    """Those on a few actuators too, whose form the library did not hold."""
    found = case(name)
    wanted = sorted((e["kind"], " ".join(e["on"])) for e in found.record["effects"])
    assert {a for _, on in wanted for a in on.split()} == {"leg2", "leg5"}
    named = [r for r in found.table if r["status"] == "named"]
    assert sorted((r["kind"], r["on"]) for r in named) == wanted
    assert found.table[:len(named)] == named
    others = {(r["kind"], r["on"], r["form"]) for r in found.table if r["status"] != "named"}
    for row in named:
        assert (row["kind"], row["on"], row["form"]) not in others


@pytest.mark.long
@pytest.mark.parametrize("name", list(SUBSETS))
def test_one_probability_per_effect(name: str) -> None:
    """effects.csv and diagnosis.json agree; what was found of thousands has no p-value."""
    found = case(name)
    for e in found.record["effects"]:
        row = next(r for r in found.table if (r["kind"], r["on"], r["status"])
                   == (e["kind"], " ".join(e["on"]), "named"))
        assert 0.5 < e["probability"] <= 1.0 and 0.0 <= float(row["probability"]) <= 1.0
        assert float(row["survival"]) == pytest.approx(e["survival"], rel=1e-12)
        assert e["p_value"] is None
    assert {r["p_value"] for r in found.table} == {"nan"}
    others = [float(r["probability"]) for r in found.table
              if r["status"] not in ("named", "not testable")]
    assert others == sorted(others, reverse=True)


@pytest.mark.long
@pytest.mark.parametrize("later", [0.0, 1.7e9])
def test_groups_are_the_same_before_and_after(later: float) -> None:
    """Each group of rows has its own figure with the effects, near the noise in all of them."""
    found = case("shared", later)
    places = found.record["localised"]
    assert {"actuator", "direction", "region", "load", "time", "temperature"} == {
        p["by"] for p in places}
    keys = [(p["by"], p["value"]) for p in places]
    assert len(keys) == len(set(keys))
    for p in places:
        if p["by"] != "actuator":
            assert p["rms_ratio"] > 1.0 and p["p_value"] < 0.01, p
            assert 0.7 < p["rms_ratio_after"] < 1.3, p


@pytest.mark.slow
def test_next_step_agrees_with_the_findings() -> None:
    """More is to be measured where the held-out poses do not confirm what is named."""
    result = case("shared").result
    gap = result.gap
    assert isinstance(gap, Gap)
    for confirmed in (True, False):
        seen = replace(gap, confirmed=confirmed)
        said = findings(result.before, result.found.after, result.remainder, result.effects, seen,
                        LeftOut(0, 1, False, "", 0.0, 0.0))
        step = advice("named", 6, (), seen).reason
        assert any("do not confirm" in f for f in said) == (not confirmed)
        assert ("nothing more to measure" in step) == confirmed
        assert ("do not confirm" in step) == (not confirmed)


# --- the record ---------------------------------------------------------------------------------


@pytest.mark.long
def test_what_is_written_reads_back_equal(tmp_path: Path) -> None:
    """All of it; a null stands for a missing key, and what is not written is not made up."""
    path = tmp_path / "diagnosis.json"
    for whole in (case("each").whole, wavy().whole):
        path.write_text(whole.text(), encoding="utf-8")
        found = DiagnosisRecord.read(path)
        assert found == whole
        assert found.text() == whole.text()
    record = {"verdict": "named", "effects": [{"kind": "drift", "on": None}], "gap": None,
              "plot_data": {"series": [{"x": [1.0, None]}]}}
    path.write_text(json.dumps(record), encoding="utf-8")
    found = DiagnosisRecord.read(path)
    assert wording.headline(found) == "The missing effect is named: drift."
    assert found.entries() == {
        "verdict": "named", "effects": [{"kind": "drift"}],
        "plot_data": {"series": [{"x": [1.0, None]}]}}


@pytest.mark.parametrize(("record", "place"), [
    ({"effects": {}}, "effects: should be a list"),
    ({"effects": [None]}, r"effects\[0\]"),
    ({"effects": [{"on": [3]}]}, r"effects\[0\].on\[0\]: should be text"),
    ({"effects": [{"parameters": {"width": {"value": "1"}}}]}, "width.value: should be a number"),
    ({"gap": {"interval": [0.1, "x"]}}, r"gap.interval\[1\]: should be a number"),
    ({"confirmed": 1}, "confirmed: should be true or false"),
    ({"plot_data": {"left_out_rows": 1.5}}, "left_out_rows: should be a whole number"),
    ({"format": "ppmcal/plan/1"}, "is not the diagnosis.json"),
    ({"other_models": [{"odds": 1e40}]}, "odds: should be a number, 1e[+]30 at most")])
def test_a_record_of_another_kind_is_refused(tmp_path: Path, record: Record, place: str) -> None:
    path = tmp_path / "diagnosis.json"
    path.write_text(json.dumps(record), encoding="utf-8")
    with pytest.raises(BadInput, match=place) as refusal:
        DiagnosisRecord.read(path)
    assert str(path) in str(refusal.value)


@pytest.mark.slow
def test_the_same_sentences_on_the_console_and_in_the_report() -> None:
    found = case("each")
    said = " ".join(told(found.result, found.whole))
    section = diagnosis_section(Diagnosed("d", found.whole, None))
    page = " ".join(unescape(html_of(section)).split())
    step = wording.next_step(found.whole)
    for sentence in (gap_closed(found.whole), predicted(found.whole)):
        assert sentence.endswith(".")
        assert sentence in said
        assert sentence in page
    assert f"Next: {step}" in said
    assert step[1:] in page
    # each leg with a value and a p of its own, told as one effect
    assert "backlash on leg2, leg5: leg" in said


@pytest.mark.parametrize(("look", "words"), [
    ("odd", "it looks opposite on both sides of its middle (an odd function)."),
    ("even", "it looks alike on both sides of its middle (an even function)."),
    ("kinked", "it looks kinked.")])
def test_what_a_learned_function_looks_like_is_in_plain_words(look: str, words: str) -> None:
    entry = LearnedEntry(input="load", input_unit="N", on=("leg1",), rms=0.2, unit="mm",
                         low=-160.0, high=1.0, looks=(look,))
    (told,) = wording.learned(DiagnosisRecord(learned=(entry,)))
    assert told.endswith(words)


def test_people_are_told_which_of_two_kinds_of_one_name(capsys: pytest.CaptureFixture[str]
                                                        ) -> None:
    """The base may turn on its floor, or the platform give: both are `base_compliance`."""
    kinds = {k.label: k for k in find_effect("base_compliance").variants(SPATIAL)}
    own, other = (Hypothesis(k.name, (), True, (), (), (), (), effect=k) for k in (
        kinds["base_compliance about base"], kinds["base_compliance"]))
    named = NamedEffect(own.kind, (), (), 0.9, 0.75, (other.label,), (0.25,), own)
    suspected = SuspectedEffect.of(Candidate(own, 0.2, 0.5, "weak"))
    machine = SimpleNamespace(units=Units("mm", "deg"), names=(), effects=())
    result = SimpleNamespace(identification=SimpleNamespace(
        mechanism=machine, estimates=(), fit=None))
    effect = DiagnosedEffect.of(result, named)
    assert (effect.kind, effect.label) == ("base_compliance", "base_compliance about base")
    record = DiagnosisRecord(verdict="named", effects=(effect,), suspected=(suspected,))
    page = " ".join(unescape(html_of(diagnosis_section(Diagnosed("d", record, None)))).split())
    for said in (wording.headline(record), effects(record)[0], page):
        assert "base_compliance about base" in said
    older = effect.changed(label="")
    assert wording.effect_name(record, older) == "base_compliance"


# --- figures that follow from parameters ----------------------------------------------------------


@cache
def wavy() -> Case:
    """An error once per turn of a screw on one of six legs."""
    options = hidden.Options(poses=40)
    cause = hidden.scaled("6-UPS", 6, hidden.draw("6-UPS", 6, "periodic", options, on=("leg3",)),
                          1.0, options)
    made = hidden.campaign("6-UPS", 6, [cause], options)
    result = diagnose(Problem(made.mechanism, (made.dataset,), made.mechanism.free),
                      DiagnosisOptions(kinds=("periodic", "backlash")))
    assert [(e.kind, e.on) for e in result.effects] == [("periodic", ("leg3",))]
    return Case(result, DiagnosisRecord.of(result, {}), [])


@pytest.mark.long
def test_amplitude_and_phase_are_those_of_the_wave() -> None:
    """At mid-stroke the fitted error is amplitude cos(phase), a quarter turn on -sin(phase)."""
    result, record = wavy().result, wavy().record
    entry = record["effects"][0]
    units = result.identification.mechanism.units
    middle = entry["mid_stroke"]["value"] * units.factor("length")
    fit = result.identification.fit
    q = np.concatenate([d.q[k][:, 2] for d, k in zip(fit.problem.datasets, fit.keep, strict=True)])
    assert middle == pytest.approx(0.5 * (q.min() + q.max()), rel=1e-12)
    cos, sin, period = (entry["parameters"][n]["value"] for n in ("cos", "sin", "period"))
    figures = entry["derived"]
    assert {f["unit"] for f in figures.values()} == {"mm", "deg"}
    amplitude = figures["amplitude"]["value"]
    phase = np.radians(figures["phase_mid_stroke"]["value"])
    for quarter, wanted in ((0.0, np.cos(phase)), (0.25, -np.sin(phase))):
        turn = 2.0 * np.pi * (entry["mid_stroke"]["value"] / period + quarter)
        error = cos * np.cos(turn) + sin * np.sin(turn)
        assert error == pytest.approx(amplitude * wanted, abs=1e-9 * amplitude)


@pytest.mark.slow
def test_uncertainty_of_amplitude_and_phase() -> None:
    """That of parameters drawn near the fitted ones; at the joint's zero the phase is worse."""
    result, entry = wavy().result, wavy().record["effects"][0]
    found = result.identification
    names = result.effects[0].parameters
    at = [found.columns.index(n) for n in names]
    place = {n.rpartition(".")[2]: k for k, n in enumerate(names)}
    mean = np.array([found.mechanism.values[found.mechanism.names.index(n)] for n in names])
    # so near that the wave's turn from zero to mid-stroke is linear in its period
    drawn = np.random.default_rng(1).multivariate_normal(
        mean, found.covariance[np.ix_(at, at)] / NEAR**2, 20000, method="svd")
    cos, sin, period = (drawn[:, place[n]] for n in ("cos", "sin", "period"))
    middle = entry["mid_stroke"]["value"] * found.mechanism.units.factor("length")
    wave = np.exp(1j * (2.0 * np.pi * middle / period - np.arctan2(sin, cos)))
    phase = np.degrees(np.angle(wave / wave.mean()))
    figures = entry["derived"]
    assert figures["phase_mid_stroke"]["sigma"] == pytest.approx(NEAR * phase.std(), rel=0.03)
    amplitude = np.hypot(cos, sin) / found.mechanism.units.factor("length")
    assert figures["amplitude"]["sigma"] == pytest.approx(NEAR * amplitude.std(), rel=0.03)
    zero = np.exp(1j * np.arctan2(sin, cos))
    assert np.degrees(np.angle(zero / zero.mean())).std() > 3.0 * phase.std()


@pytest.mark.slow
def test_amplitude_is_told() -> None:
    """On the console, and in the report's table."""
    said = " ".join(told(wavy().result, wavy().whole))
    figures = wavy().record["effects"][0]["derived"]
    assert f"amplitude {number(figures['amplitude']['value'])} +-" in said
    assert f"phase {number(figures['phase_mid_stroke']['value'])} +-" in said
    assert "at mid-stroke (" in said
    page = html_of(diagnosis_section(Diagnosed("d", wavy().whole, None)))
    assert re.search(r"amplitude [\d.]+ ± [\d.]+ mm; phase at mid-stroke [−-]?[\d.]+ ± [\d.]+ deg",
                     page)


@pytest.mark.parametrize("odds", [650000.0, 1.0 / 650000.0])
def test_odds_before_and_after_are_of_different_things(odds: float) -> None:
    """A lead now, whichever way, and what is left of it at least if the other one is true."""
    record = DiagnosisRecord(
        next_reason="65 measurements", next_file="next.csv", next_rows=65, odds_before=odds,
        odds_after=21.0)
    step = wording.next_step(record)
    assert "ahead by odds of 650000 to 1 now" in step
    assert "even if it is the other, should be ahead by 21 to 1" in step


def test_no_odds_are_told_where_there_are_no_two_readings() -> None:
    """Poses for the geometry alone have no rivals behind them: 1 to 1 before and after."""
    record = DiagnosisRecord(
        next_reason="4 poses", next_file="next.csv", next_rows=4, odds_before=1.0, odds_after=1.0)
    assert wording.next_step(record) == "4 poses. They are in next.csv (4 rows)."


def test_records_of_the_format_before_are_read(tmp_path: Path) -> None:
    old = ROOT / "tests" / "fuzz" / "corpus" / "results" / "diagnosis.json"
    assert DiagnosisRecord.read(old).format == "ppmcal/diagnosis/1"
    later = tmp_path / "diagnosis.json"
    later.write_text(old.read_text().replace("ppmcal/diagnosis/1", "ppmcal/diagnosis/3"))
    with pytest.raises(BadInput, match=r"is not the diagnosis\.json of"):
        DiagnosisRecord.read(later)
