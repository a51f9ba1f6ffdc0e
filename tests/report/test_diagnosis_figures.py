"""The plot data of a diagnosis: its numbers computed another way, its pictures read back."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import hidden
import numpy as np
import pytest
from helpers.drawings import bars, boxes, lines, parsed, pieces, shapes, style, svg_of, texts
from matplotlib import image
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import t as student

from ppmcal.calibration.fit.fit_result import Fit
from ppmcal.calibration.fit.fit_result import FitOptions as FitOptions
from ppmcal.calibration.fit.fitting import identify
from ppmcal.calibration.fit.problem import Problem
from ppmcal.calibration.knowledge.intervals import coverage
from ppmcal.calibration.validation.residual_vectors import fresh_state
from ppmcal.commands.diagnose.run import DiagnosisResult
from ppmcal.diagnosis.diagnose import DiagnosisOptions, diagnose
from ppmcal.diagnosis.extended_model import Sized, extended
from ppmcal.diagnosis.result import Diagnosis
from ppmcal.io.results.diagnosis import DiagnosisRecord
from ppmcal.io.results.diagnosis_wording import SHORT
from ppmcal.plotting.canvas import WIDTH
from ppmcal.plotting.style import BEFORE
from ppmcal.plotting.svg import SCALE
from ppmcal.report.diagnosis import diagnosis_section
from ppmcal.report.diagnosis_figures import pictures
from ppmcal.report.figure_files import PNG_SCALE, diagnosis_files
from ppmcal.report.html import sig
from ppmcal.report.records import Diagnosed
from ppmcal.report.section import placed
from ppmcal.store.provenance import source_of

Array = NDArray[np.float64]
Record = dict[str, Any]


KINDS = ("backlash", "compliance", "leg_thermal", "gain", "sensor_scale")


@dataclass(frozen=True)
class Case:
    """A diagnosis, what diagnosis.json holds of it, and its pictures as files."""

    result: Diagnosis
    whole: DiagnosisRecord

    @cached_property
    def record(self) -> Record:
        return dict(json.loads(self.whole.text()))

    @cached_property
    def files(self) -> dict[str, str | bytes]:
        return diagnosis_files(self.whole)

    def drawing(self, name: str) -> ElementTree.Element:
        text = self.files[f"{name}.svg"]
        assert isinstance(text, str)
        return parsed(text)

    @property
    def plot_data(self) -> Record:
        return dict(self.record["plot_data"])


def diagnosed(kinds: tuple[str, ...], eta: float, poses: int = 24) -> Case:
    made = hidden.hide("3-RPR", 3, list(kinds), eta, hidden.Options(poses=poses))
    problem = Problem(made.mechanism, (made.dataset,), made.mechanism.free)
    # drawings are the fact, not what is named of the whole library
    result = diagnose(problem, DiagnosisOptions(kinds=KINDS))
    return Case(result, DiagnosisRecord.of(result, {}))


@pytest.fixture(scope="module")
def cases() -> Callable[[str], Case]:
    """One diagnosis for each verdict, made on first use."""
    recipes = {"named": (("backlash", "leg_thermal"), 2.0, 40), "none": ((), 1.0),
               "named-set": (("gain",), 2.0), "unnamed": (("kink",), 3.0, 40)}
    done: dict[str, Case] = {}

    def case(name: str) -> Case:
        if name not in done:
            done[name] = diagnosed(*recipes[name])
            assert done[name].record["verdict"] == name
        return done[name]

    return case


VERDICTS = ("named", "none", "named-set", "unnamed")


# --- numbers --------------------------------------------------------------------------------------


def joint_errors(fit: Fit, keep: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return joint errors (N, 3) and their sigma by moving each joint and predicting again."""
    data, step = fit.problem.datasets[0], 1e-6

    def residual(q: Array) -> Array:
        problem = replace(fit.problem, datasets=(replace(data, q=q),),
                          pivots=tuple(o.about for o in fit.problem.opens))
        rows = list(problem.rows(fresh_state(problem, fit.state), False))
        return np.concatenate([r.raw for r in rows])[keep]

    columns = []
    for a in range(3):
        move = step * np.eye(3)[a]
        columns.append((residual(data.q - move) - residual(data.q + move)) / (2.0 * step))
    back = np.linalg.inv(np.stack(columns, axis=-1))
    sigma = np.array([data.sigma_position[0, 0]] * 2 + [data.sigma_rotation[0, 2]])
    return (np.einsum("nam,nm->na", back, residual(data.q)),
            np.sqrt(np.einsum("nam,m->na", back**2, sigma**2)))


@pytest.mark.long
def test_sizes_have_the_interval_of_the_fit_and_held_out_rows_say_what_they_chose(
        cases: Callable[[str], Case]) -> None:
    case = cases("named")
    half = {e.name: 0.5 * (e.interval[1] - e.interval[0])
            for e in case.result.identification.estimates if e.interval is not None}
    units = case.result.identification.mechanism.units
    seen = 0
    for effect, entry in zip(case.result.effects, case.whole.effects, strict=True):
        for name in effect.parameters:
            value = entry.parameters[name.rpartition(".")[2]]
            quantity = case.result.identification.mechanism.parameters[
                case.result.identification.mechanism.names.index(name)].quantity
            assert value.half == pytest.approx(half[name] / units.factor(quantity))
            assert value.sigma is not None and value.half > 1.9 * value.sigma
            seen += 1
    assert seen
    assert case.record["gap"]["chose"] == ["effects", "learned terms"]
    assert case.record["coverage"] == pytest.approx(coverage(case.result.identification.fit))


@dataclass(frozen=True)
class Known:
    before: Array
    after: Array
    sigma: Array


@pytest.fixture(scope="module")
def known(cases: Callable[[str], Case]) -> Known:
    result = cases("named").result
    fit = result.identification.fit
    before, _ = joint_errors(result.before, fit.keep[0])
    return Known(before, *joint_errors(fit, fit.keep[0]))


@pytest.mark.slow
def test_joint_errors(cases: Callable[[str], Case], known: Known) -> None:
    case = cases("named")
    stage = case.result.found.last
    left = 1.0 - stage.basis.shape[1] / stage.system.count
    rows = case.plot_data["actuators"]
    assert [a["name"] for a in rows] == ["leg1", "leg2", "leg3"]
    for a, entry in enumerate(rows):
        assert entry["unit"] == "mm"
        for name, values in (("rms_before", known.before), ("rms_after", known.after)):
            rms = 1e3 * np.sqrt(np.mean(values[:, a] ** 2))
            assert entry[name] == pytest.approx(rms, rel=1e-3), name
        noise = 1e3 * np.sqrt(left * np.mean(known.sigma[:, a] ** 2))
        assert entry["noise"] == pytest.approx(noise, rel=1e-3)
        # the effects were on every joint; now only noise is left
        assert entry["rms_before"] > 1.5 * entry["noise"]
        assert entry["rms_after"] == pytest.approx(entry["noise"], rel=0.2)


@pytest.mark.slow
def test_errors_against_the_direction(cases: Callable[[str], Case], known: Known) -> None:
    """Means and 95 % intervals of each joint's error from each side."""
    case = cases("named")
    series = next(s for s in case.plot_data["series"] if s["input"] == "direction")
    assert case.record["effects"][series["effect"]]["kind"] == "backlash"
    assert series["names"] == [f"leg{i} {sign}" for i in (1, 2, 3) for sign in "−+"]
    data = case.result.identification.fit.problem.datasets[0]
    keep = case.result.identification.fit.keep[0]
    for n, name in enumerate(series["names"]):
        leg, sign = name.split()
        mine = data.columns[f"dir_{leg}"][keep] == (1.0 if sign == "+" else -1.0)
        assert series["count"][n] == mine.sum()
        for part, errors in (("before", known.before), ("after", known.after)):
            values = 1e3 * errors[mine, int(leg[-1]) - 1]
            half = student.ppf(0.975, mine.sum() - 1) * values.std(ddof=1) / np.sqrt(mine.sum())
            assert series[part][n] == pytest.approx(values.mean(), rel=2e-3, abs=1e-6)
            assert series[f"{part}_95"][n] == pytest.approx(half, rel=2e-3)
        assert abs(series["before"][n]) > series["before_95"][n]
        assert np.sign(series["before"][n]) == (1.0 if sign == "+" else -1.0)


@pytest.mark.slow
def test_errors_against_the_temperature(cases: Callable[[str], Case], known: Known) -> None:
    case = cases("named")
    series = next(s for s in case.plot_data["series"] if s["input"] == "temperature")
    assert case.record["effects"][series["effect"]]["kind"] == "leg_thermal"
    assert series["input_unit"] == "deg C"
    assert sum(series["count"]) == known.before.size
    assert np.all(np.diff(series["x"]) > 0.0)
    data = case.result.identification.fit.problem.datasets[0]
    seen = data.columns["temperature"][case.result.identification.fit.keep[0]]
    if seen.mean() > 200.0:
        seen = seen - 273.15
    assert seen.min() <= series["x"][0] < series["x"][-1] <= seen.max()
    slopes = []
    for part, errors in (("before", known.before), ("after", known.after)):
        weights = np.array(series["count"])
        assert np.average(series[part], weights=weights) == pytest.approx(
            1e3 * errors.mean(), abs=1e-5)
        slopes.append(np.polyfit(series["x"], series[part], 1, w=np.sqrt(weights))[0])
    assert abs(slopes[1]) < 0.2 * abs(slopes[0])


def white_ratio(fit: Fit) -> float:
    """Return rms of the white residuals over the noise, for what the fit has freed."""
    total, count = 0.0, 0
    for rows in fit.problem.rows(fit.state, False, fit.keep):
        total += float(np.sum(rows.residual**2))
        count += int(rows.observed.sum())
    return math.sqrt(total / (count - len(fit.problem.columns)))


@pytest.mark.slow
def test_gap_from_start_to_noise(cases: Callable[[str], Case]) -> None:
    """Every model of the gap fitted as such: nominal, geometry, one effect more each time."""
    case = cases("named")
    found, steps = case.result.found, case.plot_data["steps"]
    assert [s["what"] for s in steps] == ["start", "geometry", "effect", "effect"]
    ratios = [s["rms_ratio"] for s in steps]
    assert ratios == sorted(ratios, reverse=True)
    assert ratios[-1] == pytest.approx(1.0, abs=0.15)
    assert ratios[-1] == pytest.approx(case.record["remainder"]["rms_ratio"], rel=1e-5)
    assert ratios[1] == pytest.approx(case.record["fit"]["before"], rel=1e-5)
    plainly = FitOptions(method="flat", robust=False)
    training = found.first.system.problem    # steps are of all rows
    start = identify(replace(training, free=()), plainly)
    assert ratios[0] == pytest.approx(white_ratio(start), rel=0.02)
    # the prior and directions that cannot be seen make a few degrees of freedom's difference
    assert ratios[1] == pytest.approx(white_ratio(identify(training, plainly)), rel=0.1)
    stage, at = found.last, list(found.last.chosen)
    for count in (1, 2):
        kinds = [s["kind"] for s in steps[2:2 + count]]
        some = [i for i in at if stage.hypotheses[i].kind in kinds]
        assert len(some) == count
        ones = [stage.hypotheses[i] for i in some]
        mechanism, _ = extended(training.mechanism, [
            Sized(h, stage.sizes(h.columns), *np.ones((2, len(h.columns)))) for h in ones])
        fit = identify(replace(training, mechanism=mechanism, free=mechanism.free), plainly)
        assert ratios[1 + count] == pytest.approx(white_ratio(fit), rel=0.1)
        assert steps[1 + count]["on"] == ["leg1", "leg2", "leg3"]


# --- pictures -------------------------------------------------------------------------------------


@pytest.mark.long_cases("named-set", "none", "unnamed")
@pytest.mark.parametrize("verdict", ["named", "none", *(
    pytest.param(v, marks=pytest.mark.slow) for v in ("named-set", "unnamed"))])
@pytest.mark.slow
def test_drawings_are_whole_and_need_nothing_else(cases: Callable[[str], Case], verdict: str
                                                  ) -> None:
    case = cases(verdict)
    wanted = {"gap.svg", "actuators.svg", "inputs.svg"}
    own = {"named-set": {"alternatives.svg"}, "unnamed": {"terms.svg"}}
    assert set(case.files) == wanted | own.get(verdict, set())
    for name, text in case.files.items():
        assert isinstance(text, str)
        root = parsed(text)
        assert root.tag == "svg"
        assert root.findtext("title") and root.findtext("desc")
        assert not re.search(r"\b(nan|NaN|-?inf|None)\b", text), name
        assert re.findall(r"https?://[^\"]*", text) == ["http://www.w3.org/2000/svg"]
        assert not re.search(r"href|url\(|@import|<script|<image|var\(| id=", text), name
        wide, high = map(float, root.get("viewBox", "").split()[2:])
        for box in boxes(root):
            assert 0.0 <= box.left <= box.right <= wide, box
            assert 0.0 <= box.top <= box.low <= high, box
        files = diagnosis_files(case.whole)
        assert files[name] == text


@pytest.mark.long_cases("named-set", "unnamed")
@pytest.mark.slow
@pytest.mark.parametrize("verdict", VERDICTS)
def test_words_have_room(cases: Callable[[str], Case], verdict: str) -> None:
    """No words leave a drawing or lie on other words; only long names are cut short."""
    for drawings in pictures(cases(verdict).whole).values():
        for picture in drawings:
            found = boxes(parsed(svg_of(picture)))
            assert found
            for n, box in enumerate(found):
                assert -1.0 <= box.left <= box.right <= WIDTH + 1.0, box
                assert 0.0 < box.top < box.low < picture.height, box
                assert not box.words.endswith("…"), box
                for other in found[:n]:
                    assert not box.meets(other), (picture.title, box, other)


@pytest.mark.slow
def test_gap_picture(cases: Callable[[str], Case]) -> None:
    """Bars end where the logarithm of their ratio is, the line at the noise."""
    case = cases("named")
    root = case.drawing("gap")
    record = case.record
    values = [*(s["rms_ratio"] for s in case.plot_data["steps"]),
              record["gap"]["before"], record["gap"]["after"]]
    lengths = bars(root, "before", "after")
    assert len(lengths) == len(values) == 6
    scale = lengths[0] / math.log(values[0] / 0.5)
    for length, value in zip(lengths, values, strict=True):
        assert length == pytest.approx(scale * math.log(value / 0.5), abs=0.3)
    at_noise = lines(root)
    assert len(at_noise) == 6
    left = shapes(root, "before")[0][0][0]
    for (place, _), (end, _) in at_noise:
        assert place == end
        assert place - left == pytest.approx(scale * math.log(2.0), abs=0.3)
    words = texts(root)
    names = [f"+ {s['kind']} on all 3 actuators" for s in case.plot_data["steps"][2:]]
    for text in ("machine as in its file, only frames fitted", "+ geometry identified", *names,
                 f"Check on {record['gap']['poses']} poses kept out of the fits", "1 (noise)",
                 "rms of the residuals over the noise", "geometry and what is named"):
        assert text in words, text
    for value in values:
        shown = next(w for w in words if w.endswith(" ×") and abs(float(w[:-2]) - value) <= 0.06)
        assert len(shown.replace(".", "").lstrip("0")) <= len("999 ×")    # three digits


@pytest.mark.slow
def test_actuators_picture(cases: Callable[[str], Case]) -> None:
    case = cases("named")
    root, rows = case.drawing("actuators"), case.plot_data["actuators"]
    words = texts(root)
    lengths = bars(root, "before", "after")
    values = [a[k] for a in rows for k in ("rms_before", "rms_after")]
    assert lengths == pytest.approx(
        [v * lengths[0] / values[0] for v in values], abs=0.3)
    for a in rows:
        assert a["name"] in words
        assert f"{sig(1e3 * a['rms_before'])} → {sig(1e3 * a['rms_after'])} µm" in words
    assert {"geometry alone", "with what is named", "noise", "rms of the joint error (µm)"
            } <= set(words)


@pytest.mark.slow
def test_inputs_picture(cases: Callable[[str], Case]) -> None:
    """A ring for each mean before, a disc for each after, axes with units."""
    case = cases("named")
    root, series = case.drawing("inputs"), case.plot_data["series"]
    count = sum(len(s["x"]) for s in series)
    assert len(shapes(root, "ring")) == len(shapes(root, "disc")) == count
    words = texts(root)
    for text in ("direction of approach (+: joint increasing)", "temperature (°C)",
                 "error of all 3 actuators (µm)", "backlash on all 3 actuators",
                 "leg_thermal on all 3 actuators", "leg2"):
        assert text in words, text
    assert any("○ geometry alone, ● with what is named." in w for w in words)
    # higher on the page is a larger error
    drawing = parsed(svg_of(pictures(case.whole)["inputs"][0]))
    rings = [p for p in drawing.iter("path") if style(p).get("stroke") == BEFORE
             and p.get("d", "").endswith("z")]
    heights = [-float(np.mean([y for _, y in ring])) for p in rings for ring in pieces(p)]
    assert np.corrcoef(heights, series[0]["before"])[0, 1] > 0.9999


# --- each verdict ---------------------------------------------------------------------------------


def section(record: Record) -> str:
    (chapter,) = placed([diagnosis_section(Diagnosed("d", DiagnosisRecord.checked(record),
                                                     None))])
    return re.sub(r"<style>.*?</style>|<[^>]*>", " ", chapter.html.replace("</p>", " "))


@pytest.mark.slow
def test_diagnosis_of_nothing(cases: Callable[[str], Case]) -> None:
    case = cases("none")
    text = section(case.record)
    assert "No missing effect is detectable in these data." in text
    assert [s["what"] for s in case.plot_data["steps"]] == ["start", "geometry"]
    # one joint against all that was recorded, by geometry alone
    assert {s["role"] for s in case.plot_data["series"]} == {"recorded"}
    root = case.drawing("inputs")
    assert not shapes(root, "ring") and shapes(root, "disc")
    assert "with what is named" not in " ".join(texts(root))
    assert len(bars(case.drawing("gap"), "before", "after")) == 3


@pytest.mark.slow
def test_diagnosis_of_something_unknown(cases: Callable[[str], Case]) -> None:
    case = cases("unnamed")
    text = section(case.record)
    assert "Something is missing that ppmcal does not know." in text
    (unknown,) = case.record["unknown"]
    assert f"Without a name: {unknown['looks_like']}" in text
    assert case.record["effects"] == []
    # of all rows, as none is a gross error: beyond what noise leaves in one campaign of a thousand
    ratio, stage = case.plot_data["steps"][-1]["rms_ratio"], case.result.found.last
    plain = identify(stage.system.problem, FitOptions(method="flat", robust=False))
    assert ratio == pytest.approx(white_ratio(plain), rel=0.05)
    freedom = stage.system.count - stage.basis.shape[1]
    assert ratio > math.sqrt(chi2.isf(1e-3, freedom) / freedom)
    assert all(s["before"] == s["after"] for s in case.plot_data["series"])
    assert case.record["remainder"]["follows"] == unknown["looks_like"]
    assert "leg3" in unknown["looks_like"]
    assert {s["role"] for s in case.plot_data["series"]} == {"recorded"}
    # the kink is in leg3, where the robust fit takes many rows for outliers: they are shown
    worst = max(case.plot_data["actuators"], key=lambda a: a["rms_before"] / a["noise"])
    assert worst["name"] == "leg3"
    assert worst["rms_before"] > 2.0 * worst["noise"]
    out = case.plot_data["left_out_rows"]
    # with what was learned, most of them are no outliers any more
    assert out > 4
    assert out > len(case.record["excluded"])
    assert f"With {out} rows that the fit took for outliers." in text
    assert case.plot_data["series"][0]["on"] == ["leg3"]
    assert case.plot_data["series"][0]["input"] == "travel"


@pytest.mark.slow
def test_diagnosis_of_effects_that_look_alike(cases: Callable[[str], Case]) -> None:
    case = cases("named-set")
    (effect,) = case.record["effects"]
    others = [a.replace("leg1, leg2, leg3", "all 3 actuators") for a in effect["alternatives_on"]]
    assert others
    text = section(case.record)
    whole = " or ".join([effect["kind"], *others])
    assert "these data cannot tell a few effects apart: " + (
        whole if len(whole) <= SHORT else f"{effect['kind']} or ") in text
    root = case.drawing("alternatives")
    words = texts(root)
    assert effect["kind"] in words
    assert "odds for the named effect against the alternative" in words
    order = np.argsort(effect["odds"], kind="stable")
    shown = [w.removeprefix("or ") for w in words if w.startswith("or ")]
    assert shown == [others[i] for i in order]
    lengths = bars(root, "alternative")
    odds = np.minimum(np.sort(effect["odds"]), 1e6)
    for length, value in zip(lengths, odds, strict=True):
        assert length == pytest.approx(
            lengths[0] * math.log(value / 0.5) / math.log(odds[0] / 0.5), abs=0.4)
    for other in others:
        assert other in text


@pytest.mark.slow
def test_records_cut_down_still_draw(cases: Callable[[str], Case]) -> None:
    """Older or shortened records: less is drawn, nothing fails."""
    record = cases("named").record

    def drawn(series: list[Record]) -> set[str]:
        return set(pictures(DiagnosisRecord.checked(
            {**record, "plot_data": {"series": series}})))

    assert pictures(DiagnosisRecord()) == {}
    assert section({"verdict": "none"})
    for part in ("actuators", "series", "steps"):
        less = {**record, "plot_data": {k: v for k, v in record["plot_data"].items() if k != part}}
        assert diagnosis_files(DiagnosisRecord.checked(less))
        assert section(less)
    for key in record:
        assert section({k: v for k, v in record.items() if k != key})
    for key in ("x", "before", "before_95", "after", "after_95"):
        series = [{**s, key: [None] * len(s["x"])} for s in record["plot_data"]["series"]]
        assert "inputs" not in drawn(series)
        series = [{**s, key: s[key][:2]} for s in record["plot_data"]["series"]]
        assert "inputs" in drawn(series)


# --- PNG ------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_png(cases: Callable[[str], Case]) -> None:
    """The same drawings, point for point."""
    files = diagnosis_files(cases("named-set").whole, png=True)
    assert sorted(n for n in files if n.endswith(".png")) == sorted(
        n.replace(".svg", ".png") for n in files if n.endswith(".svg"))
    for name, drawing in files.items():
        if isinstance(drawing, bytes):
            shot = image.imread(io.BytesIO(drawing))[..., :3]
            text = files[name.replace(".png", ".svg")]
            assert isinstance(text, str)
            root = parsed(text)
            size = [float(root.get(k, "nan")) * PNG_SCALE / SCALE for k in ("height", "width")]
            assert shot.shape[:2] == pytest.approx(size, abs=2.0)
            for bar in shapes(root, "named", "explained"):
                (left, right), (top, low) = ((PNG_SCALE * min(v), PNG_SCALE * max(v))
                                             for v in zip(*bar, strict=True))
                colours = np.ptp(shot[int(0.5 * (top + low)), int(left):int(right) + 1], axis=-1)
                assert np.median(colours) > 0.2, (name, bar)


@pytest.mark.slow
def test_png_is_written_where_it_is_asked_for(cases: Callable[[str], Case], tmp_path: Path) -> None:
    found = cases("none").result
    for png in (False, True):
        result = DiagnosisResult(source_of("diagnose", [], 0), (), found, png)
        names = {p.name for p in result.save(tmp_path / str(png))}
        assert {"gap.svg", "inputs.svg"} <= names
        assert {n for n in names if n.endswith(".png")} == (
            {n.replace(".svg", ".png") for n in names if n.endswith(".svg")} if png else set())
