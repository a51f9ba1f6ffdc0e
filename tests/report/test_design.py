"""Sections of the report on sensitivity, tolerances, stiffness, workspace and plans."""

from __future__ import annotations

import base64
import json
import os
import re
import struct
import zlib
from pathlib import Path
from typing import Any

import pytest
from helpers.commands import ppmcal
from helpers.paths import ROOT
from helpers.report_files import cells, read

from ppmcal.errors import BadInput
from ppmcal.plotting.curves import draw_curves
from ppmcal.report import collect, to_html, to_json
from ppmcal.report.design import DESIGNS, LARGEST_FILE, MOST, OTHER, SHOWN, png_size
from ppmcal.report.kinds import KNOWN

TABLES = {"sensitivity": "sensitivity.csv", "tolerances": "tolerances.csv",
          "stiffness": "map.csv", "workspace": "map.csv", "plan": "poses.csv"}


def chunk(kind: bytes, body: bytes) -> bytes:
    """Return one piece of a PNG with its check sum."""
    return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))


def png(width: int = 3, height: int = 2) -> bytes:
    """Return a small grey picture, or one that only says that it is large."""
    rows = b"".join(b"\0" + b"\x80" * min(width, 9) for _ in range(min(height, 9)))
    return (b"\x89PNG\r\n\x1a\n"
            + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0))
            + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def record(kind: str) -> dict[str, Any]:
    """Return a record as a command writes it."""
    return {
        "format": f"ppmcal/{kind}/1", "name": "bench", "said": [
            f"The {kind} is 1.25 mm at home.", "It is less elsewhere."],
        "units": {"x": "mm", "share": "1"}, "findings": [f"{kind}: home is near-singular"],
        "pictures": {"map_a.png": "a over x and y"},
        "tables": [{"title": "Largest first", "columns": ["name", "x", "share", "felt", "text"],
                    "rows": [["leg1.offset", 0.5, 0.25, True, "11.40"],
                             ["leg2.offset", 12.75, None, False, "-3"]], "note": "rounded"}],
        "later": {"nested": [1, 2]}, "seed": 3,
        "provenance": {"command": f"ppmcal {kind} m.yaml", "version": "0", "seed": 3,
                       "inputs": {"m.yaml": "a" * 64}}}


def write(folder: Path, kind: str, content: dict[str, Any] | None = None, **change: Any) -> Path:
    """Write one command's folder."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {**(record(kind) if content is None else content), **change}
    (folder / f"{kind}.json").write_text(json.dumps(content))
    (folder / TABLES[kind]).write_text("x,y,status\n1,2,ok\n3,4,\n")
    (folder / "map_a.png").write_bytes(png())
    return folder


@pytest.mark.parametrize("kind", DESIGNS)
def test_each_command_has_its_section(tmp_path: Path, kind: str) -> None:
    folder = write(tmp_path / "out", kind)
    data = collect([folder])
    assert len(data.designed) == 1
    assert not OTHER.of(data)
    html = to_html(data)
    page = read(html)
    text = "".join(page.text)
    assert html.count(f"<h2>{DESIGNS[kind].TITLE}") == 1
    for piece in ("is 1.25 mm at home.", "It is less elsewhere.", f"2 rows in {TABLES[kind]}",
                  f"{kind}: home is near-singular", "A over x and y.", "Rounded.",
                  f"ppmcal {kind} m.yaml", "a" * 64, "Error analysis: bench"):
        assert piece in text, piece
    heads, first, second = cells(html, "Largest first")
    assert heads == ["name", "x, mm", "share", "felt", "text"]
    assert first == ["leg1.offset", "0.5000", "0.25", "yes", "11.40"]
    assert second == ["leg2.offset", "12.75", "–", "no", "−3"]
    (image,) = [v for tag, k, v in page.attributes if (tag, k) == ("img", "src")]
    assert base64.b64decode(image.removeprefix("data:image/png;base64,")) == png()
    (alt,) = [v for tag, k, v in page.attributes if (tag, k) == ("img", "alt")]
    assert alt == f"{DESIGNS[kind].TITLE}: A over x and y."


def test_report_json_holds_the_record(tmp_path: Path) -> None:
    folder = write(tmp_path, "stiffness", pictures={"map_a.png": "a", "map_b.png": "b"})
    out = json.loads(json.dumps(to_json(collect([folder]))))
    (design,) = out["designs"]
    assert design["record"]["later"] == {"nested": [1, 2]}
    assert design["kind"] == "stiffness"
    assert design["rows"] == {"map.csv": 2}
    assert [(p["file"], p["size"], p["problem"]) for p in design["pictures"]] == [
        ("map_a.png", [3, 2], ""), ("map_b.png", [0, 0], "missing")]
    assert out["headline"] == ["Stiffness: The stiffness is 1.25 mm at home."]
    assert [a["what"] for a in out["attention"]] == [
        "stiffness: home is near-singular", "the picture map_b.png is missing"]
    assert out["title"] == "Error analysis: bench"


def test_all_commands_in_one_folder_and_each_in_its_own(tmp_path: Path) -> None:
    for kind in DESIGNS:
        write(tmp_path / "one", kind)
        write(tmp_path / kind, kind)
    together = collect([tmp_path / "one"])
    apart = collect([tmp_path / kind for kind in DESIGNS])
    assert [d.kind for d in together.designed] == [d.kind for d in apart.designed] == [*DESIGNS]
    assert not OTHER.of(together) and not OTHER.of(apart)
    read(to_html(together))


@pytest.mark.parametrize(("file", "kind"), [
    ("map.csv", "map"), ("poses.csv", "plan"), ("sensitivity.csv", ""), ("tolerances.csv", ""),
    ("check.json", "check"), ("poses.json", "plan")])
def test_one_file_alone_is_recognised_once(tmp_path: Path, file: str, kind: str) -> None:
    (tmp_path / file).write_text("{}" if file.endswith("json") else "x,y\n1,2\n")
    data = collect([tmp_path])
    assert [o.kind for o in OTHER.of(data)] == ([kind] if kind else [])
    assert len(OTHER.of(data)) + len(data.designed) == 1
    read(to_html(data))


def test_every_file_is_known() -> None:
    assert {f"{kind}.json" for kind in DESIGNS} < set(KNOWN)
    assert len(set(KNOWN)) == len(KNOWN)


def test_identification_comes_first(tmp_path: Path) -> None:
    from helpers.report_files import identification, write_fit

    fit = write_fit(tmp_path / "fit", identification())
    data = collect([write(tmp_path / "ws", "workspace"), fit])
    html = to_html(data)
    assert html.index("<h3>Parameters") < html.index("<h2>Workspace")
    assert "<title>Calibration report" in html
    assert "Workspace and singularities: The workspace is" in to_json(data)["headline"][-1]


def test_long_tables_are_cut_and_say_so(tmp_path: Path) -> None:
    rows = [[i, 0.1 * i] for i in range(SHOWN + 7)]
    folder = write(tmp_path, "plan", tables=[{"title": "Poses", "columns": ["pose", "x"],
                                              "rows": rows, "note": ""}])
    html = to_html(collect([folder]))
    assert len(cells(html, "Poses")) == 1 + SHOWN
    assert f"The first {SHOWN} of {SHOWN + 7} rows; plan.json has them all." in html


@pytest.mark.parametrize("drop", sorted(record("stiffness")))
def test_any_key_may_be_missing_or_null(tmp_path: Path, drop: str) -> None:
    content = record("stiffness")
    del content[drop]
    read(to_html(collect([write(tmp_path, "stiffness", content)])))
    html = to_html(collect([write(tmp_path, "stiffness", content | {drop: None})]))
    read(html)
    if drop == "said":
        # plain numbers stand in for the sentences
        assert 'seed</th><td class="wrap">3</td>' in html
    if drop == "pictures":
        assert html.count("<img ") == 1  # without a list, all of the folder


def test_empty_parts_make_a_page(tmp_path: Path) -> None:
    for change in ({"tables": [{}]}, {"tables": [{"title": "T", "columns": ["a"], "rows": []}]},
                   {"tables": [], "said": [], "pictures": {}, "findings": []},
                   {"tables": [{"columns": [], "rows": [[], []]}]}):
        read(to_html(collect([write(tmp_path, "plan", **change)])))
    (tmp_path / "plan.json").write_text("{}")
    assert "Results found: error analysis" in to_html(collect([tmp_path]))


def test_odd_numbers(tmp_path: Path) -> None:
    text = json.dumps(record("plan"))
    first = '["leg1.offset", 0.5, 0.25, true, "11.40"]'
    assert first in text
    folder = write(tmp_path, "plan")
    (folder / "plan.json").write_text(text.replace(
        first, '["a", null, -1e300, 1e300, "nan"], ["b", -0.0, 1e-300, 1e300, "inf"]'))
    rows = cells(to_html(collect([folder])), "Largest first")
    assert rows[1][1] == rows[1][4] == "–"
    assert rows[2][4] == "∞"
    assert "nan" not in "".join(read(to_html(collect([folder]))).text).lower()
    for odd in ("NaN", "Infinity", "-Infinity", "1e999"):
        (folder / "plan.json").write_text(text.replace(first, f'["a", {odd}, 0.25, true, "1"]'))
        with pytest.raises(BadInput, match=r"tables\[0\]\.rows\[0\]\[1\]: should be a number"):
            collect([folder])


BROKEN = {
    '{"said": [': "plan.json: line 1, column", "[]": "plan.json",
    '{"said": "a"}': "plan.json: said",
    '{"said": [1]}': r"plan.json: said\[0\]", '{"findings": {}}': "plan.json: findings",
    '{"pictures": ["a.png"]}': "plan.json: pictures",
    '{"pictures": {"a.png": 3}}': "pictures.a.png",
    '{"tables": {}}': "plan.json: tables", '{"tables": [null]}': r"tables\[0\]",
    '{"tables": [{"columns": [3]}]}': r"tables\[0\].columns\[0\]",
    '{"tables": [{"rows": [3]}]}': r"tables\[0\].rows\[0\]",
    '{"tables": [{"columns": ["a"], "rows": [[1], [1, 2]]}]}': r"tables\[0\].rows\[1\]",
    '{"tables": [{"columns": ["a"], "rows": [[{"b": 1}]]}]}': r"tables\[0\].rows\[0\]\[0\]",
    '{"units": {"x": 1}}': "units.x", '{"name": 7}': "plan.json: name",
    '{"provenance": {"inputs": 3}}': "provenance.inputs"}


@pytest.mark.parametrize("text", BROKEN)
def test_broken_json_is_refused_with_its_place(tmp_path: Path, text: str) -> None:
    (tmp_path / "plan.json").write_text(text)
    with pytest.raises(BadInput, match=BROKEN[text]):
        to_html(collect([tmp_path]))
    run = ppmcal("report", tmp_path, "--out", tmp_path / "report", expect=2)
    assert "Traceback" not in run.err
    assert not (tmp_path / "report").exists()


def test_broken_table_is_refused(tmp_path: Path) -> None:
    folder = write(tmp_path, "workspace")
    (folder / "map.csv").write_text("x,y\n1,2\n3")
    with pytest.raises(BadInput, match=r"map\.csv"):
        collect([folder])


@pytest.mark.parametrize(("content", "problem"), ids=range(10), argvalues=[
    (b"", "not a PNG"), (b"GIF89a", "not a PNG"), (b"<svg onload='x'>", "not a PNG"),
    (png()[:-1], "cut off or damaged"), (png()[:20], "cut off or damaged"),
    (png()[:8], "cut off or damaged"), (png()[:45] + b"!" + png()[46:], "cut off or damaged"),
    (png()[:8] + chunk(b"IDAT", b"") + png()[8:], "cut off or damaged"),
    (png(0, 5), "0 by 5 dots"), (png(90_000, 90_000), "90000 by 90000 dots")])
def test_what_is_no_picture_is_left_out_with_a_word(tmp_path: Path, content: bytes, problem: str
                                                    ) -> None:
    assert problem in png_size(content)[1]
    folder = write(tmp_path, "sensitivity")
    (folder / "map_a.png").write_bytes(content)
    html = to_html(collect([folder]))
    assert "<img" not in html
    assert "map_a.png: left out: it" in html
    assert problem in html


def test_real_pictures_are_whole(tmp_path: Path) -> None:
    size, problem = png_size(draw_curves("t", "x", "y", [("a", [1.0, 2.0], [1.0, 2.0])]))
    assert not problem
    assert 500 < size[0] < 1500


def test_huge_pictures_are_left_out(tmp_path: Path) -> None:
    folder = write(tmp_path, "sensitivity")
    with (folder / "map_a.png").open("wb") as stream:
        stream.write(png())
        stream.truncate(LARGEST_FILE + 1)
    assert "map_a.png: left out: larger than 20 MB." in to_html(collect([folder]))
    names = {f"map_{i}.png": "" for i in range(MOST + 2)}
    for name in names:
        (folder / name).write_bytes(png())
    html = to_html(collect([write(tmp_path, "sensitivity", pictures=names)]))
    assert html.count("<img ") == MOST
    assert html.count("left out: the page takes") == 2


def test_pictures_outside_of_the_folder_stay_there(tmp_path: Path) -> None:
    (tmp_path / "secret.png").write_bytes(png())
    names = ["../secret.png", str(tmp_path / "secret.png"), "..\\secret.png", "..", "", "a\0.png"]
    folder = write(tmp_path / "out", "plan", pictures=dict.fromkeys(names, "x"))
    html = to_html(collect([folder]))
    assert "<img" not in html
    assert html.count("left out: it is not in this folder") == len(names)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_what_is_no_file_is_missing(tmp_path: Path) -> None:
    folder = write(tmp_path, "plan", pictures={"pipe.png": "", "dir.png": "", "a" * 300: ""})
    os.mkfifo(folder / "pipe.png")
    (folder / "dir.png").mkdir()
    html = to_html(collect([folder]))
    # in its place, and among what needs a look
    assert html.count(": missing.") == 2 and html.count(": cannot be read") == 2
    assert html.count("cannot be shown: cannot be read") == 1


def test_names_are_escaped(tmp_path: Path) -> None:
    evil = "<script>alert(1)</script>\"'& onerror=x"
    content = {"name": evil, "said": [evil], "units": {evil: evil}, "findings": [evil],
               "pictures": {"map_a.png": evil, evil.replace("/", "|"): evil},
               "tables": [{"title": evil, "columns": [evil], "rows": [[evil]], "note": evil}],
               "provenance": {"command": evil, "inputs": {evil: evil}}}
    html = to_html(collect([write(tmp_path, "tolerances", content)]))
    page = read(html)
    assert page.scripts == 1
    assert evil in "".join(page.text)
    assert not [a for a in page.attributes if a[1].startswith("on")]


def test_page_needs_nothing_else(tmp_path: Path) -> None:
    html = to_html(collect([write(tmp_path, "workspace")]))
    bare = re.sub(r'src="data:image/png;base64,[A-Za-z0-9+/=]*"', "", html)
    assert not re.search(r"https?:|//[a-z]|url\(|@import|src=", bare)
    style = html[html.index("<style>"):html.index("</style>")]
    assert re.search(r"\.picture\{background:#fff", style)  # a light card by night too
    assert re.search(r"\.picture img\{[^}]*max-width:100%", style)


@pytest.mark.long
def test_the_real_commands_are_reported(tmp_path: Path) -> None:
    """What the commands write now is what this section reads."""
    root = ROOT
    grid = ["--grid", "x=450:550:5,y=250:330:5"]
    runs = {"sensitivity": grid, "tolerances": ["--accuracy", 0.5, "--machines", 40],
            "stiffness": grid, "workspace": grid, "plan": ["--count", 8]}
    machine = tmp_path / "m.yaml"
    machine.write_text((root / "configs" / "3-RPR.yaml").read_text() + "\nstiffness: {bar: 5e4}\n")
    for kind, more in runs.items():
        run = ppmcal(kind, machine, *more, "--out", tmp_path / kind)
        assert run.code in (0, 1), run.err
    run = ppmcal("report", *(tmp_path / k for k in runs), "--out", tmp_path / "report", "--json",
                 expect=0)
    for design in run.json["designs"]:
        assert design["record"]["said"]
        assert design["pictures"]
        assert not [p for p in design["pictures"] if p["problem"]]
        assert min(p["size"][0] for p in design["pictures"]) > 400
    html = (tmp_path / "report" / "report.html").read_text()
    read(html)
    assert html.count("<img ") == sum(len(d["pictures"]) for d in run.json["designs"])
