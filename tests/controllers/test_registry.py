"""A controller is one folder, or one module of another package; nowhere else is its name."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from helpers.commands import environment, install, ppmcal_process
from helpers.sources import nodes_of

import ppmcal
from ppmcal import controllers
from ppmcal.io import read_mechanism

PACKAGE = Path(ppmcal.__file__).parent
LOGS = {"io/recordings.py", "io/foreign.py", "limits.py"}
"""What reads recordings, and the table of limits: a log is data, and no format of a controller."""
WORKSHOP = '''"""Offsets of the workshop's controller."""

from ppmcal.controllers import Controller
from ppmcal.controllers.delta.geometry import ANGLES, DeltaGeometry
from ppmcal.controllers.delta.importer import printer_importer
from ppmcal.controllers.delta.options import delta_options
from ppmcal.controllers.delta.printer import Printer, nominal_of

CONTROLLER = Controller(9, "offsets.", use="bench {model} takes the machine",
                        drives=lambda mechanism: mechanism.motion.turns_freely,
                        options=delta_options("none", "R"))


def export(mechanism, old, poses):
    raise AssertionError


def printer(path, rods, meshes, radius):
    """Return the printer of a file that holds radius, rod and endstop."""
    r, rod, end = map(float, path.read_text().split())
    meant = DeltaGeometry(r, ANGLES, (rod,) * 3, (end,) * 3)
    origin = dict.fromkeys(("delta_radius", "rods", "endstops"), "the file")
    return Printer(str(path), meant, nominal_of(str(path), meant, meant, origin, rods))


import_config = printer_importer(printer)
'''


def words(run):
    return " ".join(run.out.split())


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = install(tmp_path_factory.mktemp("site"), "workshop", WORKSHOP, {})
    (folder / "workshop-1.0.dist-info" / "entry_points.txt").write_text(
        "[ppmcal.controllers]\nbench = workshop\n[ppmcal.imports]\nbench = workshop\n")
    return folder


@pytest.mark.slow
def test_help_has_a_controller_of_another_package_without_running_it(site):
    for command in ("export", "import"):
        assert "bench" not in words(ppmcal_process(command, "--help", expect=0))
        shown = words(ppmcal_process(command, "--help", site=site, expect=0))
        assert "FORMAT bench: Offsets of the workshop's controller." in shown


@pytest.mark.long
def test_a_printer_of_another_package_is_imported(site, tmp_path):
    (tmp_path / "p.txt").write_text("140 300 290")
    ppmcal_process("import", "BENCH", "p.txt", cwd=tmp_path, site=site, expect=0)
    tree = yaml.safe_load((tmp_path / "imported" / "machine.yaml").read_text())
    assert tree["limbs"][0]["length"]["value"] == 300.0
    refused = ppmcal_process("import", "bench", "p.txt", cwd=tmp_path, expect=2)
    assert "unknown format 'bench'" in " ".join(refused.err.split())


@pytest.mark.long
def test_a_controller_of_another_package_says_what_to_do_with_a_machine(site, tmp_path):
    """As ppmcal's own do: in its declaration, for the machines that it drives."""
    code = ("import sys\nfrom ppmcal.controllers import uses\n"
            "from ppmcal.io import read_mechanism\n"
            "print(uses(read_mechanism(sys.argv[1]), 'fit'))\n"
            "print([m for m in sys.modules if m.endswith('.controller')])")
    for machine, told in (("6-UPS", True), ("3-RPR", False)):
        found, loaded = subprocess.check_output(
            [sys.executable, "-c", code, str(PACKAGE.parent / "configs" / f"{machine}.yaml")],
            env=environment(site), cwd=tmp_path, text=True).splitlines()
        assert ("'bench fit takes the machine'" in found) == told and "export joints fit" in found
        assert loaded == "[]"


def test_words_with_the_old_file_are_said_of_imported_machines_alone():
    delta = read_mechanism(PACKAGE.parent / "configs" / "delta-linear.yaml")
    assert not [t for t in controllers.uses(delta, "fit") if "--old" in t]
    (told,) = controllers.uses(delta, "fit", "reprap", "config.g")
    assert told == ("ppmcal export reprap fit --old config.g --write puts M665 and M666 into it, "
                    "and keeps the old one beside")


def test_every_controller_says_what_it_does_and_is_in_the_docs():
    page = (PACKAGE.parent / "docs" / "controllers.md").read_text()
    for name, entry in controllers.exported().items():
        assert hasattr(entry.load(), "export") and f"ppmcal export {name}" in page
        assert controllers.own()[name].exports.endswith(".")
    for name, entry in controllers.imported().items():
        assert hasattr(entry.load(), "import_config") and f"ppmcal import {name}" in page


@pytest.mark.slow
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
