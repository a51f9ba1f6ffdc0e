"""The page about how the program is built says what is so; its examples run."""

import ast
import importlib
import json
import math
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

import pytest
import yaml
from helpers.architecture import PAGE, block, section
from helpers.commands import environment, install, number, ppmcal_process, rows
from helpers.paths import ROOT
from helpers.sources import nodes_of

import ppmcal
from ppmcal import commands
from ppmcal.kinematics.closure import Closure

PACKAGE = Path(ppmcal.__file__).parent
MODULES = {"workshop_limb": block("Add a limb kind"), "workshop_effect": block("Add an effect"),
           "workshop_instrument": block("Add an instrument"),
           "workshop_controller": block("Add a controller")}
GROUPS = tomllib.loads(block("In a package of your own", "toml"))["project"]["entry-points"]


# --- the page against the package ---------------------------------------------------------------


def test_layers_are_those_that_imports_are_held_to():
    picture = [re.split(r"\s{2,}", line)[0] for line in
               block("Nine layers", "text").strip().splitlines()]
    config = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    contracts = config["tool"]["importlinter"]["contracts"]
    assert picture == next(c["layers"] for c in contracts if c["type"] == "layers")


@pytest.mark.slow
def test_rooms_of_calibration_are_entered_by_their_doors():
    """Outside of a room nobody knows its modules."""
    rooms = {p.name for p in (PACKAGE / "calibration").iterdir() if (p / "__init__.py").exists()}
    assert rooms == {"fit", "knowledge", "validation", "interpretation", "sessions",
                     "compensation"}
    for path in PACKAGE.rglob("*.py"):
        own = path.relative_to(PACKAGE).parts[:2]
        for node in nodes_of(path):
            parts = (getattr(node, "module", None) or "").split(".")
            if parts[:2] == ["ppmcal", "calibration"]:
                assert parts[2:3] and parts[2] in rooms, (path, parts)
                assert len(parts) == 3 or own == tuple(parts[1:3]), (path, parts)


@pytest.mark.parametrize("package", ["io", *(f"calibration.{room}" for room in (
    "fit", "knowledge", "validation", "interpretation", "sessions", "compensation"))])
def test_a_door_has_what_it_says_and_loads_it_on_first_use(package):
    door = importlib.import_module(f"ppmcal.{package}")
    tree = ast.parse(Path(door.__file__).read_text(encoding="utf-8"))
    told = [(node.module, alias.name) for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
            for alias in node.names if alias.asname]
    assert told
    for module, name in told:
        assert getattr(door, name) is getattr(importlib.import_module(module), name)
        # else the module would hide the name once it is loaded
        assert not (Path(door.__file__).parent / f"{name}.py").exists()
    with pytest.raises(AttributeError, match="nothing_of_that_name"):
        door.nothing_of_that_name  # noqa: B018
    code = f"import sys, ppmcal.{package}; print(*(m for m in sys.modules if 'ppmcal.' in m))"
    loaded = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True,
                            text=True, check=True).stdout.split()
    assert f"ppmcal.{package}" in loaded
    assert not {module for module, _ in told} & set(loaded)


def test_every_package_is_in_the_table_and_says_what_it_is():
    listed = set(re.findall(r"^\| `(\w+)` \|", section("Nine layers"), re.M))
    packages = {p.parent for p in PACKAGE.rglob("__init__.py")}
    assert listed == {p.name for p in packages if p.parent == PACKAGE}
    for folder in packages:
        tree = ast.parse((folder / "__init__.py").read_text(encoding="utf-8"))
        assert len(ast.get_docstring(tree) or "") > 20, folder


def test_paths_of_the_page_are_there():
    paths = set(re.findall(r"`([\w/]+\.(?:py|md))`", PAGE))
    assert len(paths) > 40
    gone = [p for p in paths if not (PACKAGE / p).exists() and not (ROOT / p).exists()
            and not list((PACKAGE / "model" / "limbs").glob(p))]
    assert not gone


def names_in_tables():
    """Yield (path, name): what a way's table says of a file, and where a word lives."""
    for line in PAGE.splitlines():
        if way := re.match(r"\| `([\w]+/[\w/]+(?:\.py)?)` \|(.*)\|$", line):
            yield from ((way[1], name) for name in re.findall(r"`(\w+(?:\.\w+)?)`(?=[:,])", way[2])
                       if not name.endswith((".csv", ".html", ".yaml")))
        if lives := re.search(r"\| `([\w/]+(?:\.py)?)` `(\w+)` \|$", line):
            yield lives[1], lives[2]


def test_names_of_the_tables_live_where_they_say():
    found = set(names_in_tables())
    assert len(found) > 50
    for path, name in found:
        module = importlib.import_module("ppmcal." + path.removesuffix(".py").replace("/", "."))
        target = module
        for part in name.split("."):
            fields = getattr(target, "__dataclass_fields__", {})
            assert hasattr(target, part) or part in fields, (path, name)
            target = getattr(target, part, None)


def test_what_is_looked_for_is_a_section():
    """The table at the top names each way to add something, and links to what is there."""
    top = PAGE[:PAGE.index("## Nine layers")]
    titles = re.findall(r"^## (.+)$", PAGE, re.M)
    places = {re.sub(r"[^\w -]", "", t).lower().replace(" ", "-"): t for t in titles}
    linked = {places[anchor] for anchor in re.findall(r"\(#([\w-]+)\)", top)}
    assert {t for t in titles if t.startswith(("Add ", "The path of "))} < linked


def test_matrices_are_methods_of_the_closure():
    methods = re.findall(r"\| `(\w+)` \|$", section("One closure, one derivative"), re.M)
    assert len(methods) == 3 and all(hasattr(Closure, m) for m in methods)


def test_words_are_in_order_and_stand_once():
    words = re.findall(r"^\| ([\w' -]+?) \|", section("Words"), re.M)[1:]
    assert len(words) > 40
    assert words == sorted(set(words))


@pytest.mark.parametrize("title", ["The path of a measurement row", "The path of a tolerance",
                                   "The path of an effect's parameter"])
def test_ways_count_their_files(title):
    numbers = {"Twelve": 12, "Thirteen": 13, "Fourteen": 14, "Fifteen": 15, "Twenty-six": 26}
    files = [f for cell in re.findall(r"^\| (`.*?`) \|", section(title), re.M)
             for f in cell.split(", ")]
    told = re.search(r"^([A-Z][\w-]+) files", section(title), re.M)[1]
    assert numbers[told] == len(files) == len(set(files))


def test_the_command_line_knows_no_command():
    """A command is a folder of `commands`; no other list names it."""
    for path in (PACKAGE / "cli").glob("*.py"):
        for node in nodes_of(path):
            text = node.value if isinstance(node, ast.Constant) else ""
            assert text not in commands.names(), (path, text)


def test_no_class_name_twice():
    where = defaultdict(list)
    for path in PACKAGE.rglob("*.py"):
        for node in nodes_of(path):
            if isinstance(node, ast.ClassDef):
                where[node.name].append(str(path.relative_to(PACKAGE)))
    assert not {name: paths for name, paths in where.items() if len(paths) > 1}


# --- its examples -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the modules, found by the entry points of the page alone."""
    folder = tmp_path_factory.mktemp("site")
    for name, code in MODULES.items():
        (folder / f"{name}.py").write_text(code, encoding="utf-8")
    installed = folder / "workshop-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: workshop\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text("".join(
        f"[{group}]\n" + "".join(f"{n} = {v}\n" for n, v in lines.items())
        for group, lines in GROUPS.items()))
    return folder


def answer(site, code, *args):
    """Return the JSON that a script prints with the modules at hand."""
    done = subprocess.run([sys.executable, "-c", code, *map(str, args)], capture_output=True,
                          text=True, timeout=120, env=environment(site))
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_entry_points_name_what_the_blocks_define():
    assert set(GROUPS) == {"ppmcal.limbs", "ppmcal.effects", "ppmcal.instruments",
                           "ppmcal.controllers"}
    for value in (v for lines in GROUPS.values() for v in lines.values()):
        module, _, name = value.partition(":")
        defined = {t.id for node in ast.parse(MODULES[module]).body
                   if isinstance(node, ast.Assign) for t in node.targets}
        assert not name or name in defined


LIMB = """
import json
import numpy as np
import ppmcal

limbs = []
for i in range(3):
    c, s = np.cos(np.radians(90 + 120 * i)), np.sin(np.radians(90 + 120 * i))
    limbs.append({"name": f"leg{i + 1}", "kind": "(P)RS", "length": 500, "branch": -1,
                  "base": {"point": [350 * c, 350 * s, 0], "axis": [-s, c, 0],
                           "direction": [0, 0, 1]},
                  "platform": {"point": [200 * c, 200 * s, 0]}})
units = {"length": "mm", "angle": "deg"}
machine = ppmcal.load({
    "format": "ppmcal/mechanism/1", "name": "3-PRS", "units": units, "motion": "spatial",
    "limbs": limbs, "home": {"pose": {"x": 0, "y": 0, "z": 600, "rx": 0, "ry": 0, "rz": 0}},
    "tolerances": {"point": 0.1, "length": 0.2, "angle": 0.05, "offset": 0.3},
    "free": ["*.offset", "*.base.axis.r?"]})
run = ppmcal.simulate(machine, {
    "format": "ppmcal/scenario/1", "units": units, "seed": 3,
    "poses": {"random": {"center": {"z": 600, "rx": 0, "ry": 0},
                         "half_range": {"z": 40, "rx": 12, "ry": 12}, "count": 24}},
    "errors": {"leg3.offset": -0.4, "leg1.base.axis.ry": 0.1},
    "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.002}}})
fit = ppmcal.identify(machine, run.data)
found = {e.name: [e.error, e.sigma] for e in fit.identification.estimates if e.sigma}
there = ppmcal.inverse(machine, {"z": [610.0], "rx": [3.0], "ry": [-2.0]}).table
back = ppmcal.forward(machine, {f"q_leg{i + 1}": there.q[:, i] * 1e3 for i in range(3)}).table
scene = ppmcal.check(machine).scene.machines[0]
gap = max(limb.gap for frame in scene.frames for limb in frame.limbs)
print(json.dumps({"home": there.q[0].tolist(), "apart": float(abs(back.pose - there.pose).max()),
                  "drawn": [[j.kind for j in limb.joints] for limb in scene.limbs], "gap": gap,
                  "rank": fit.identification.rank, "found": found}))
"""


@pytest.mark.long
def test_the_limb_kind_of_the_page(site):
    """Errors of a drive and of a hinge are found; inverse and forward kinematics agree."""
    got = answer(site, LIMB)
    assert got["rank"] == len(got["found"]) == 12
    truth = {"leg3.offset": -0.4e-3, "leg1.base.axis.ry": math.radians(0.1)}
    for name, (error, sigma) in got["found"].items():
        assert abs(error - truth.get(name, 0.0)) < 4.0 * sigma, name
    assert all(got["found"][name][1] < 0.05 * abs(error) for name, error in truth.items())
    assert got["apart"] < 1e-9
    assert got["drawn"] == [["P", "R", "S"]] * 3 and got["gap"] < 1e-6


OWN = {"kind": "warm_up", "on": ["leg2"], "parameters": {"growth": 2e-4}}
EFFECT = """
import json, sys
import yaml
import ppmcal

own, scenario = json.loads(sys.argv[1])
machine = ppmcal.load(ppmcal.shipped("3-RPR"))
run = ppmcal.simulate(machine, scenario)
tree = yaml.safe_load(ppmcal.shipped("3-RPR").read_text())
tree["effects"] = [own | {"parameters": {"growth": {"value": 0.0, "free": True}}}]
fit = ppmcal.identify(tree, run.data)
one = next(e for e in fit.identification.estimates if e.name == "warm_up.leg2.growth")
found = ppmcal.diagnose(machine, run.data)
print(json.dumps({"value": one.value, "sigma": one.sigma, "verdict": found.verdict,
                  "named": [[e.kind, list(e.on)] for e in found.diagnosis.effects]}))
"""


@pytest.mark.long
def test_the_effect_of_the_page(site):
    """It is simulated, fitted, and named among all others where the model lacks it."""
    scenario = {
        "format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"}, "seed": 4,
        "poses": {"random": {"center": {"x": 500, "y": 288.675, "rz": 30},
                             "half_range": {"x": 60, "y": 60, "rz": 8}, "count": 30}},
        "effects": [OWN], "approach": "both", "errors": {"random": {"scale": 1.0}},
        "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
        "frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]}
    got = answer(site, EFFECT, json.dumps([OWN, scenario]))
    assert abs(got["value"] - 2e-4) < 4.0 * got["sigma"] < 0.8e-4
    assert (got["verdict"], got["named"]) == ("named", [["warm_up", ["leg2"]]])


@pytest.mark.long
def test_the_controller_of_the_page(site, tmp_path):
    """Offsets of drives that are off come out as they are; other errors of geometry cost."""
    tree = yaml.safe_load(ppmcal.shipped("3-RPR").read_text(encoding="utf-8"))
    for limb, offset in zip(tree["limbs"], (0.3, -0.2, 0.1), strict=True):
        limb["offset"] = {"value": offset, "nominal": 0.0}
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    ppmcal_process("export", "OFFSETS", "m.yaml", "--out", "e", cwd=tmp_path, site=site, expect=1)
    table = rows(tmp_path / "e" / "offsets.csv")
    assert [r["drive"] for r in table] == ["leg1", "leg2", "leg3"]
    assert [number(r, "offset") for r in table] == pytest.approx([-0.3, 0.2, -0.1], abs=1e-7)
    gain = json.loads((tmp_path / "e" / "export.json").read_text())["gain"]
    assert gain["before"]["rms"] > 0.1 and gain["after"]["rms"] < 1e-6

    tree["limbs"][0]["base"]["point"] = [{"value": 0.4, "nominal": 0.0}, 0]
    (tmp_path / "m.yaml").write_text(yaml.safe_dump(tree, sort_keys=False))
    ppmcal_process("export", "offsets", "m.yaml", "--out", "f", cwd=tmp_path, site=site, expect=1)
    gain = json.loads((tmp_path / "f" / "export.json").read_text())["gain"]
    assert 1e-3 < gain["after"]["rms"] < gain["before"]["rms"]
    # without the package there is no such format
    refused = ppmcal_process("export", "offsets", "m.yaml", cwd=tmp_path, expect=2)
    assert "unknown format 'offsets'" in " ".join(refused.err.split())


@pytest.mark.slow
def test_a_format_whose_name_is_taken_is_refused(tmp_path):
    site = install(tmp_path, "workshop", "", {"ppmcal.controllers": {"grid": "x"}})
    code = ("from ppmcal.controllers import loaded\n"
            "try:\n    loaded('klipper')\nexcept ValueError as error:\n"
            "    import json\n    print(json.dumps(str(error)))")
    assert answer(site, code) == "format 'grid' is registered twice"
