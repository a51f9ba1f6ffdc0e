"""Kinds of effects and limbs that another package adds go through every command.

The package is installed in a folder of its own and found by its entry points alone; no line of
ppmcal knows its names. The last test holds ppmcal to that for its own kinds too.
"""

from __future__ import annotations

import ast
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from helpers.commands import (
    Run,
    environment,
    install,
    number,
    pick,
    ppmcal_process,
    rows,
    write_csv,
)
from helpers.paths import ROOT
from helpers.sources import nodes_of

import ppmcal
from ppmcal.model.effects import effect_kinds
from ppmcal.model.limbs import kinds

CONFIGS = ROOT / "configs"
DATA = "s/measurements.csv"
PACKAGE = '''"""What a workshop knows of its own machines."""

import numpy as np

from ppmcal.model.effects.inputs import TEMPERATURE, EffectInput
from ppmcal.model.effects.kind import EffectKind, EffectParameter, Terms, fixed_list, linear
from ppmcal.model.limbs.chain import Chain, U, joint, shift, slide, turn
from ppmcal.model.limbs.kind import LimbKind
from ppmcal.model.limbs.surfaces import SPHERE


def belt_terms(setting, on, values):
    """Du = s growth q/2."""
    return linear(values, {"growth": setting.at_joints(
        0.5 * setting.approach * setting.travel, on)})


BELT = EffectKind(
    "belt", "du = s growth q/2, s the direction of approach", "reversal along a toothed belt",
    fixed_list(EffectParameter("growth", "1", low=0.0, usual=(0.0, 0.01),
                               why="a belt gives way by less than 1 %")),
    ("dir",), belt_terms, remedy="clamp the belt near the carriage and measure again",
    follows=EffectInput("wound travel", "joint", lambda rows: rows.approach * rows.travel))


def thaw_terms(setting, on, values):
    """Du = slope max(T - knee, 0), T and knee above 20 C."""
    above = np.maximum(setting.temperature - values["knee"], 0.0)[:, None] + 0.0 * setting.travel
    past = -values["slope"] * (above > 0.0)
    shape = setting.at_joints(above, on)
    return Terms(shape.times(values["slope"]),
                 {"slope": shape, "knee": setting.at_joints(past, on)})


THAW = EffectKind(
    "thaw", "du = slope max(T - knee, 0)", "grease that gives way above some temperature",
    fixed_list(EffectParameter("slope", "joint/K", usual=(-1e-3, 1e-3)),
               EffectParameter("knee", "K", None, usual=(-20.0, 40.0),
                               scan=lambda data: np.arange(-4.0, 12.0, 1.0))),
    ("temperature",), thaw_terms, follows=TEMPERATURE)


RAIL = LimbKind(
    "(P)RR-bracket", True, SPHERE,
    base=Chain((shift("base.point", planar=True), turn("base.angle"), joint(1, "x"),
                slide(U, "x"), slide("bracket", "y", 0.0), joint(2))),
    middle=Chain((slide("length", "x"), joint(3))),
    platform=Chain((shift("platform.point", planar=True),)), actuator="length", branch="branch",
    closes_when="|B - A - u d(alpha) - bracket n(alpha)| = length", source="the workshop's drawing")
'''
ENTRIES = {"ppmcal.effects": {"belt": "BELT", "thaw": "THAW"},
           "ppmcal.limbs": {"rail": "RAIL"}}
STATION = {"frame": {"x": 4, "y": -3, "rz": 1}, "target": [3, -2]}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the package is installed."""
    return install(tmp_path_factory.mktemp("site"), "workshop", PACKAGE, ENTRIES)


def struts(folder: Path, file: str, **changes: Any) -> None:
    """Write the sample of three struts."""
    tree = yaml.safe_load((CONFIGS / "3-RPR.yaml").read_text(encoding="utf-8"))
    (folder / file).write_text(yaml.safe_dump(tree | changes, sort_keys=False))


def rails(folder: Path, file: str, free: list[str]) -> None:
    """Write three rails askew to the axes, with carriages on brackets."""
    limbs = []
    for i in range(3):
        way = np.radians(15.0 + 120.0 * i)
        turn = np.array([[np.cos(way), -np.sin(way)], [np.sin(way), np.cos(way)]])
        limbs.append({
            "name": f"leg{i + 1}", "kind": "(P)RR-bracket", "length": 250, "branch": -1,
            "bracket": {"value": 20, "tolerance": 0.3}, "base": {
                "point": (turn @ [-400.0, -230.94]).tolist(), "angle": 15.0 + 120.0 * i},
            "platform": {"point": (turn @ [0.0, -120.0]).tolist()}})
    (folder / file).write_text(yaml.safe_dump({
        "format": "ppmcal/mechanism/1", "units": {"length": "mm", "angle": "deg"},
        "motion": "planar", "limbs": limbs, "home": {"pose": {"x": 0, "y": 0, "rz": 0}},
        "limits": {f"leg{i}": [20, 380] for i in (1, 2, 3)}, "free": free,
        "tolerances": {"point": 0.2, "length": 0.2, "angle": 0.05, "offset": 0.3}}))


def scenario(folder: Path, box: dict[str, Any], effects: list[dict[str, Any]],
             **changes: Any) -> None:
    """Write a scenario in which everything is recorded."""
    tree = {"format": "ppmcal/scenario/1", "units": {"length": "mm", "angle": "deg"},
            "poses": {"random": box | {"count": 24}}, "effects": effects, "approach": "both",
            "instrument": {"kind": "pose", "sigma": {"position": 0.005, "rotation": 0.001}},
            "conditions": {"payload": [0, 15, 30], "temperature": {"mean": 24, "swing": 6},
                           "velocity": 30},
            "errors": {"random": {"scale": 1.0}}, "seed": 4} | STATION
    (folder / "s.yaml").write_text(yaml.safe_dump(tree | changes))


STRUTS = {"center": {"x": 500, "y": 288.675, "rz": 30}, "half_range": {"x": 60, "y": 60, "rz": 8}}
RAILS = {"center": {"x": 0, "y": 0, "rz": 0}, "half_range": {"x": 60, "y": 60, "rz": 8}}


def runner(folder: Path, site: Path) -> Any:
    """Return a function that runs a command with the package installed."""
    def run(*args: str, expect: int | None = 0) -> Run:
        return ppmcal_process(*args, cwd=folder, site=site, expect=expect, timeout=120)

    return run


def python(script: Path, site: Path) -> str:
    """Return what a script prints with the package installed."""
    done = subprocess.run([sys.executable, str(script)], capture_output=True, text=True, check=True,
                          timeout=60, env=environment(site))
    return done.stdout


def named(folder: Path) -> dict[str, Any]:
    """Return the one effect that a diagnosis names."""
    record = json.loads((folder / "d" / "diagnosis.json").read_text())
    assert record["verdict"] in ("named", "named-set"), record["effects"]
    assert len(record["effects"]) == 1
    found: dict[str, Any] = record["effects"][0]
    return found


def parameter(folder: Path, name: str) -> dict[str, str]:
    return next(r for r in rows(folder / "i" / "parameters.csv") if r["name"] == name)


@pytest.mark.long
def test_an_effect_of_another_package(tmp_path: Path, site: Path) -> None:
    """A reversal that grows with the travel, through all commands, against an input of its own."""
    run = runner(tmp_path, site)
    own = {"kind": "belt", "on": ["leg2"], "parameters": {"growth": 2e-4}}
    struts(tmp_path, "plain.yaml")
    struts(tmp_path, "m.yaml", effects=[own | {"parameters": {
        "growth": {"value": 0.0, "free": True}}}])
    scenario(tmp_path, STRUTS, [own])
    assert run("check", "m.yaml", "--json").json["columns"] == 13
    run("simulate", "plain.yaml", "s.yaml", "--out", "s")
    run("identify", "m.yaml", DATA, "--out", "i")
    growth = parameter(tmp_path, "belt.leg2.growth")
    assert abs(number(growth, "value") - 2e-4) < 4.0 * number(growth, "sigma")
    assert number(growth, "sigma") < 2e-5

    # a backlash of its own size at mid-stroke that grows with the travel does just the same, but
    # has a tenth of the prior
    run("diagnose", "plain.yaml", DATA, "--out", "d")
    found = named(tmp_path)
    assert set(found["alternatives"]) <= {"backlash x travel"}
    assert (found["kind"], found["on"]) == ("belt", ["leg2"])
    assert found["parameters"]["growth"]["value"] == pytest.approx(2e-4, rel=0.1)
    series = json.loads((tmp_path / "d" / "diagnosis.json").read_text())["plot_data"]["series"]
    assert [(s["input"], s["input_unit"]) for s in series if s["effect"] == 0] == [
        ("wound travel", "mm")]

    run("plan", "plain.yaml", "--for", "belt", "--count", "12", "--seed", "3", "--out", "p")
    assert json.loads((tmp_path / "p" / "plan.json").read_text())["not_told"] == []
    for leg in (1, 2, 3):
        assert {r[f"dir_leg{leg}"] for r in rows(tmp_path / "p" / "poses.csv")} == {"1", "-1"}

    pick(tmp_path / DATA, ["x", "y", "rz", "dir_leg1", "dir_leg2", "dir_leg3"],
         tmp_path / "wanted.csv")
    run("compensate", "i/identified.yaml", "wanted.csv", "--out", "c", "--frame", "base")
    commands = rows(tmp_path / "c" / "commands.csv")
    assert {r["status"] for r in commands} == {"ok"}
    for row in commands:
        assert number(row, "error_position_after") == pytest.approx(number(row, "sigma_position"))

    run("export", "joints", "i/identified.yaml", "--out", "e", expect=None)
    lines = [line.split() for line in (tmp_path / "e" / "leg2.comp").read_text().splitlines()
             if line.strip() and not line.startswith("#")]
    n, forward, reverse = np.array(lines, dtype=float).T
    apart = np.abs(forward - reverse) / n
    assert apart == pytest.approx(number(growth, "value"), rel=1e-2)

    run("report", "s", "i", "d", "p", "c", "e", "--out", "r")
    page = (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    assert "belt on leg2" in page
    assert "wound travel" in page


@pytest.mark.slow
def test_the_package_may_be_imported_first(tmp_path: Path, site: Path) -> None:
    """It imports ppmcal's kinds while its own are not there yet."""
    (tmp_path / "ask.py").write_text("import workshop\n"
                                     "from ppmcal.model.effects import find_effect\n"
                                     "from ppmcal.model.limbs import find_kind\n"
                                     "assert find_effect('belt') is workshop.BELT\n"
                                     "assert find_kind('(P)RR-bracket') is workshop.RAIL\n"
                                     "print('found')\n")
    assert python(tmp_path / "ask.py", site) == "found\n"


@pytest.mark.slow
def test_what_tells_it_apart_is_its_own(tmp_path: Path, site: Path) -> None:
    """Where no further measurement can tell it from a rival, its own remedy is what is told."""
    code = ("from ppmcal.diagnosis.next_experiment import _remedy\n"
            "from ppmcal.diagnosis.hypotheses import Hypothesis\n"
            "from ppmcal.model.effects import find_effect\n"
            "form = lambda kind: Hypothesis(kind, ('leg1',), True, (), (), (), (),\n"
            "                               effect=find_effect(kind))\n"
            "print(_remedy(form('backlash'), form('belt')))\n")
    (tmp_path / "ask.py").write_text(code)
    assert "clamp the belt" in python(tmp_path / "ask.py", site)


@pytest.mark.long
def test_a_constant_that_a_search_has_to_scan(tmp_path: Path, site: Path) -> None:
    """A knee in the temperature: found on the kind's own grid, fitted, and a plan must have it."""
    run = runner(tmp_path, site)
    struts(tmp_path, "plain.yaml")
    own = {"kind": "thaw", "on": ["leg3"], "parameters": {"slope": 0.02, "knee": 5.0}}
    scenario(tmp_path, STRUTS, [own])
    run("simulate", "plain.yaml", "s.yaml", "--out", "s")
    run("diagnose", "plain.yaml", DATA, "--out", "d", expect=None)
    found = named(tmp_path)
    assert (found["kind"], found["on"]) == ("thaw", ["leg3"])
    knee = found["parameters"]["knee"]
    assert abs(knee["value"] - 5.0) < 4.0 * knee["sigma"] < 2.0
    refused = run("plan", "plain.yaml", "--for", "thaw", "--temperature", "18,26", "--out", "p",
                  expect=2)
    assert "without its knee" in " ".join(refused.err.split())


@pytest.mark.long
def test_a_limb_of_another_package(tmp_path: Path, site: Path) -> None:
    """Carriages on brackets, through all commands; one bracket is not as drawn."""
    run = runner(tmp_path, site)
    rails(tmp_path, "m.yaml", ["*.length", "*.bracket"])
    rails(tmp_path, "plain.yaml", ["*.length"])
    scenario(tmp_path, RAILS, [], errors={"leg2.bracket": 0.4, "leg1.length": -0.2},
             frame="known", target="known")
    assert run("check", "m.yaml", "--json").json["rank"] == 6
    run("simulate", "m.yaml", "s.yaml", "--out", "s")
    run("identify", "m.yaml", DATA, "--out", "i")
    bracket = parameter(tmp_path, "leg2.bracket")
    assert abs(number(bracket, "value") - 20.4) < 4.0 * number(bracket, "sigma") < 0.1

    run("diagnose", "plain.yaml", DATA, "--out", "d", expect=None)
    found = named(tmp_path)
    assert found["kind"] == "geometry"
    assert found["parameters"]["leg2.bracket"]["value"] == pytest.approx(0.4, rel=0.2)

    run("plan", "m.yaml", "--for", "backlash", "--count", "12", "--seed", "3", "--out", "p")
    pick(tmp_path / DATA, ["x", "y", "rz"], tmp_path / "wanted.csv")
    run("compensate", "i/identified.yaml", "wanted.csv", "--frame", "base", "--out", "c")
    commands = rows(tmp_path / "c" / "commands.csv")
    assert {r["status"] for r in commands} == {"ok"}
    write_csv(tmp_path / "poses.csv", [{"x": 10, "y": -5, "rz": 2}, {"x": -20, "y": 15, "rz": -3}])
    run("export", "grid", "i/identified.yaml", "--poses", "poses.csv", "--out", "e", expect=None)
    assert len(rows(tmp_path / "e" / "grid.csv")) == 2
    run("report", "s", "i", "d", "p", "c", "e", "--out", "r")
    assert "leg2.bracket" in (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    # without the package the file is refused, and says what there is
    refused = ppmcal_process("check", "m.yaml", cwd=tmp_path, expect=2)
    assert "unknown limb kind '(P)RR-bracket'" in " ".join(refused.err.split())


# --- nothing else knows a kind ------------------------------------------------------------------

OTHER_SENSES = {("diagnosis/learning.py", "learned"),     # the block of it in a question
                ("io/results/plan.py", "gain"),   # what one more measurement wins
                ("algebra/__init__.py", "product")}       # of two multivectors
"""Words of files that are a kind's name too, and mean something else there."""


def test_no_module_names_a_kind() -> None:
    """No text of the package outside of the kinds' own is the name of one."""
    root = Path(ppmcal.__file__).parent
    names = {*effect_kinds(), *kinds()}
    found = set()
    for path in root.rglob("*.py"):
        place = path.relative_to(root).as_posix()
        if place.startswith(("model/effects/", "model/limbs/")):
            continue
        found |= {(place, node.value) for node in nodes_of(path)
                  if isinstance(node, ast.Constant) and node.value in names}
    assert found == OTHER_SENSES
