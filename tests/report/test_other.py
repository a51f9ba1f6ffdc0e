"""The report on comparisons, exports and what an identification tells besides: real folders."""

from __future__ import annotations

import json
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import yaml
from helpers.commands import ppmcal
from helpers.drawings import bold, lines, parsed, pieces, style, svg_of, texts
from helpers.paths import ROOT
from helpers.report_files import cells, read, specs

from ppmcal.errors import BadInput
from ppmcal.io.results.comparison import ComparisonRecord, platform_sentence, verdict_sentence
from ppmcal.io.results.identification import IdentificationRecord
from ppmcal.io.results.identification_wording import combination, noise_verdict
from ppmcal.plotting.style import AFTER, BEFORE, OUT, SOFT
from ppmcal.report import collect, to_html, to_json
from ppmcal.report.comparison import COMPARE, differences
from ppmcal.report.html import sig, to_sigma, typeset

LATER = {"identification.json": ("identifiability", "gross_errors", "flats"),
         "comparison.json": ("findings",),
         "export.json": ("number_units", "title", "said", "over", "advice", "files")}
"""Keys that older versions did not write."""


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """idA, idB and cmp of a planar machine; fit (a probe that missed), touches, lean and grid."""
    folder = tmp_path_factory.mktemp("more")

    def run(*args: str, expect: int = 0) -> None:
        ppmcal(*args, "--quiet", cwd=folder, expect=expect)

    ppmcal("init", "3-RPR", cwd=folder, expect=0)
    scenario = yaml.safe_load((folder / "3-RPR.scenario.yaml").read_text())
    for seed, label in enumerate("AB"):
        scenario |= {"errors": {"leg1.offset": 0.3, "leg2.offset": -0.1 + 0.5 * seed},
                     "seed": seed}
        (folder / f"{label}.yaml").write_text(yaml.safe_dump(scenario))
        run("simulate", "3-RPR.yaml", f"{label}.yaml", "--out", label)
        run("identify", "3-RPR.yaml", f"{label}/measurements.csv", "--out", f"id{label}")
    run("compare", "idA", "idB", "--out", "cmp", expect=1)
    run("export", "grid", "idA/identified.yaml", "--out", "grid")
    shutil.copy(ROOT / "sample_data" / "printer" / "printer.cfg", folder)
    run("import", "klipper", "printer.cfg")
    heights = folder / "imported" / "heights.csv"
    run("identify", "imported/machine.yaml", str(heights), "--out", "touches")
    lines = heights.read_text().splitlines()
    lines[8] = ",".join(["-0.9", *lines[8].split(",")[1:]])
    heights.write_text("\n".join(lines) + "\n")
    run("identify", "imported/machine.yaml", str(heights), "imported/distances.csv", "--out",
        "fit", expect=1)
    machine = yaml.safe_load((ROOT / "configs" / "delta-linear.yaml").read_text())
    machine["limbs"][0]["base"]["direction"] = {"value": [0.004, 0, 1], "nominal": [0, 0, 1]}
    (folder / "lean.yaml").write_text(yaml.safe_dump(machine))
    run("export", "klipper", "lean.yaml", "--out", "lean", expect=1)
    return folder


def record(folder: Path, name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / name).read_text())
    return found


def page(*dirs: Path) -> tuple[str, str]:
    """Return HTML and text of a page that is sound."""
    html = to_html(collect(dirs))
    checker = read(html)
    assert "nan" not in "".join(checker.text).lower().replace("finan", "")
    for drawing in re.findall(r"<svg.*?</svg>", html):
        ElementTree.fromstring(drawing)
    return html, "".join(checker.text)


@pytest.mark.slow
def test_comparison(folders: Path) -> None:
    html, text = page(folders / "cmp")
    found = record(folders / "cmp", "comparison.json")
    (change,) = found["changes"]
    assert "parameters; the machine has changed (χ² " in text
    assert f"of {found['degrees']} degrees of freedom" in text
    (row,) = cells(html, "The likeliest changes")[1:]
    assert row[:4] == [change["name"], to_sigma(change["value"], change["sigma"]),
                       f"± {sig(1.96 * change['sigma'], 2)}", "mm"]
    assert row[5] == (", ".join(change["instead"]) or "nothing else")
    moved = found["platform"]["position"]
    assert (f"the platform is {moved['rms']:.4g} mm rms and {moved['max']:.4g} mm at most from "
            "where it was") in text
    rows = cells(html, "All parameters")
    assert len(rows) == 1 + len(found["parameters"])
    best = min(found["parameters"], key=lambda p: p["p_alone"])
    assert rows[1][0] == best["name"]
    assert rows[1][3] == to_sigma(best["difference"], best["sigma"]) and rows[1][5] == "mm"
    assert {r[8] for r in rows[1:]} <= {"", "changed", "possible"}
    assert "the machine has changed between the two calibrations: " + change["name"] in text
    assert "ppmcal compare" in text


@pytest.mark.slow
def test_picture_of_differences(folders: Path) -> None:
    """One bar a parameter, largest first, changed ones with a mark and a bold name."""
    found = record(folders / "cmp", "comparison.json")["parameters"]
    root = parsed(svg_of(differences(COMPARE.of(collect([folders / "cmp"]))[0].record.parameters)))
    by_size = sorted(found, key=lambda p: -abs(p["difference"] / p["sigma"]))
    names = [t for t in texts(root) if any(p["name"].startswith(t.rstrip("…")) for p in found)]
    assert [n.removesuffix("…") for n in names] == [
        p["name"][:len(n.removesuffix("…"))] for n, p in zip(names, by_size, strict=True)]
    strokes = sorted((s for colour in (AFTER, BEFORE, OUT)
                      for s in lines(root, colour) if len(s) > 1),
                     key=lambda s: s[0][1])
    assert len(strokes) == len(found)
    (changed,) = bold(root)
    assert by_size[names.index(changed)]["status"] == "changed"
    diamonds = [p for p in root.iter("path") if style(p).get("fill") == OUT]
    assert sum(len(list(pieces(d))) for d in diamonds) == 1
    places, ends = ([s[i][0] for s in strokes] for i in (0, 1))
    zero = next(s[0][0] for s in lines(root, SOFT) if len({x for x, _ in s}) == 1)
    unit = (ends[0] - places[0]) / 3.92
    for p, low in zip(by_size, places, strict=True):
        assert (low - zero) / unit + 1.96 == pytest.approx(p["difference"] / p["sigma"], abs=0.02)


def test_many_parameters_are_thinned_and_changed_ones_kept(tmp_path: Path) -> None:
    rows = [{"name": f"p{i}", "old": 0.0, "new": 1.0 + i, "difference": 1.0 + i, "sigma": 1.0,
             "unit": "mm", "p_alone": 0.5, "status": "changed" if i == 0 else "unchanged"}
            for i in range(60)]
    (tmp_path / "comparison.json").write_text(json.dumps({"verdict": "changed",
                                                          "parameters": rows}))
    html, text = page(tmp_path)
    assert "The 40 largest of 60." in text and "48 further parameters" in text
    ticks = specs(html)["New minus old in units of sigma"]["layout"]["yaxis"]["ticktext"]
    assert [t for t in ticks if t.startswith("<b>")] == ["<b>p0</b>"]
    assert "Nothing by itself explains it." in text


def test_a_change_of_several_numbers_has_a_row_each(tmp_path: Path) -> None:
    parts = [{"name": n, "value": 0.3, "sigma": 0.01, "unit": "mm"} for n in "xy"]
    (tmp_path / "comparison.json").write_text(json.dumps({
        "verdict": "changed", "noise": {"old": 2.0, "new": 2.1, "alike": 0.0},
        "changes": [{"name": "instrument shifted", "parts": parts, "instead": ["target"],
                     "p_value": 0.0}]}))
    html, text = page(tmp_path)
    rows = cells(html, "The likeliest changes")[1:]
    assert [r[0] for r in rows] == ["instrument shifted: x", "instrument shifted: y"]
    assert [r[5] for r in rows] == ["target", ""] and "± 0.020" in rows[0][2]
    assert "scatter 2 times what the files state in the old calibration and 2.1 times" in text


@pytest.mark.slow
def test_csv_alone_is_enough(folders: Path, tmp_path: Path) -> None:
    shutil.copy(folders / "cmp" / "compare.csv", tmp_path)
    html, _ = page(tmp_path)
    whole, _ = page(folders / "cmp")
    assert cells(html, "All parameters") == cells(whole, "All parameters")
    found = to_json(collect([tmp_path]))["comparisons"][0]["parameters"]
    assert found == record(folders / "cmp", "comparison.json")["parameters"]


@pytest.mark.slow
def test_one_file_in_both_is_told(folders: Path, tmp_path: Path) -> None:
    ppmcal("compare", "idA", "idA", "--out", tmp_path / "same", "--quiet", cwd=folders, expect=1)
    _, text = page(tmp_path / "same")
    assert "nothing has changed" in text and "is in both calibrations" in text


@pytest.mark.slow
def test_export(folders: Path) -> None:
    html, text = page(folders / "lean")
    found = record(folders / "lean", "export.json")
    rows = {r[0]: r[1:] for r in cells(html, "What is written")[1:]}
    assert set(rows) == set(found["parameters"])
    for name, (old, new, change, unit) in rows.items():
        a, b = found["old"][name], found["parameters"][name]
        assert (old, new) == (f"{a:.4f}", f"{b:.4f}")
        assert change == f"{b - a:+.4f}".replace("-", "−")
        assert unit == ("deg" if name.endswith("angle") else "mm")
    gain, (lack,) = found["gain"], found["not_expressed"]
    for stage in ("before", "after"):
        words = [r["words"] for r in specs(html)["Predicted error of position"]["rows"]]
        assert f"{gain[stage]['rms']:.4f} mm" in words
    cost = f"{lack['cost']['rms']:.4f} mm rms, {lack['cost']['max']:.4f} mm at most"
    assert cells(html, "Cost")[1] == [lack["what"], ", ".join(lack["parameters"]), cost]
    assert f"cannot be expressed: {lack['what']}: costs {cost}" in text
    assert "Written: klipper.cfg." in text and found["over"] in text
    assert all(n[1:].rstrip(".") in text for n in (*found["notes"], *found["advice"]))


@pytest.mark.slow
def test_export_without_numbers(folders: Path) -> None:
    html, text = page(folders / "grid")
    gain = record(folders / "grid", "export.json")["gain"]
    table = next(t for t in re.findall(r"<table.*?</table>", html) if "rotation, new" in t)
    assert f"{gain['after']['rotation']['max']:.5f}" in table
    assert "What is written" not in html and not re.search("things? that .* cannot", text)
    assert "Nothing needs a closer look" in text


@pytest.mark.slow
def test_worse_numbers_are_told(folders: Path, tmp_path: Path) -> None:
    found = record(folders / "grid", "export.json")
    found["gain"]["before"], found["gain"]["after"] = (found["gain"][s]
                                                       for s in ("after", "before"))
    (tmp_path / "export.json").write_text(json.dumps(found))
    assert "the new pose grid numbers are worse than the old ones" in page(tmp_path)[1]


@pytest.mark.slow
def test_touches_alone_say_how_well_the_size_is_known_whatever_was_held(folders: Path) -> None:
    """What predicts touches best holds the rods, which does not make a length of a drawing exact.
    """
    found = record(folders / "touches", "identification.json")
    scale = found["identifiability"]["scale"]
    assert "rod" not in {p["name"] for p in found["parameters"] if p["status"] != "fixed"}
    assert scale["open"] and scale["sigma"] > 1e-3 * scale["distance"]
    assert f"a distance of {scale['distance']:.4g} mm is known to" in page(folders / "touches")[1]


@pytest.mark.slow
def test_what_is_not_told_in_the_words_of_the_console(folders: Path, tmp_path: Path) -> None:
    """Touches alone, rods free: else what predicts touches best holds the rods, and the size."""
    free = [word for name in ("offset", "length", "point.*") for word in ("--free", f"*.{name}")]
    run = ppmcal("identify", "imported/machine.yaml", "imported/heights.csv", *free, "--prior",
                 "flat", "--out", tmp_path / "o", cwd=folders, expect=1)
    said = " ".join(run.out.split())
    html, _ = page(tmp_path / "o")
    block = html.partition("Identifiability</h3>")[2].partition("</ul>")[0]
    lines = re.findall(r"<li>(.*?)</li>", block)
    assert [t.split(" ")[0] for t in lines][:2] == ["Scale:", "length"]
    assert all(t.replace("±", "+-") in said for t in lines)


@pytest.mark.slow
def test_console_and_report_say_one_sentence(folders: Path, tmp_path: Path) -> None:
    run = ppmcal("compare", "idA", "idB", "--out", tmp_path / "c", cwd=folders, expect=1)
    found = ComparisonRecord.read(tmp_path / "c" / "comparison.json")
    _, text = page(tmp_path / "c")
    for sentence in (verdict_sentence(found), platform_sentence(found)):
        assert sentence and sentence in " ".join(run.out.split())
        assert typeset(sentence) in text
    run = ppmcal("identify", "3-RPR.yaml", "A/measurements.csv", "--out", tmp_path / "i",
                 cwd=folders, expect=0)
    fit = IdentificationRecord.read(tmp_path / "i" / "identification.json")
    verdict, fine = noise_verdict(fit.noise)
    assert fine and verdict in " ".join(run.out.split())
    html, text = page(tmp_path / "i")
    assert typeset(verdict[1:]) in text
    shown = html.partition("Redundant combinations</h3>")[2].partition("</table>")[0]
    rows = re.findall(r'<tr><th scope="row">(.*?)</th><td class="wrap">(.*?)</td></tr>', shown)
    assert [re.sub("<wbr>", "", name) for name, _ in rows] == [c.name for c in fit.redundant]
    assert [t for _, t in rows] == [typeset(combination(c)) for c in fit.redundant]


@pytest.mark.slow
def test_rows_that_do_not_belong(folders: Path) -> None:
    html, text = page(folders / "fit")
    found = record(folders / "fit", "identification.json")
    (row,) = found["gross_errors"]["rows"]
    assert cells(html, "What those rows say")[1] == [
        "heights", "8", "height", "−0.9",
        f"{row['predicted']:.6g}".replace("-", "−"), "mm", sig(row["times"])]
    shown = {r[0]: r[1:] for r in cells(html, "What parameters would be")[1:]}
    assert set(shown) == set(found["gross_errors"]["would_be"])
    for name, e in found["gross_errors"]["would_be"].items():
        unit = next(p["unit"] for p in found["parameters"] if p["name"] == name)
        assert shown[name] == [f"{e['now']:.6g}", f"{e['with_them']:.6g}", unit]
    assert "Gross errors" in text


@pytest.mark.slow
def test_moved_zeros_unchecked_rows_and_flats(folders: Path, tmp_path: Path) -> None:
    found = record(folders / "touches", "identification.json")
    found["gross_errors"] |= {
        "homing_shifts": [{"session": "tuesday", "actuator": "a", "value": 0.25, "sigma": 0.01,
                         "unit": "mm", "p_value": 1e-9}],
        "unchecked": [{"dataset": "calipers", "rows": [3]}]}
    found["flats"] = [{"dataset": "heights", "smooth": 0.021, "scatter": 0.004, "degree": 2,
                       "p_value": 1e-5, "unit": "mm"}]
    (tmp_path / "identification.json").write_text(json.dumps(found))
    _, text = page(tmp_path)
    for piece in ("the homing offset of a shifted in tuesday: by +0.25 ± 0.02 mm against",
                  "calipers: row 3 has no backup: a wrong reading there would go unnoticed",
                  "heights: 0.021 mm rms of what is left is smooth over the flat",
                  "touches scatter 0.004 mm about it (p = 1·10⁻⁵)"):
        assert piece in text, piece


@pytest.mark.slow
def test_all_on_one_page(folders: Path) -> None:
    dirs = [folders / d for d in ("idA", "idB", "cmp", "grid", "lean", "fit")]
    html, _ = page(*dirs)
    order = [html.index(f"<h2>{h}") for h in (
        "Calibration of", "Export: pose grid", "Export: Klipper", "Comparison of two",
        "Where this comes from")]
    assert order == sorted(order)
    out = to_json(collect(dirs))
    assert out["comparisons"][0]["comparison"] == record(folders / "cmp", "comparison.json")
    assert [e["export"]["controller"] for e in out["exports"]] == ["grid", "klipper"]
    json.dumps(out, allow_nan=False)


@pytest.mark.long_cases("fit/identification.json")
@pytest.mark.parametrize("source", ["fit/identification.json", "cmp/comparison.json",
                                    "lean/export.json"])
@pytest.mark.slow
def test_older_files_make_a_page(folders: Path, tmp_path: Path, source: str) -> None:
    """Without what older versions did not write, all at once, and without any one key."""
    found = record(folders, source)
    name = Path(source).name
    older = {k: v for k, v in found.items() if k not in LATER[name]}
    for variant in (older, *({k: v for k, v in found.items() if k != drop} for drop in found),
                    *({**found, empty: None} for empty in found), {}):
        (tmp_path / name).write_text(json.dumps(variant))
        page(tmp_path)
        to_json(collect([tmp_path]))


ODD: tuple[Any, ...] = (None, "", "x<b>", -1, 0, 1e300, -1e139, 10**400, float("nan"), True, [],
                        {}, [None], {"rms": 1}, "\ud800")


def places(value: Any, put: Callable[[Any], None] | None = None) -> list[Callable[[Any], None]]:
    """Return one setter for each value in a JSON, however deep."""
    out = [put] if put else []
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(min(len(value), 2)):
            def setter(new: Any, at: Any = value, key: Any = key) -> None:
                at[key] = new
            out += places(value[key], setter)
    return out


@pytest.mark.long_cases("cmp/comparison.json", "grid/export.json", "lean/export.json")
@pytest.mark.slow
@pytest.mark.parametrize("source", ["fit/identification.json", "touches/identification.json",
                                    "cmp/comparison.json", "lean/export.json",
                                    "grid/export.json"])
def test_mangled_json_never_ends_in_a_traceback(folders: Path, tmp_path: Path, source: str
                                                ) -> None:
    """Each value in turn is replaced: the page is made, or the file refused by name."""
    name, rng = Path(source).name, random.Random(5)
    text = (folders / source).read_text()
    made = refused = 0
    found = json.loads(text)
    keep = LATER[name] if name == "identification.json" else tuple(found)
    for i in range(len(places({k: found[k] for k in keep}))):
        for odd in rng.sample(ODD, 4):
            whole = json.loads(text)
            part = {k: whole[k] for k in keep}
            places(part)[i](odd)
            (tmp_path / name).write_text(json.dumps({**whole, **part}))
            try:
                data = collect([tmp_path])
                html = to_html(data)
                to_json(data)
            except BadInput as error:
                assert name in str(error)
                refused += 1
            else:
                read(html)
                made += 1
    assert made and refused
