"""Names, labels and file names are text on every page and picture, whatever is in them."""

from __future__ import annotations

import shutil
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from helpers.commands import ppmcal

import ppmcal as face
from ppmcal.io.yaml import dump_yaml, read_yaml

HOSTILE = """</script><script>alert(1)</script><img src=x onerror=alert(1)> ' " \\ & ]]> --> """
"""Ends a script, an attribute, a comment and a CDATA section."""
FILE = "run <img src=x onerror=alert(1)> ' & \".csv"
SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


class Elements(HTMLParser):
    """Collects what a browser would act on: elements, attributes, and what scripts hold."""

    def __init__(self, page: str) -> None:
        super().__init__(convert_charrefs=True)
        self.scripts: list[str] = []
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self._inside = False
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        self._inside = tag == "script"
        if self._inside:
            self.scripts.append("")

    def handle_endtag(self, tag):
        self._inside = self._inside and tag != "script"

    def handle_data(self, data):
        if self._inside:
            self.scripts[-1] += data


def check_page(page: str) -> None:
    """Assert that the hostile text acts nowhere in a page."""
    elements = Elements(page)
    assert not [(t, a) for t, a in elements.found if any(k.startswith("on") for k in a)]
    assert not [(t, a) for t, a in elements.found if a.get("src") == "x"]
    # in scripts it is a string of JSON, with no < in it
    assert not [s for s in elements.scripts if s.lstrip().startswith("alert")]
    assert "<script>alert" not in page and "<img src=x" not in page


@pytest.fixture(scope="module")
def desk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a machine and data whose names are hostile, and results of them."""
    folder = tmp_path_factory.mktemp("desk")
    machine = read_yaml(SAMPLES / "hexapod.yaml")
    (folder / "mine.yaml").write_text(dump_yaml({**machine, "name": HOSTILE}))
    shutil.copy(SAMPLES / "measurements.csv", folder / FILE)
    sidecar = read_yaml(SAMPLES / "measurements.yaml")
    (folder / FILE).with_suffix(".yaml").write_text(dump_yaml({**sidecar, "name": HOSTILE}))
    shutil.copy(SAMPLES / "targets.csv", folder / "targets.csv")
    shutil.copy(SAMPLES / "poses.csv", folder / "poses.csv")
    assert ppmcal("identify", "mine.yaml", FILE, "-q", cwd=folder).code in (0, 1)
    assert ppmcal("compensate", "identified", "targets.csv", "-q", cwd=folder).code in (0, 1)
    assert ppmcal("kinematics", "inverse", "identified", "poses.csv", "--out", "<b>kin",
                  "-q", cwd=folder).code in (0, 1)
    ppmcal("sensitivity", "mine.yaml", "--home-only", "-q", cwd=folder, expect=0)
    return folder


@pytest.mark.slow
def test_the_report_shows_names_as_text(desk: Path) -> None:
    ppmcal("report", "identified", "compensated", "<b>kin", "sensitivity", cwd=desk)
    page = (desk / "report" / "report.html").read_text()
    check_page(page)
    assert "&lt;script&gt;alert(1)" in page


@pytest.mark.slow
def test_the_drawing_shows_names_as_text(desk: Path) -> None:
    ppmcal("check", "mine.yaml", FILE, "--draw", "machine.html", cwd=desk)
    page = (desk / "machine.html").read_text()
    check_page(page)
    assert "alert(1)" in page


@pytest.mark.slow
def test_a_notebook_shows_names_as_text(desk: Path) -> None:
    machine = face.load(desk / "mine.yaml")
    for result in (face.inverse(machine, desk / "poses.csv"),
                   face.sensitivity(machine, home_only=True),
                   face.identify(machine, [desk / FILE])):
        check_page(result._repr_html_())


@pytest.mark.slow
def test_the_page_of_a_batch_shows_names_as_text(desk: Path) -> None:
    pytest.importorskip("pyarrow")
    (desk / "fleet.yaml").write_text(dump_yaml({
        "format": "ppmcal/batch/1", "model": "mine.yaml", "design": HOSTILE.strip(), "campaigns": [
            {"machine": "m1", "date": "2026-03-14", "data": [FILE]},
            {"machine": "m2", "date": "2026-03-14", "data": ["gone <script>alert(1)</script>"]}]}))
    ppmcal("batch", "fleet.yaml", "--cores", 1, cwd=desk)
    page = (desk / "batch" / "batch.html").read_text()
    check_page(page)
    assert "alert(1)" in page


@pytest.mark.long
def test_pictures_show_names_as_text(desk: Path) -> None:
    ppmcal("validate", "identified", FILE, "-q", cwd=desk)
    ppmcal("diagnose", "mine.yaml", FILE, "-q", cwd=desk)
    pictures = [*desk.rglob("*.svg")]
    assert len(pictures) > 3
    for path in pictures:
        for element in ElementTree.parse(path).iter():
            assert element.tag.rpartition("}")[2] not in ("script", "img", "foreignObject")
            assert not any(k.startswith("on") for k in element.attrib)


@pytest.mark.parametrize("name", ["../up", "a/b", "/tmp/x", "..", ".hidden", "a\\b", "", "a\nb"])
@pytest.mark.parametrize("key", ["machine", "name"])
def test_a_manifest_writes_nowhere_but_below_out(tmp_path: Path, key: str, name: str) -> None:
    entry = {"machine": "m1", "date": "2026-03-14", "data": ["run.csv"], key: name}
    (tmp_path / "fleet.yaml").write_text(dump_yaml({
        "format": "ppmcal/batch/1", "model": "mine.yaml", "campaigns": [entry]}))
    run = ppmcal("batch", "fleet.yaml", "--cores", 1, cwd=tmp_path, expect=2)
    assert "cannot be the name of a folder" in run.err
    assert [p.name for p in tmp_path.iterdir()] == ["fleet.yaml"]


def test_a_manifest_names_no_folder_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "fleet.yaml").write_text(dump_yaml({
        "format": "ppmcal/batch/1", "model": "mine.yaml", "out": "/tmp/elsewhere", "campaigns": [
            {"machine": "m1", "date": "2026-03-14", "data": ["run.csv"]}]}))
    assert "out" in ppmcal("batch", "fleet.yaml", cwd=tmp_path, expect=2).err


@pytest.mark.slow
def test_names_of_targets_and_meshes_become_plain_file_names(tmp_path: Path) -> None:
    config = (SAMPLES / "printer" / "printer.cfg").read_text()
    assert "#*# [bed_mesh " not in config
    mesh = ("#*#\n#*# [bed_mesh ../../up]\n#*# version = 1\n#*# points =\n"
            "#*# \t  0.010000, 0.000000, 0.000000\n#*# \t  0.000000, 0.010000, 0.000000\n"
            "#*# \t  0.000000, 0.000000, 0.010000\n#*# x_count = 3\n#*# y_count = 3\n"
            "#*# min_x = -50.0\n#*# max_x = 50.0\n#*# min_y = -50.0\n#*# max_y = 50.0\n")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "printer.cfg").write_text(config.rstrip("\n") + "\n" + mesh)
    ppmcal("import", "klipper", "printer.cfg", "--mesh", "../../up", cwd=tmp_path / "in")
    names = [p.name for p in (tmp_path / "in" / "imported").iterdir()]
    assert "mesh_______up.csv" in names
    assert [p.name for p in tmp_path.iterdir()] == ["in"]
