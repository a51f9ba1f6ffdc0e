"""Figures and tables for papers: widths, letters, fonts, colours, captions, the same bytes."""

from __future__ import annotations

import csv
import json
import re
import zlib
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.commands import ppmcal, ppmcal_process
from helpers.latex import faults
from helpers.paths import ROOT
from PIL import Image

import ppmcal as face
from ppmcal.errors import BadInput
from ppmcal.plotting import paper as printed
from ppmcal.plotting.layers import Dots, Marks, Polyline
from ppmcal.plotting.plot import Axis, Plot
from ppmcal.plotting.style import AFTER, BEFORE, OUT
from ppmcal.report import collect
from ppmcal.report.kinds import IN_ORDER
from ppmcal.report.paper import PaperTable, Sheet, captions, rounded, tables, tex

MM = 25.4 / 72.0
POSES = "x,y,rz\n500,290,30\n520,300,28\n480,310,33\n"


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a fit of a planar stage, another of it, what they say and a path."""
    out = tmp_path_factory.mktemp("paper")
    ppmcal("init", "3-RPR", "--out", "mine.yaml", cwd=out, expect=0)
    (out / "poses.csv").write_text(POSES)
    day = (ROOT / "tests" / "report" / "test_machine_section.py").read_text(encoding="utf-8")
    text = re.search(r'DAY = """(.*?)"""', day, re.S)[1]    # type: ignore[index]
    for n, seed in (("1", "seed: 7"), ("2", "seed: 8")):
        (out / f"day{n}.yaml").write_text(text.replace("COUNT", "30").replace("seed: 7", seed))
        ppmcal("simulate", "mine.yaml", f"day{n}.yaml", "--out", f"sim{n}", cwd=out)
        ppmcal("identify", "mine.yaml", f"sim{n}/measurements.csv", "--out", f"fit{n}", cwd=out)
    ppmcal("compare", "fit1", "fit2", "--out", "compared", cwd=out)
    ppmcal("validate", "fit1", "sim2/measurements.csv", "--out", "validated", cwd=out)
    ppmcal("kinematics", "inverse", "mine.yaml", "poses.csv", "--out", "path", cwd=out)
    ppmcal("compensate", "fit1", "poses.csv", "--out", "sent", cwd=out)
    return out


def figures(desk: Path, *words: str, out: str = "figures") -> dict[str, Path]:
    """Return the files that a command line writes, by name."""
    ppmcal("figures", *words, "--out", out, "--force", cwd=desk, expect=0)
    return {p.name: p for p in (desk / out).iterdir() if not p.name.startswith(".")}


def streams(pdf: bytes) -> list[bytes]:
    """Return what the streams of a PDF hold."""
    found = re.findall(rb"/Filter /FlateDecode.*?stream\r?\n(.*?)\r?\nendstream", pdf, re.S)
    return [zlib.decompress(f) for f in found]


def page_of(pdf: bytes) -> tuple[float, float]:
    """Return width and height of the one page, mm."""
    (box,) = re.findall(rb"/MediaBox \[([^\]]*)\]", pdf)
    _, _, wide, high = map(float, box.split())
    return wide * MM, high * MM


def letters_of(pdf: bytes) -> set[float]:
    """Return the sizes of letters on the page, points."""
    content = next(s for s in streams(pdf) if b" Tf" in s)
    (scale,) = re.findall(rb"^([\d.]+) 0 0 \1 0 0 cm$", content, re.M)
    return {float(scale) * float(size) for size in re.findall(rb"/F\d+ ([\d.]+) Tf", content)}


EVERY = ("fit1", "validated", "compared", "path", "sent", "sim1")


@pytest.mark.parametrize(("width", "folders"), [(84.0, EVERY), (174.0, ("fit1",))],
                         ids=["one column", "two columns"])
@pytest.mark.long
def test_pdf_is_as_wide_as_asked_with_embedded_fonts_and_letters_of_seven_to_eight_points(
        desk: Path, width: float, folders: tuple[str, ...]) -> None:
    found = figures(desk, *folders, "--width", f"{width:g}mm")
    drawn = [p.read_bytes() for name, p in found.items() if name.endswith(".pdf")]
    assert len(drawn) > (15 if folders == EVERY else 5)
    for pdf in drawn:
        assert pdf.startswith(b"%PDF-") and pdf.rstrip().endswith(b"%%EOF")
        wide, high = page_of(pdf)
        assert abs(wide - width) < 0.1 and 15.0 < high < 1.2 * width + 20.0
        assert pdf.count(b"/Type /FontDescriptor") == pdf.count(b"/FontFile2") > 0
        assert not re.search(rb"/Subtype /Type3|/Date|/Creat|/Produc|/Title", pdf)
        assert {7.0 <= size <= 8.01 for size in letters_of(pdf)} == {True}


@pytest.mark.long
def test_svg_is_xml_with_text_and_the_same_shapes_and_png_has_its_size(desk: Path) -> None:
    for form in ("svg", "png"):
        found = figures(desk, "fit1", "--format", form, out=form)
        for name, path in found.items():
            if name.endswith(".svg"):
                root = ElementTree.parse(path).getroot()
                wide, high = (float(v) for v in root.get("viewBox", "").split()[2:])
                assert root.get("width") == "84mm"
                assert float(root.get("height", "").removesuffix("mm")) == pytest.approx(
                    84.0 * high / wide, abs=0.05)
                shown = list(root.iter("{http://www.w3.org/2000/svg}text"))
                styles = [f"font-size:11px;{t.get('style') or ''}" for t in shown]
                sizes = [float(re.findall(r"font-size:([\d.]+)px", s)[-1]) * 84.0 / MM / wide
                         for s in styles]
                assert shown and all(6.99 < s < 8.01 for s in sizes)
            elif name.endswith(".png"):
                with Image.open(path) as picture:
                    dots = picture.info["dpi"][0]
                    assert dots == pytest.approx(printed.DPI, abs=0.1)
                    assert picture.width / dots * 25.4 == pytest.approx(84.0, abs=0.1)


@pytest.mark.long
def test_the_same_bytes_come_twice_from_another_process(desk: Path) -> None:
    first = {n: p.read_bytes() for n, p in figures(desk, "fit1").items()}
    ppmcal_process("figures", "fit1", "--out", "again", cwd=desk, expect=0)
    again = {p.name: p.read_bytes() for p in (desk / "again").iterdir()
             if not p.name.startswith(".")}
    assert first == again
    run = ppmcal("verify", "again", cwd=desk, expect=0)
    assert "again" in run.out


@pytest.mark.slow
def test_page_and_files_have_the_same_drawings(desk: Path) -> None:
    """Each kind declares its drawings once."""
    data = collect([desk / f for f in EVERY])
    titles = [d.title for kind in IN_ORDER for one in kind.of(data)
              for group, some in kind.drawings(one, data).items() for d in some
              if group != "machine"]
    ppmcal("report", *EVERY, "--out", "page", "--force", cwd=desk)
    page = (desk / "page" / "report.html").read_text(encoding="utf-8")
    shown = re.findall(r'<figure class="plot">.*?<figcaption><b>(.*?)\.</b>', page, re.S)
    assert sorted(shown) == sorted(titles) and len(titles) > 15


@pytest.mark.slow
def test_names_captions_and_only(desk: Path) -> None:
    found = figures(desk, "fit1", "--only", "machine", "--only", "residual-of-?-*", "--only",
                    "errors")
    assert set(found) == {
        "the-machine-at-home.pdf", "residual-of-x-by-row-after.pdf",
        "residual-of-y-by-row-after.pdf", "errors.tex", "errors.md", "captions.md",
        "captions.tex"}
    words = found["captions.md"].read_text(encoding="utf-8")
    assert "**the-machine-at-home**: The machine at home. Circles: joints" in words
    latex = found["captions.tex"].read_text(encoding="utf-8")
    assert latex.count(r"\begin{figure}") == 3 == latex.count(r"\includegraphics{")
    assert r"\includegraphics{the-machine-at-home}" in latex and r"\input{errors}" in latex
    assert r"$\pm$2 sigma" in latex and "±" not in latex
    # what other files of the folder are called stands before the name
    several = figures(desk, "fit1", "fit2", "--only", "parameters", out="several")
    assert set(several) == {"fit1-parameters.tex", "fit1-parameters.md", "fit2-parameters.tex",
                            "fit2-parameters.md", "captions.md", "captions.tex"}


@pytest.mark.slow
@pytest.mark.parametrize(("words", "told", "hint"), [
    (("--width", "84"), "", ""),
    (("--width", "8.4cm"), "", ""),
    (("--width", "wide"), "'wide' is not a width", "such as 84mm or 3.5in"),
    (("--width", "2mm"), "'2mm' is out of range", "84mm (one column)"),
    (("--width", "9in"), "", ""),
    (("--width", "20in"), "'20in' is out of range", "60mm to 400mm"),
    (("--format", "eps"), "eps", "pdf"),
    (("--only", "residuls"), "unknown figure 'residuls'", "Did you mean 'residuals'?"),
])
def test_refusals_say_what_to_write(desk: Path, words: tuple[str, ...], told: str,
                                    hint: str) -> None:
    run = ppmcal("figures", "fit1", "--only", "errors", *words, "--out", "refused", "--force",
                 cwd=desk, expect=2 if told else 0)
    said = " ".join((run.out + run.err).split())
    assert told in said and hint in said


@pytest.mark.long
def test_a_batch_has_the_figures_of_all_its_campaigns(desk: Path) -> None:
    """Called by machine, date and command; the same as of each folder alone."""
    (desk / "fleet.yaml").write_text(
        "format: ppmcal/batch/1\nmodel: mine.yaml\ncampaigns:\n" + "".join(
            f"  - {{machine: {m}, date: 2026-03-1{n}, data: sim{n}/measurements.csv}}\n"
            for m, n in (("a", 1), ("a", 2), ("b", 2))))
    ppmcal("batch", "fleet.yaml", "--cores", "1", "--out", "batch", cwd=desk, expect=None)
    found = figures(desk, "batch", "--only", "tables", "--only", "comparison", out="all")
    days = ("a-2026-03-11", "a-2026-03-12", "b-2026-03-12")
    assert {f"{day}-identify-{table}.tex" for day in days
            for table in ("parameters", "errors")} <= set(found)
    assert any(name.startswith("a-2026-03-12-compare-identify-") for name in found)
    alone = figures(desk, "batch/b/2026-03-12/identify", "--only", "tables", out="single")
    assert (found["b-2026-03-12-identify-parameters.tex"].read_bytes()
            == alone["parameters.tex"].read_bytes())
    refused = ppmcal("report", "batch", "--out", "page", cwd=desk, expect=2)
    assert "batch.html" in refused.err and "batch/a/2026-03-11/identify" in refused.err


def test_a_folder_without_figures_is_refused(tmp_path: Path) -> None:
    (tmp_path / "check.json").write_text(json.dumps({"format": "ppmcal/check/1"}))
    with pytest.raises(BadInput, match="no figure and no table") as caught:
        face.make_figures(tmp_path)
    assert "identify" in caught.value.hint
    with pytest.raises(BadInput, match="unknown format 'eps'"):
        face.make_figures(tmp_path, form="eps")


def numbers(cell: str) -> float:
    return float(cell.replace("$-$", "-").replace("−", "-"))


def markdown(path: Path) -> list[list[str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return [[c.strip() for c in line.strip("|").split(" | ")] for line in lines if
            not line.startswith("| ---")]


@pytest.mark.slow
def test_tables_have_the_numbers_of_the_csv_with_the_decimals_of_their_intervals(
        desk: Path) -> None:
    found = figures(desk, "fit1", "--only", "tables")
    heads, *rows = markdown(found["parameters.md"])
    assert heads == ["parameter", "value", "± 95 %", "change", "unit", "status"]
    tex_rows = [line.removesuffix(r" \\").split(" & ") for line in
                found["parameters.tex"].read_text(encoding="utf-8").splitlines() if " & " in line]
    with (desk / "fit1" / "parameters.csv").open(encoding="utf-8") as stream:
        table = [r for r in csv.DictReader(stream) if r["status"] != "fixed"]
    assert len(table) == len(rows) == len(tex_rows) - 1 > 10
    for row, latex, true in zip(rows, tex_rows[1:], table, strict=True):
        assert [tex(c.replace("\\", "")) for c in row] == latex
        assert row[0].replace("\\", "") == true["name"] and row[4:] == [true["unit"],
                                                                       true["status"]]
        half = 0.5 * (float(true["high"]) - float(true["low"]))
        step = 10.0 ** -len(row[2].partition(".")[2])
        assert {len(c.partition(".")[2]) for c in row[1:4]} == {len(row[2].partition(".")[2])}
        for cell, value in zip(row[1:4], (float(true["value"]), half, float(true["error"])),
                               strict=True):
            assert abs(numbers(cell) - value) <= 0.5001 * step, (row, value)
        assert 9.5 <= half / step < 100.0 or half >= 100.0
    record = json.loads((desk / "fit1" / "identification.json").read_text())["residual"]
    heads, *rows = markdown(found["errors.md"])
    assert heads == ["error", "mean", "rms", "p95", "max", "unit"]
    names = {"before": "before", "after": "after", "held out": "holdout"}
    assert {r[0].partition(", ")[2] for r in rows} == set(names)
    for row in rows:
        kind, _, stage = row[0].partition(", ")
        for head, cell in zip(heads[1:5], row[1:5], strict=True):
            true = record[names[stage]][kind].get(head)
            assert cell == "–" if true is None else numbers(cell) == pytest.approx(true, rel=6e-3)
    assert r"\toprule" in found["errors.tex"].read_text()


@pytest.mark.parametrize(("text", "fault"), [
    (r"\begin{tabular}{lr}a & b & c \\ \end{tabular}", "3 cells in 2 columns"),
    (r"\begin{tabular}{lr}a \\ \end{tabular}", "1 cells in 2 columns"),
    (r"\begin{tabular}{lr}a & b \end{tabular}", "without"),
    (r"\begin{table}\end{figure}", "figure is closed"), (r"\begin{table}", "is open at the end"),
    ("leg_1", "_ outside of mathematics"), ("5 % more", "% as it stands"), ("a & b", "& outside"),
    ("#3", "# as it stands"), ("a {b", "{ is open"), ("5$^{-3}", "mathematics is open"),
    (r"\foo", r"\foo in text"), ("a < b", "another letter"),
    ("\\begin{tabular}{l}a \\\\\n[b] \\\\\n\\end{tabular}", "is taken by"),
    ("5 µm", "needs a package"), (r"\input{a_b}", "no plain name")])
def test_the_reader_of_latex_notices_what_an_engine_would(text: str, fault: str) -> None:
    assert any(fault in one for one in faults(text)), faults(text)


@pytest.mark.long
def test_tables_and_captions_are_latex(desk: Path) -> None:
    """Of every kind of figure, by a reader of its own: where no engine is, none is needed."""
    found = figures(desk, "fit1", "fit2", "compared", "validated", "path", "sent", out="every")
    written = {name: p.read_text(encoding="utf-8") for name, p in found.items()
               if name.endswith(".tex")}
    assert len(written) == 5    # parameters and errors of two fits, and captions
    assert {name: faults(text) for name, text in written.items() if faults(text)} == {}
    for name, text in written.items():
        assert ("tabular" in text) == (name != "captions.tex")


HOSTILE = "[1] < 50%_&_#1 $x$ {leg} ~ ^2 \\end{tabular} 5·10⁻³ µm ±σχ² → …"


def test_names_that_mean_something_to_latex_are_words() -> None:
    """Names of limbs, data sets and folders are whatever people write."""
    table = PaperTable("t", HOSTILE, (HOSTILE, "value"), ((HOSTILE, "−3.0"), ("b", HOSTILE)),
                       frozenset({1}))
    sheet = Sheet("t", "t", "tables", table)
    assert faults(table.tex()) == []
    assert faults(captions([sheet])["captions.tex"]) == []
    body = table.tex().splitlines()
    assert sum(line.endswith(r"\\") for line in body) == 3


def test_effects_are_rows_and_what_is_fixed_is_counted(tmp_path: Path) -> None:
    parameter = {"nominal": 0.0, "value": 0.0291, "error": 0.0291, "sigma": 0.001, "low": 0.027,
                 "high": 0.0312, "unit": "mm", "status": "identified"}
    (tmp_path / "identification.json").write_text(json.dumps({
        "format": "ppmcal/identification/1", "name": "m", "parameters": [
            parameter | {"name": "backlash.leg_2.width"},
            parameter | {"name": "a.z", "low": None, "high": None, "sigma": None},
            parameter | {"name": "b.z", "status": "fixed"}]}))
    (made,) = tables(collect([tmp_path]).identified[0])
    assert made.rows[0] == ("backlash.leg_2.width", "0.0291", "0.0021", "0.0291", "mm",
                            "identified")
    assert made.rows[1][2] == "–" and len(made.rows) == 2 and "1 more were held" in made.caption
    assert r"backlash.leg\_2.width & 0.0291 & 0.0021" in made.tex()
    assert [rounded(v) for v in (None, 0.0996, 123.4, float("nan"))] == [0.0, 0.1, 120.0, 0.0]


def plot(name: str = "line", title: str = "A plot") -> Any:
    at = np.array([1.0, 2.0])
    return Plot(Axis(0.0, 3.0), Axis(0.0, 3.0), (name, "y"), [
        Dots(at, at, "before"), Marks(at, 2.0 * at, "after", "s"), Polyline(at, at, name)]).drawing(
        title, "Caption.", "Words.", (("before", "geometry alone"), ("after", "with it")))


def test_there_is_a_legend_and_no_title() -> None:
    text = str(printed.paper(plot(), 84.0, "svg"))
    shown = [t.text for t in ElementTree.fromstring(text).iter("{http://www.w3.org/2000/svg}text")]
    assert {"geometry alone", "with it", "line", "y"} <= set(shown) and "A plot" not in shown


@pytest.mark.slow
def test_letters_without_a_glyph_are_no_boxes() -> None:
    assert printed.known("leg 脚 ±10⁻³ …") == "leg ? ±10⁻³ …"
    strange, known = (printed.paper(plot(name), 84.0, "pdf") for name in ("脚", "?"))
    assert strange == known
    assert "脚" in str(printed.paper(plot("脚"), 84.0, "svg"))


def test_colours_can_be_told_in_grey_and_by_the_colour_blind() -> None:
    """Lightness L* of before and after differ by a third of the scale."""
    def lightness(colour: str) -> float:
        parts = np.array([int(colour[i:i + 2], 16) / 255.0 for i in (1, 3, 5)])
        linear = np.where(parts > 0.04045, ((parts + 0.055) / 1.055) ** 2.4, parts / 12.92)
        return float(116.0 * np.cbrt(linear @ [0.2126, 0.7152, 0.0722]) - 16.0)

    before, after, out = (lightness(printed.PRINTED[c]) for c in (BEFORE, AFTER, OUT))
    assert before - after > 33.0 and before < 70.0 and out - after > 10.0
    text = str(printed.paper(plot(), 84.0, "svg"))
    assert not any(colour in text for colour in (BEFORE, AFTER, OUT))
    assert all(printed.PRINTED[colour] in text for colour in (BEFORE, AFTER))
