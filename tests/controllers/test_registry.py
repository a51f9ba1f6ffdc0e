"""A controller is one folder, or one module of another package; nowhere else is its name."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest
import yaml
from helpers.commands import install, ppmcal_process
from helpers.sources import nodes_of

import ppmcal
from ppmcal import controllers

PACKAGE = Path(ppmcal.__file__).parent
LOGS = {"io/klipper_log.py", "io/foreign.py", "limits.py"}
"""What reads recordings, and the table of limits: a log is data, and no format of a controller."""
WORKSHOP = '''"""Offsets of the workshop's controller."""

from ppmcal.controllers.delta.geometry import ANGLES, DeltaGeometry
from ppmcal.controllers.delta.printer import Printer, nominal_of


def export(mechanism, old, poses):
    raise AssertionError


def printer(path, rods, meshes, radius):
    """Return the printer of a file that holds radius, rod and endstop."""
    r, rod, end = map(float, path.read_text().split())
    meant = DeltaGeometry(r, ANGLES, (rod,) * 3, (end,) * 3)
    origin = dict.fromkeys(("delta_radius", "rods", "endstops"), "the file")
    return Printer(str(path), meant, (0.01,) * 3, nominal_of(str(path), meant, meant, origin, rods))
'''


def words(run):
    return " ".join(run.out.split())


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = install(tmp_path_factory.mktemp("site"), "workshop", WORKSHOP, {})
    (folder / "workshop-1.0.dist-info" / "entry_points.txt").write_text(
        "[ppmcal.controllers]\nbench = workshop\n[ppmcal.imports]\nbench = workshop\n")
    return folder


def test_help_has_a_controller_of_another_package_without_running_it(site):
    for command in ("export", "import"):
        assert "bench" not in words(ppmcal_process(command, "--help", expect=0))
        shown = words(ppmcal_process(command, "--help", site=site, expect=0))
        assert "FORMAT bench: Offsets of the workshop's controller." in shown


def test_a_printer_of_another_package_is_imported(site, tmp_path):
    (tmp_path / "p.txt").write_text("140 300 290")
    ppmcal_process("import", "BENCH", "p.txt", cwd=tmp_path, site=site, expect=0)
    tree = yaml.safe_load((tmp_path / "imported" / "machine.yaml").read_text())
    assert tree["limbs"][0]["length"]["value"] == 300.0
    refused = ppmcal_process("import", "bench", "p.txt", cwd=tmp_path, expect=2)
    assert "unknown format 'bench'" in " ".join(refused.err.split())


def test_every_controller_says_what_it_does_and_is_in_the_docs():
    page = (PACKAGE.parent / "docs" / "controllers.md").read_text()
    for name, entry in controllers.exported().items():
        assert hasattr(entry.load(), "export") and f"ppmcal export {name}" in page
        assert controllers.own()[name].exports.endswith(".")
    for name, entry in controllers.imported().items():
        assert hasattr(entry.load(), "printer") and f"ppmcal import {name}" in page


def test_no_other_module_names_a_controller():
    """Neither as a text nor by an import; words of sentences that are told are not names."""
    names = set(controllers.own())
    telling = re.compile(rf"\b({'|'.join(names - {'joints', 'grid'})})\b", re.IGNORECASE)
    for path in PACKAGE.rglob("*.py"):
        inside = path.relative_to(PACKAGE)
        if inside.as_posix() in LOGS or inside.parts[:2] in {("controllers", n) for n in names}:
            continue
        for node in nodes_of(path):
            module = getattr(node, "module", None) or ""
            assert not (isinstance(node, ast.ImportFrom)
                        and module.split(".")[1:2] == ["controllers"]
                        and module.split(".")[2:3] and module.split(".")[2] in names), path
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                docstring = "\n" in node.value or node.value.endswith(".")
                assert docstring or not telling.search(node.value), (path, node.value)
